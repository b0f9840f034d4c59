"""One action at a time on each container, however recoveries overlap.

Two containers may share a dependent, and a dependent has its own worker and faults. An attempt locks each container
that it acts on, its own target and the dependents that it restarts. The action hold, by which the tracker knows which
faults follow from an action, belongs to the attempt that acted last; only that attempt ends it.

An attempt locks its own target first and dependents one by one, later. Two attempts that wait for each other's container
would deadlock: the request that would close the circle is refused immediately, and every wait is limited.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from phm.checking.pipeline import Pipeline
from phm.core.clock import Clock
from phm.facts import CannotTell

POLL_S = 0.05


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
        self._hold_owners: dict[str, object] = {}
        self._dependent_restart_at: dict[str, float] = {}
        self._lock = threading.Lock()

    def acquire(self, target: str, owner: object) -> bool:
        """Lock the target unless another owner has it; the caller releases it."""
        with self._lock:
            return self._owners.setdefault(target, owner) is owner

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

    # ------------------------------------------------------------ action holds in the tracker

    def start_hold(
        self, target: str, owner: object, unit: str, action: str, at_most_s: float, *, proving: bool = False
    ) -> None:
        """From now on, failures in the target follow from the recovery of `unit`: see `Tracker.begin_action`."""
        with self._lock:
            self._hold_owners[target] = owner
            self._pipeline.begin_action(target, unit, action, at_most_s, proving=proving)

    def end_hold(self, target: str, owner: object, *, worked: bool) -> None:
        """End the action hold, if it is still this owner's."""
        with self._lock:
            if self._hold_owners.get(target) is not owner:
                return
            del self._hold_owners[target]
            self._pipeline.end_action(target, worked=worked)
