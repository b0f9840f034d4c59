"""Whether an event of the engine may still arrive that explains why a container has exited, or is paused."""

from __future__ import annotations

from collections.abc import Callable

from phm.facts import EventStreamFact

REPLAYED_S = 0.15
"""Once the event stream is open again, the engine sends the missed events within this time."""
CLOSED_S = 3.0
"""While the event stream is closed, recovery of an exited container waits at most until this long after the stream closed."""
POLL_S = 0.1
"""While the event stream is closed or a `die` is awaited, it is checked this often."""
DIE_FOLLOWS_S = 1.0
"""The `die` of a container that a check finds exited, or the `pause` of one that it finds paused, arrives within this time: within
milliseconds on an idle machine."""
STOP_MAX_S = 121.0
"""The `kill` of a stop is at most this much older than its `die`, as far as PHM can know (`phm.probes.event_decoder.STOP_S`)."""


class AwaitedEvents:
    """By container. Any thread may call each method: it changes an entry in one step."""

    def __init__(self, stream: Callable[[], EventStreamFact]) -> None:
        self._stream = stream
        self._ended: set[str] = set()
        """Containers whose `die` or `pause` has arrived, and no `start` or `unpause` after it, and those that did not run before PHM
        looked."""
        self._known_since: dict[str, float] = {}
        """Since when recovery knows of an exit whose `die`, or a pause whose `pause`, has not arrived yet (monotonic seconds)."""

    def until(self, key: str, now: float, paused: bool) -> float | None:
        """While the event stream is closed, a stop looks like a crash; events are replayed when it is open again.

        So does an exit that a periodic check finds before its `die` arrives, unless a `kill` would have come before it; and a pause
        that it finds before its `pause` arrives.
        """
        stream = self._stream()
        until = stream.since + (REPLAYED_S if stream.open else CLOSED_S)
        if now < until:
            return until if stream.open else min(until, now + POLL_S)
        if not stream.open or key in self._ended or not (paused or self.kill_missed(now)):
            return None
        until = self._known_since.setdefault(key, now) + DIE_FOLLOWS_S
        return min(until, now + POLL_S) if now < until else None

    def kill_missed(self, now: float) -> bool:
        """Whether the `kill` of a container that exits now may have been missed."""
        return now - self._stream().complete_since < STOP_MAX_S

    def note(self, key: str, action: str) -> None:
        """An event of the container; actions as in `phm.probes.docker_event`."""
        if action in ("die", "pause", "start", "unpause"):
            self._known_since.pop(key, None)
            (self._ended.add if action in ("die", "pause") else self._ended.discard)(key)

    def found_running(self, key: str) -> None:
        self._ended.discard(key)

    def found_ended(self, key: str) -> None:
        self._ended.add(key)
