"""Which life of its container is at hand, and who began it: PHM, the engine's restart policy, or somebody else.

A container that somebody else has recreated or started again is not what PHM has tried on: attempts count anew
(`phm.recovery.history`), and what was given up may be acted on again. What counts as somebody's doing is decided so that a
container that ends again and again does not make PHM begin anew for ever:

- A **new id** counts at once; nobody but a person or a tool makes one, and PHM never does. Unless the container that it
  replaces had not been there for `recovery.verify` itself: whoever recreates at that pace is a crash loop, too.
- **Started again**, with the same id: when this life has lasted for `recovery.verify` and the container still runs.
- **By the engine's own restart policy** (its counter is above 0; a start by hand sets it to 0): never. It has done what
  PHM's restart would have done, and nothing was mended. It is watched: after it, units get their grace.
- **By PHM**, for this container's sake or another's: never. Also when the engine does it late: after the call's deadline, or
  after PHM itself has ended in the middle of it. A call to start or restart it that was sent and not answered is followed by at most one start
  that is PHM's.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from phm.core.clock import Clock
from phm.facts import CannotTell, ContainerFact

FOUND, ENGINE, OTHERS, RECREATED, COUNTED = "found", "engine", "others", "recreated", "counted"
"""Who began a life: it was there when first looked at; the restart policy; others; others, who made a new container; and
others whose doing has been taken into account. PHM itself stands as `phm:` and the container for whose sake it acted."""
UNFINISHED_S = 600.0
"""A call without an answer may have its effect for so long; attempts older than this no longer count
(`phm.recovery.history.CLEAN_S`)."""
SETTLED_S = 0.5
"""A change seen up to this long after an action of PHM began with it: what the probe says may be 0.2 s old."""


def by_phm(whose: str) -> str:
    """`Generation.by` of a life that PHM began for the sake of container `whose`."""
    return f"phm:{whose}"


@dataclass(frozen=True, slots=True)
class Generation:
    """One life of a container, from one start to the next; `id` and `started` are the engine's and name it.

    since: when it was first seen in place of another (monotonic seconds), None when it was there at the first look.
    made:  the same for the container, which may live several times.
    by:    who began it, in the words above.
    """

    id: str
    started: str
    since: float | None = None
    made: float | None = None
    by: str = FOUND

    @property
    def name(self) -> str:
        """As checks call it: see `phm.facts.ContainerFact.life`."""
        return f"{self.id}@{self.started}"

    @property
    def whose(self) -> str:
        """The container for whose sake PHM began this life; empty when others did."""
        name = self.by.removeprefix("phm:")
        return name if name != self.by else ""

    def same(self, other: Generation | None) -> bool:
        return other is not None and (self.id, self.started) == (other.id, other.started)


def next_generation(
    old: Generation | None, fact: ContainerFact, now: float, lasting_s: float, phm_for: str = ""
) -> Generation:
    """The life that `fact` shows, after `old`. `phm_for`: the container for whose sake PHM is acting on this one."""
    if old is None:
        return Generation(fact.id, fact.started_at)
    if (old.id, old.started) == (fact.id, fact.started_at):
        return old
    if old.id != fact.id:
        replaced_s = float("inf") if old.made is None else now - old.made
        return Generation(fact.id, fact.started_at, now, now, RECREATED if replaced_s >= lasting_s else OTHERS)
    by = by_phm(phm_for) if phm_for else ENGINE if fact.restart_count else OTHERS
    return Generation(fact.id, fact.started_at, now, old.made, by)


def resets_attempts(life: Generation, fact: ContainerFact, now: float, lasting_s: float) -> bool:
    """Whether attempts made before this life say nothing about it."""
    if life.since is None or life.by == RECREATED:
        return life.by == RECREATED
    return life.by == OTHERS and fact.running and now - life.since >= lasting_s


@dataclass(slots=True)
class _Actor:
    """PHM is acting on a container for the sake of `who`; `ended` (monotonic seconds) until a look has shown the outcome.

    `unanswered` calls may still start the container, each once, until `until` (monotonic seconds).
    """

    who: str
    ended: float | None = None
    unanswered: int = 0
    until: float = float("-inf")

    def over(self, now: float) -> bool:
        if self.ended is None or now - self.ended < SETTLED_S:
            return False
        return self.unanswered <= 0 or now >= self.until


class GenerationTracker:
    """The newest known life of each container. Thread-safe.

    Invariant: a container's entries are changed with its own lock held, from the question to the engine until the answer
    is in, so that an old answer never comes after a newer one. The engine's client bounds how long that takes.
    """

    def __init__(self, observe: Callable[[str], ContainerFact | None], clock: Clock, lasting_s: float) -> None:
        self._observe, self._clock, self._lasting_s = observe, clock, lasting_s
        self._generations: dict[str, Generation] = {}
        self._actors: dict[str, _Actor] = {}
        self._locks: dict[str, threading.Lock] = {}

    def restore(self, known: Mapping[str, Generation]) -> None:
        """What an earlier run of PHM knew; before any look."""
        self._generations.update(known)

    def snapshot(self) -> dict[str, Generation]:
        return dict(self._generations)

    def current(self, key: str) -> Generation | None:
        """The life at hand; the last known one when nobody can tell."""
        with self._lock(key):
            self._update(key)
            return self._generations.get(key)

    def external_start(self, key: str) -> float | None:
        """When a life began that makes attempts count anew (monotonic seconds); said once for each such life."""
        with self._lock(key):
            fact, life = self._update(key), self._generations.get(key)
            if life is None or fact is None or not resets_attempts(life, fact, self._clock.mono(), self._lasting_s):
                return None
            self._generations[key] = replace(life, by=COUNTED)
            return life.since

    def forget(self, key: str) -> None:
        """No attempt counts any more: what happens from now on need not be told from what was. The next look is the first."""
        with self._lock(key):
            self._generations.pop(key, None)

    @contextlib.contextmanager
    def acting(self, key: str, who: str, unanswered: Callable[[], int] = lambda: 0) -> Iterator[None]:
        """While it is entered, and until the outcome was seen, a new life of `key` is PHM's doing, for the sake of `who`.

        unanswered: how many calls that start `key` had no answer meanwhile; asked once, at the end.
        """
        actor = _Actor(who)
        with self._lock(key):
            self._update(key)  # what others did until now is theirs
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

    def add_unfinished(self, key: str, who: str) -> None:
        """An action on `key` for the sake of `who` was cut short when PHM ended; the engine may finish it, or has. Before any look."""
        now = self._clock.mono()
        self._actors[key] = _Actor(who, now, 1, now + UNFINISHED_S)

    def unfinished(self) -> dict[str, str]:
        """On which containers PHM is acting, or has made a call without an answer, and for whose sake: for the next PHM."""
        actors, now = dict(self._actors), self._clock.mono()
        return {
            key: actor.who
            for key, actor in actors.items()
            if actor.ended is None or (actor.unanswered > 0 and now < actor.until)
        }

    def _lock(self, key: str) -> threading.Lock:
        return self._locks.setdefault(key, threading.Lock())

    def _update(self, key: str) -> ContainerFact | None:
        began, actor = self._clock.mono(), self._actors.get(key)
        try:
            fact = self._observe(key)
        except CannotTell:
            return None  # the last known life stands
        if fact is None:
            return None
        phm_for = actor.who if actor is not None else ""
        old = self._generations.get(key)
        life = self._generations[key] = next_generation(old, fact, self._clock.mono(), self._lasting_s, phm_for)
        if actor is not None:
            if life is not old and life.whose:
                actor.unanswered -= 1
            if actor.over(began):
                del self._actors[key]
        return fact
