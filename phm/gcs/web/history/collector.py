"""Turns what the ground receives into entries of the history. Runs in the thread of the feed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from phm.core.model import Level
from phm.gcs.frames import ComputerStatus, Heartbeat, NamedValue, RadioStatus
from phm.gcs.presence import COPY_S
from phm.gcs.samples import GAP, MAX_SENDERS, RADIO, TOPIC, link_name, sender_name
from phm.gcs.station import Received
from phm.gcs.subscriber_queue import QueuedEvent
from phm.gcs.web.events import GRADES
from phm.gcs.web.history.faults import FaultList
from phm.gcs.web.history.store import EVENT, FAULT, HistoryRow, HistorySample, HistoryStore
from phm.gcs.web.view import dumps
from phm.wire import status_word

RATE_S, LEVEL_S = 10.0, 10.0
MAX_TOPICS = 64
"""Rates that are kept of one agent: twice what one answer of PHM has."""
LEVELS = {Level.OK: 1, Level.WARN: 2, Level.ERROR: 3}
"""The levels as numbers of the series `level`; 0: unknown or lost."""


class Collector:
    """A `FeedListener` of the feed. book: has the open faults."""

    def __init__(self, store: HistoryStore, book: FaultList) -> None:
        self._store, self._book = store, book
        self._received: dict[str, float] = {}
        """Monotonic seconds of the last heartbeat by agent, the one that has been silent for the longest time first."""
        self._levels: dict[str, tuple[int, float]] = {}
        self._frames: dict[int, int] = {}
        self._agents: dict[int, set[str]] = {}
        self._topics: dict[str, set[str]] = {}
        """Names of rates by agent."""
        self._rate_from: tuple[float, float] | None = None

    def frame(self, received: Received) -> None:
        frame, at = received.frame, received.at
        if isinstance(frame, RadioStatus):
            self.radio(frame, received.link, at.utc)
            return
        self._count(frame.system, at.mono, at.utc)
        if isinstance(frame, Heartbeat) and received.of_agent:
            self._beat(frame, at.mono, at.utc)
        elif isinstance(frame, ComputerStatus) and sender_name(frame.system, frame.component) in self._received:
            for kind, value in frame.values().items():
                self._store.put(HistorySample(sender_name(frame.system, frame.component), kind, at.utc, float(value)))
        elif isinstance(frame, NamedValue):
            self._topic(frame, at.utc)

    def event(self, item: QueuedEvent, line: Mapping[str, Any]) -> None:
        if not _repeats(line):
            body = dumps(line)
            values = (line["utc_s"], line["who"], GRADES.index(line["grade"]), line["event"], line["words"], body)
            self._store.put(HistoryRow(EVENT, values))
        self.presence(line)
        for fault in self._book.take(line):
            body = json.dumps(fault.json())
            self._store.put(
                HistoryRow(FAULT, (fault.key, fault.who, fault.at, float(line["utc_s"]), int(fault.open), body))
            )

    def radio(self, frame: RadioStatus, link: str, utc: float) -> None:
        """Store what the ground's own radio reports about a link."""
        for kind in RADIO:
            self._store.put(HistorySample(link_name(link), kind, utc, getattr(frame, kind)))

    def presence(self, line: Mapping[str, Any]) -> None:
        """Interrupt the series `level` of an agent that is lost."""
        if line["event"] == "presence" and line["presence"] != "alive":
            self._store.put(HistorySample(line["name"], "level", line["utc_s"], 0.0))
            self._levels.pop(line["name"], None)

    def tick(self, now: float) -> None:
        """Do nothing: samples are stored when a frame arrives."""

    def _beat(self, beat: Heartbeat, mono: float, utc: float) -> None:
        name = sender_name(beat.system, beat.component)
        if name not in self._received and len(self._received) >= MAX_SENDERS:
            self._forget(next(iter(self._received)))
        self._agents.setdefault(beat.system, set()).add(name)
        gap_s = mono - self._received.pop(name, mono)
        if gap_s > COPY_S:
            self._store.put(HistorySample(name, GAP, utc, round(gap_s, 3)))
        self._received[name] = mono
        self.level(name, beat.custom_mode, mono, utc)

    def _forget(self, name: str) -> None:
        """Make room for another agent."""
        del self._received[name]
        self._levels.pop(name, None)
        self._topics.pop(name, None)
        for names in self._agents.values():
            names.discard(name)

    def level(self, name: str, word: int, mono: float, utc: float) -> None:
        """Store the worst level of an agent's status word."""
        try:
            levels = status_word.decode(word).values()
        except ValueError:
            return
        level = max((LEVELS.get(one, 0) for one in levels), default=0)
        known, since = self._levels.get(name, (None, 0.0))
        if level != known or mono - since >= LEVEL_S:
            self._levels[name] = (level, mono)
            self._store.put(HistorySample(name, "level", utc, float(level)))

    def _topic(self, frame: NamedValue, utc: float) -> None:
        """Store the rate of a topic, of which an agent has MAX_TOPICS at most."""
        name = sender_name(frame.system, frame.component)
        if name not in self._received or not frame.name or frame.value is None:
            return
        known = self._topics.setdefault(name, set())
        if frame.name in known or len(known) < MAX_TOPICS:
            known.add(frame.name)
            self._store.put(HistorySample(name, f"{TOPIC}{frame.name}", utc, frame.value))

    def _count(self, system: int, mono: float, utc: float) -> None:
        """Store the frames per second, over RATE_S."""
        if self._rate_from is None:
            self._rate_from = (mono, utc)
        self._frames[system] = self._frames.get(system, 0) + 1
        took = mono - self._rate_from[0]
        if took < RATE_S:
            return
        for number, count in self._frames.items():
            for name in self._agents.get(number, ()):
                self._store.put(HistorySample(name, "rate", utc, round(count / took, 2)))
        self._frames, self._rate_from = dict.fromkeys(self._frames, 0), (mono, utc)


def _repeats(line: Mapping[str, Any]) -> bool:
    """Whether the line is a repetition; repeated lines and digests would fill the disk."""
    return bool(line.get("repeat")) or line["event"] == "words" or line.get("changed") is False
