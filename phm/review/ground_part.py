"""What a report keeps of the record of a ground station (`phm gcs --record`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import msgspec

from phm.review import utc_steps
from phm.review.events import UNREADABLE, Event
from phm.review.received_frames import ReceivedFrames
from phm.review.series import Series
from phm.review.spans import Cover

COVER_S = 75.0
"""The ground records a snapshot every 60 s."""
MOST_EVENTS = 200_000
MOST_SERIES = 64
_LEVELS = {0: "STALE", 1: "OK", 2: "WARN", 3: "ERROR"}
RADIO = ("rssi", "remrssi", "noise", "remnoise", "txbuf")


@dataclass
class GroundRun:
    """One run of `phm gcs`. Times are on its monotonic clock."""

    run: str
    version: str = ""
    lines: int = 0
    left_out: int = 0
    cover: Cover = field(default_factory=lambda: Cover(COVER_S))
    numbers: Cover = field(default_factory=lambda: Cover(1.0))
    lost: dict[int, int] = field(default_factory=dict)
    """Lines that could not be written, by the number of the event `lost` that counts them."""
    clock: list[tuple[float, float]] = field(default_factory=list)
    presence: list[tuple[float, int, str, float]] = field(default_factory=list)
    """Entries (mono, agent, presence, silent_s)."""
    levels: list[tuple[float, int, str]] = field(default_factory=list)
    """Entries (mono, agent, worst level of its slots)."""
    texts: list[tuple[float, int, int, str, str]] = field(default_factory=list)
    """(mono, agent, slot, word, brief) of PHM's lines about changes."""
    armed: list[tuple[float, int, bool]] = field(default_factory=list)
    silent: list[tuple[float, int, float]] = field(default_factory=list)
    """Entries (mono, system, age_s) of autopilots that were lost: their last heartbeat was so long before."""
    bytes_of: dict[int, int] = field(default_factory=dict)
    """Bytes of the lines of text received from each agent."""
    text_bytes: list[tuple[float, int, int]] = field(default_factory=list)
    """Entries (mono, agent, bytes) of these lines."""
    untimed: int = 0
    """Number of these lines without an entry."""
    names: dict[int, str] = field(default_factory=dict)
    series: dict[str, Series] = field(default_factory=dict)
    received: ReceivedFrames = field(default_factory=ReceivedFrames)
    """When which heartbeats were received or sent, by system, component and frame number."""

    def take(self, event: Event) -> None:
        self.lines += 1
        self.cover.add(event.mono)
        if event.event not in ("snapshot", "alive", "received", "samples"):
            self.numbers.add(float(event.seq))
        utc_steps.note(self.clock, event.mono, event.utc_s)
        if event.event == "received":
            self.received.take(event.frames)
        elif len(self.texts) + len(self.levels) + len(self.presence) + len(self.armed) + len(self.silent) > MOST_EVENTS:
            self.left_out += 1
        elif event.event == "autopilot":
            if event.presence == "lost" and event.system is not None:
                self.silent.append((event.mono, event.system, max(0.0, event.age_s or 0.0)))
            elif event.armed is not None and event.system is not None:
                self.armed.append((event.mono, event.system, event.armed))
        elif event.event == "snapshot":
            self._radios(event)
        elif event.event == "lost":
            self.lost[event.seq] = max(0, event.lines)
        elif event.event == "start":
            self.version = event.version[:40]
        elif isinstance(event.agent, int):
            self._agent(event, event.agent)

    def merge(self, other: GroundRun) -> None:
        self.version = self.version or other.version
        self.lines, self.left_out = self.lines + other.lines, self.left_out + other.left_out
        self.cover.merge(other.cover)
        self.numbers.merge(other.numbers)
        self.lost.update(other.lost)
        self.clock = sorted({*self.clock, *other.clock})
        self.presence = sorted({*self.presence, *other.presence})
        self.levels = sorted({*self.levels, *other.levels})
        self.texts = sorted({*self.texts, *other.texts})
        self.armed = sorted({*self.armed, *other.armed})
        self.silent = sorted({*self.silent, *other.silent})
        room = max(0, MOST_EVENTS - len(self.text_bytes))
        self.untimed += other.untimed + len(other.text_bytes[room:])
        self.text_bytes += other.text_bytes[:room]
        for agent, count in other.bytes_of.items():
            self.bytes_of[agent] = self.bytes_of.get(agent, 0) + count
        self.received.merge(other.received)
        self.names = {**other.names, **self.names}
        for name, series in other.series.items():
            if name in self.series:
                self.series[name].merge(series)
            elif len(self.series) < MOST_SERIES:
                self.series[name] = series

    @property
    def missing_lines(self) -> int:
        """Without those that an event `lost` counts: it has the number of the last of them."""
        gaps = sum(int(after - before) - 1 for before, after in self.numbers.gaps())
        return max(0, gaps - sum(max(0, lines - 1) for lines in self.lost.values()))

    def _agent(self, event: Event, agent: int) -> None:
        if event.name and len(self.names) < 300:
            self.names.setdefault(agent, event.name[:80])
        if event.event == "presence":
            self.presence.append((event.mono, agent, event.presence, event.silent_s or 0.0))
        elif event.event == "slots":
            self.levels.append((event.mono, agent, _worst(event.slots)))
        elif event.event == "text" and event.phm:
            if len(self.bytes_of) < 300:
                self.bytes_of[agent] = self.bytes_of.get(agent, 0) + len(event.text) + 4
            if len(self.text_bytes) < MOST_EVENTS:
                self.text_bytes.append((event.mono, agent, len(event.text) + 4))
            else:
                self.untimed += 1
            if event.kind == "change" and not event.repeat and event.slot is not None and event.brief:
                self.texts.append((event.mono, agent, event.slot, str(event.word or ""), event.brief))

    def _radios(self, event: Event) -> None:
        try:
            radios = msgspec.json.decode(event.radios, type=list[dict[str, Any]]) if event.radios else []
        except UNREADABLE:
            return
        for radio in radios[:8]:
            for key in RADIO:
                value = radio.get(key)
                name = f"ground {str(radio.get('link'))[:40]} {key}"
                if (
                    isinstance(value, (int, float))
                    and not isinstance(value, bool)
                    and (name in self.series or len(self.series) < MOST_SERIES)
                ):
                    self.series.setdefault(name, Series()).add(event.mono, float(value))


def _worst(raw: msgspec.Raw) -> str:
    """The worst level of the slots; STALE when all are unknown."""
    try:
        slots = msgspec.json.decode(raw, type=dict[str, Any]) if raw else {}
    except UNREADABLE:
        return "STALE"
    levels = {
        value if isinstance(value, str) else _LEVELS.get(value, "") for value in slots.values() if value is not None
    }
    return next((level for level in ("ERROR", "WARN", "OK") if level in levels), "STALE")
