"""What the ground receives between the events, thinned: the record keeps it, so that a replay has the plots of the live page.

Callers pass the time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from phm.gcs.agent import PHM_COMPONENT
from phm.gcs.frames import ComputerStatus, Heartbeat, NamedValue, RadioStatus
from phm.gcs.presence import COPY_S
from phm.wire.status_line import agent_name

if TYPE_CHECKING:
    from phm.gcs.station import Received

EACH_S = 10.0
"""Time between two samples of a series."""
MAX_SENDERS = 1024
MAX_SERIES = 4096
"""Series in one interval; more are left out."""
GAP, TOPIC = "gap", "topic "
RADIO = ("rssi", "remrssi", "noise", "remnoise", "txbuf")
SeriesValues = dict[str, dict[str, float]]
"""Values by the name of an agent, or `link:` and that of a link, and by series."""


class Samples:
    """The newest value of each series since the last `take`; of the gaps between heartbeats the longest. Not thread-safe."""

    def __init__(self) -> None:
        self._received_s: dict[str, float] = {}
        """Monotonic seconds of the last heartbeat, the one that has been silent for the longest time first."""
        self._values: SeriesValues = {}
        self._count = 0
        self._due_s = 0.0

    def add(self, received: Received) -> None:
        """Add what a frame says, if it is of an agent, or of a radio of the ground."""
        frame = received.frame
        if isinstance(frame, RadioStatus):
            for kind in RADIO:
                if (level := getattr(frame, kind)) is not None:
                    self._put(link_name(received.link), kind, float(level))
            return
        name = sender_name(frame.system, frame.component)
        if isinstance(frame, Heartbeat):
            if received.of_agent:
                self._heartbeat(name, received.at.mono)
        elif name in self._received_s:
            for kind, value in _reported(frame):
                self._put(name, kind, value)

    def take(self, now_s: float, *, last: bool = False) -> SeriesValues:
        """The values, at most every EACH_S; otherwise nothing. last: now, whatever the time."""
        if not self._values or (now_s < self._due_s and not last):
            return {}
        found, self._values, self._count, self._due_s = self._values, {}, 0, now_s + EACH_S
        return found

    def _heartbeat(self, name: str, mono_s: float) -> None:
        before = self._received_s.pop(name, None)
        if before is None and len(self._received_s) >= MAX_SENDERS:
            del self._received_s[next(iter(self._received_s))]  # a sender can invent any number of names
        self._received_s[name] = mono_s
        gap_s = 0.0 if before is None else round(mono_s - before, 3)
        if gap_s > COPY_S:
            self._put(name, GAP, max(gap_s, self._values.get(name, {}).get(GAP, 0.0)))

    def _put(self, name: str, kind: str, value: float) -> None:
        values = self._values.setdefault(name, {})
        if kind not in values:
            if self._count >= MAX_SERIES:
                return
            self._count += 1
        values[kind] = value


def _reported(frame: object) -> Iterator[tuple[str, float]]:
    if isinstance(frame, ComputerStatus):
        for kind, value in frame.values().items():
            yield kind, float(value)
    elif isinstance(frame, NamedValue) and frame.name and frame.value is not None:
        yield f"{TOPIC}{frame.name}", frame.value


def sender_name(system: int, component: int) -> str:
    """The name of an agent on the ground, such as A07."""
    return agent_name(system) if component == PHM_COMPONENT else f"{agent_name(system)}/{component}"


def link_name(link: str) -> str:
    """The name of one of the ground's own links in the history."""
    return f"link:{link}"[:100]
