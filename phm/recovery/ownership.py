"""Who acts on a target now, and who started its container: PHM, the restart policy, or others.

**Locks.** One action at a time on each container, however recoveries overlap: two containers may share a dependent, and a
dependent has its own worker and faults. An attempt locks each container that it acts on, its own target first and the
dependents that it restarts one by one, later. Two attempts that wait for each other's container would deadlock: the request
that would close the circle is refused immediately, and every wait is limited. The tracker's record of an
action, by which it knows which faults follow from it, belongs to the attempt that acted last; only that attempt ends it.

**Generations** of a container, one from each start to the next. A container that others have recreated or started again is
not the one on which PHM's attempts failed: attempts are reset (`phm.recovery.policy`), and what was given up may be acted on
again. The rules keep a container that exits again and again from resetting the attempts each time:

- **A new id** resets immediately: only a person or a tool creates a container, never PHM. Unless the container that it
  replaces had existed for less than `recovery.verify`: recreating at that pace is a crash loop, too.
- **Started again with the same id** resets when this generation has lasted for `recovery.verify` and still runs.
- **Started by the engine's restart policy** (its counter is above 0; a manual start sets it to 0) never resets: it did what
  PHM's restart would have done, and repaired nothing. Units get their grace after it.
- **Started by PHM**, for this container or another, never resets. Also when the engine does it late: after the call's
  deadline, or after PHM itself was stopped. A call to start or restart it that got no answer is followed by at most one
  start that is attributed to PHM.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum

from phm.checking.pipeline import Pipeline
from phm.core.clock import Clock
from phm.facts import CannotTell, ContainerFact

UNFINISHED_S = 600.0
"""How long a call without a response may take effect; older attempts do not count (`phm.recovery.fault_cases.CLEAN_S`)."""
SETTLED_S = 0.5
"""A change observed up to this long after an action of PHM belongs to it: the probe's data may be 0.2 s old."""
POLL_S = 0.05
"""A lock that another attempt has is tried again this often."""


class StartedBy(str, Enum):
    """Who started a generation.

    FOUND:     unknown, it ran at the first observation.
    ENGINE:    the engine's restart policy.
    PHM:       PHM.
    OTHERS:    others.
    RECREATED: others, with a new container.
    COUNTED:   others, after the attempts were reset for it.
    """

    FOUND = "found"
    ENGINE = "engine"
    PHM = "phm"
    OTHERS = "others"
    RECREATED = "recreated"
    COUNTED = "counted"


@dataclass(frozen=True, slots=True)
class Generation:
    """The time from one start of a container to the next; `id` and `started` are the engine's and identify it.

    since: when it was first observed instead of another (monotonic seconds); None: at the first observation. made: the
    same for the container, which may have several generations. phm_for: the container that PHM recovered when it started this
    generation; empty: others started it.
    """

    id: str
    started: str
    since: float | None = None
    made: float | None = None
    by: StartedBy = StartedBy.FOUND
    phm_for: str = ""

    @property
    def name(self) -> str:
        """As in results of checks: see `phm.facts.ContainerFact.generation`."""
        return f"{self.id}@{self.started}"

    def same(self, other: Generation | None) -> bool:
        return other is not None and (self.id, self.started) == (other.id, other.started)


def next_generation(
    old: Generation | None, fact: ContainerFact, now: float, lasting_s: float, phm_for: str = ""
) -> Generation:
    """The generation that `fact` shows, after `old`. phm_for: the container for which PHM is acting on this one."""
    if old is None:
        return Generation(fact.id, fact.started_at)
    if (old.id, old.started) == (fact.id, fact.started_at):
        return old
    if old.id != fact.id:
        replaced_s = float("inf") if old.made is None else now - old.made
        by = StartedBy.RECREATED if replaced_s >= lasting_s else StartedBy.OTHERS
        return Generation(fact.id, fact.started_at, now, now, by)
    by = StartedBy.PHM if phm_for else StartedBy.ENGINE if fact.restart_count else StartedBy.OTHERS
    return Generation(fact.id, fact.started_at, now, old.made, by, phm_for)


def resets_attempts(generation: Generation, fact: ContainerFact, now: float, lasting_s: float) -> bool:
    """Whether attempts before this generation do not apply to it."""
    if generation.since is None or generation.by is StartedBy.RECREATED:
        return generation.by is StartedBy.RECREATED
    return generation.by is StartedBy.OTHERS and fact.running and now - generation.since >= lasting_s


