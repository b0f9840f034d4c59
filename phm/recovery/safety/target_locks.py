"""Who of PHM's own threads is acting on which container: never two at once, however their repairs overlap.

Two containers may share a dependant, and a dependant has a thread and faults of its own. Whoever acts on a container, its
own thread or another's that restarts it as a dependant, must have it in hand; the hold on it, by which the tracker knows
what follows from a repair, belongs to who acted last and is released by nobody else.

A repair takes its own container first and its dependants one by one, later. Two repairs that wait for each other's
container could wait for ever: the one that would close the circle is refused at once, and every wait has an end.
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
    """Another repair is at work on the container."""


class TargetLocks:
    """One for all workers. An owner is whatever stands for one repair; it is told from others by identity.

    Invariant: `_holder` has at most one owner for a container, `_wants` at most one container for an owner.
    """

    def __init__(self, pipeline: Pipeline, clock: Clock) -> None:
        self._pipeline, self._clock = pipeline, clock
        self._holder: dict[str, object] = {}
        self._wants: dict[object, str] = {}
        self._held_by: dict[str, object] = {}
        self._moved_at: dict[str, float] = {}
        self._lock = threading.Lock()

    def take(self, key: str, owner: object) -> bool:
        """Take the container in hand unless another owner has it. Whoever takes it lets it go."""
        with self._lock:
            return self._holder.setdefault(key, owner) is owner

    def release_target(self, key: str, owner: object) -> None:
        with self._lock:
            if self._holder.get(key) is owner:
                del self._holder[key]

    @contextlib.contextmanager
    def on(self, key: str, owner: object, at_most_s: float) -> Iterator[None]:
        """Have one more container in hand, waiting for it at most so long. Raises InOtherHands."""
        self._wait_for(key, owner, at_most_s)
        self._moved_at[key] = float("inf")
        try:
            yield
        finally:
            self._moved_at[key] = self._clock.mono()
            self.release_target(key, owner)

    def dependent_restart_at(self, key: str) -> float:
        """When the container was last restarted for another's sake (monotonic seconds), infinite while it is, -inf: never.

        What was found before says nothing about how it is now.
        """
        return self._moved_at.get(key, float("-inf"))

    def _wait_for(self, key: str, owner: object, at_most_s: float) -> None:
        end = self._clock.mono() + at_most_s
        try:
            while not self.take(key, owner):
                with self._lock:
                    self._wants[owner] = key
                    if self._circle(key, owner):
                        raise TargetBusy(f"{key} is in the hands of a repair that waits for this one")
                if self._clock.mono() >= end:
                    raise TargetBusy(f"another repair had {key} in hand for {at_most_s:g} s")
                self._clock.wait(threading.Event(), POLL_S)
        finally:
            with self._lock:
                self._wants.pop(owner, None)

    def _circle(self, key: str, owner: object) -> bool:
        """Whether who has `key` waits, directly or through others, for something that `owner` has."""
        seen: set[str] = set()
        wanted: str | None = key
        while wanted is not None and wanted not in seen:
            seen.add(wanted)
            holder = self._holder.get(wanted)
            if holder is owner:
                return True
            wanted = self._wants.get(holder)
        return False

    # ------------------------------------------------------------ what the tracker is told

    def hold(self, key: str, owner: object, unit: str, action: str, at_most_s: float, *, proving: bool = False) -> None:
        """From now on, what breaks in the container follows from the repair of `unit`: see `Tracker.hold`."""
        with self._lock:
            self._held_by[key] = owner
            self._pipeline.begin_action(key, unit, action, at_most_s, proving=proving)

    def release(self, key: str, owner: object, *, worked: bool) -> None:
        """End the hold, if it is still this owner's."""
        with self._lock:
            if self._held_by.get(key) is not owner:
                return
            del self._held_by[key]
            self._pipeline.end_action(key, worked=worked)