@dataclass(slots=True)
class _Actor:
    """An action of PHM on a container, to recover `who`. Kept after it has `ended` (monotonic seconds) until its outcome was
    observed.

    `disturbs`: whether it may be stopping or starting this container now. `unanswered` calls may still start the container, each
    once, until `until` (monotonic seconds).
    """

    who: str
    ended: float | None = None
    disturbs: Callable[[], bool] = lambda: True
    unanswered: int = 0
    until: float = float("-inf")

    def over(self, now: float) -> bool:
        if self.ended is None or now - self.ended < SETTLED_S:
            return False
        return self.unanswered <= 0 or now >= self.until


class GenerationTracker:
    """The newest known generation of each container. Thread-safe. lasting_s: `recovery.verify`.

    Invariant: a container's entries are changed with its own lock held, from the request to the engine until the
    response, so that an old response never replaces a newer one. The engine's client limits how long that takes.
    """

    def __init__(self, observe: Callable[[str], ContainerFact | None], clock: Clock, lasting_s: float) -> None:
        self._observe, self._clock, self._lasting_s = observe, clock, lasting_s
        self._generations: dict[str, Generation] = {}
        self._actors: dict[str, _Actor] = {}
        self._locks: dict[str, threading.Lock] = {}
        self.on_unanswered: Callable[[str], None] = lambda key: None
        """Called with a container after an action whose call to start it got no response: it must be observed from then on, so
        that the start is known to be PHM's, and a stop after it not to be."""

    def restore(self, known: Mapping[str, Generation]) -> None:
        """Restore the state of an earlier run of PHM; call before the first observation."""
        self._generations.update(known)

    def snapshot(self) -> dict[str, Generation]:
        return dict(self._generations)

    def current(self, key: str) -> Generation | None:
        """The current generation; the last known one if the engine does not respond."""
        with self._lock(key):
            self._update(key)
            return self._generations.get(key)

    def known(self, key: str) -> Generation | None:
        """The last known generation, without asking the engine."""
        return self._generations.get(key)

    def external_start(self, key: str) -> float | None:
        """When a generation began that resets attempts (monotonic seconds); returned once for each such generation."""
        with self._lock(key):
            fact, generation = self._update(key), self._generations.get(key)
            if (
                generation is None
                or fact is None
                or not resets_attempts(generation, fact, self._clock.mono(), self._lasting_s)
            ):
                return None
            self._generations[key] = replace(generation, by=StartedBy.COUNTED)
            return generation.since

    def forget(self, key: str) -> None:
        """No attempt counts any more, so starts need not be attributed. The next observation is the first."""
        with self._lock(key):
            self._generations.pop(key, None)

    @contextlib.contextmanager
    def acting(
        self,
        key: str,
        who: str,
        unanswered: Callable[[], int] = lambda: 0,
        disturbs: Callable[[], bool] = lambda: True,
    ) -> Iterator[None]:
        """Inside this context, and until the outcome was observed, a new generation of `key` is attributed to PHM,
        acting for `who`. unanswered: returns how many calls that start `key` got no response; called once, at the end.
        disturbs: returns whether PHM may be stopping or starting `key` now.
        """
        actor = _Actor(who, disturbs=disturbs)
        with self._lock(key):
            self._update(key)  # a start before this is not PHM's
            before = self._actors.get(key)
            if before is not None:
                actor.unanswered, actor.until = before.unanswered, before.until
            self._actors[key] = actor
        try:
            yield
        finally:
            count = unanswered()
            if count:
                actor.unanswered, actor.until = actor.unanswered + count, self._clock.mono() + UNFINISHED_S
            actor.ended = self._clock.mono()
            if count:
                self.on_unanswered(key)

    def add_unfinished(self, key: str, who: str) -> None:
        """An action on `key` to recover `who` was interrupted when PHM stopped; the engine may complete it. Call before
        any observation."""
        now = self._clock.mono()
        self._actors[key] = _Actor(who, now, unanswered=1, until=now + UNFINISHED_S)

    def unfinished(self) -> dict[str, str]:
        """The containers on which PHM is acting, or for which a call got no response, each with the container to
        recover: for the next PHM."""
        actors, now = dict(self._actors), self._clock.mono()
        return {
            key: actor.who
            for key, actor in actors.items()
            if actor.ended is None or (actor.unanswered > 0 and now < actor.until)
        }

    def disturbed(self, key: str) -> bool:
        """Whether an action of PHM may be stopping or starting this container now, or a call to start it got no response."""
        actor = self._actors.get(key)
        if actor is None:
            return False
        at_work = actor.ended is None and actor.disturbs()
        return at_work or (actor.unanswered > 0 and self._clock.mono() < actor.until)

    def _lock(self, key: str) -> threading.Lock:
        return self._locks.setdefault(key, threading.Lock())

    def _update(self, key: str) -> ContainerFact | None:
        began, actor = self._clock.mono(), self._actors.get(key)
        try:
            fact = self._observe(key)
        except CannotTell:
            return None  # the last known generation remains
        if fact is None:
            return None
        phm_for = actor.who if actor is not None else ""
        old = self._generations.get(key)
        generation = self._generations[key] = next_generation(old, fact, self._clock.mono(), self._lasting_s, phm_for)
        if actor is not None:
            if old is not None and fact.id != old.id:
                actor.unanswered = 0  # what was asked of the earlier container cannot start or stop this one
            elif generation is not old and generation.phm_for:
                actor.unanswered -= 1
            if actor.over(began):
                del self._actors[key]
        return fact


class TargetBusy(CannotTell):
    """Another attempt is acting on the target."""


class TargetLocks:
    """Shared by all workers. An owner is the object of one attempt, compared by identity.

    Invariant: `_owners` has at most one owner for a target, `_waiting_for` at most one target for an owner.
    """

    def __init__(self, pipeline: Pipeline, clock: Clock) -> None:
        self._pipeline, self._clock = pipeline, clock
        self._owners: dict[str, object] = {}
        self._waiting_for: dict[object, str] = {}
        self._action_owners: dict[str, object] = {}
        self._dependent_restart_at: dict[str, float] = {}
        self._lock = threading.Lock()

    def acquire(self, target: str, owner: object) -> bool:
        """Lock the target unless another owner has it; the caller releases it."""
        with self._lock:
            return self._owners.setdefault(target, owner) is owner

    def owner(self, target: str) -> object | None:
        """Who has locked the target; None: it is not locked."""
        return self._owners.get(target)

    def release(self, target: str, owner: object) -> None:
        """Unlock the target, if this owner has it."""
        with self._lock:
            if self._owners.get(target) is owner:
                del self._owners[target]

    @contextlib.contextmanager
    def locked_dependent(self, target: str, owner: object, at_most_s: float) -> Iterator[None]:
        """Lock a dependent as well, waiting for it at most this long. Raises TargetBusy."""
        self._wait_for(target, owner, at_most_s)
        self._dependent_restart_at[target] = float("inf")
        try:
            yield
        finally:
            self._dependent_restart_at[target] = self._clock.mono()
            self.release(target, owner)

    def dependent_restart_at(self, target: str) -> float:
        """When the target was last restarted as a dependent (monotonic seconds); infinite while it is being restarted,
        -inf: never. Earlier results do not describe its current state."""
        return self._dependent_restart_at.get(target, float("-inf"))

    def _wait_for(self, target: str, owner: object, at_most_s: float) -> None:
        end = self._clock.mono() + at_most_s
        try:
            while not self.acquire(target, owner):
                with self._lock:
                    self._waiting_for[owner] = target
                    if self._would_deadlock(target, owner):
                        raise TargetBusy(f"{target} is locked by a recovery that waits for this one")
                if self._clock.mono() >= end:
                    raise TargetBusy(f"another recovery was acting on {target} for {at_most_s:g} s")
                self._clock.wait(threading.Event(), POLL_S)
        finally:
            with self._lock:
                self._waiting_for.pop(owner, None)

    def _would_deadlock(self, target: str, owner: object) -> bool:
        """Whether the owner of `target` waits, directly or through others, for something that `owner` has locked."""
        seen: set[str] = set()
        wanted: str | None = target
        while wanted is not None and wanted not in seen:
            seen.add(wanted)
            holder = self._owners.get(wanted)
            if holder is owner:
                return True
            wanted = self._waiting_for.get(holder)
        return False

    # ------------------------------------------------------------ actions as the tracker knows them

    def begin_action(
        self,
        target: str,
        owner: object,
        unit: str,
        action: str,
        at_most_s: float,
        *,
        verifying: bool = False,
        leaves_running: bool = False,
    ) -> None:
        """From now on, failures in the target follow from the recovery of `unit`: see `Tracker.begin_action`."""
        with self._lock:
            self._action_owners[target] = owner
            self._pipeline.begin_action(
                target, unit, action, at_most_s, verifying=verifying, leaves_running=leaves_running
            )

    def end_action(self, target: str, owner: object, *, worked: bool) -> None:
        """The action is over, unless another owner has acted since: see `Tracker.end_action`."""
        with self._lock:
            if self._action_owners.get(target) is not owner:
                return
            del self._action_owners[target]
            self._pipeline.end_action(target, worked=worked)


@dataclass(frozen=True, slots=True)
class Shared:
    """What the workers and attempts of all targets share. grace_s: of a unit, seconds."""

    pipeline: Pipeline
    clock: Clock
    locks: TargetLocks
    generations: GenerationTracker
    grace_s: Callable[[str], float]
