"""The page of `phm gcs --replay`: shows a record."""

from __future__ import annotations

from typing import Any

from phm.core.clock import Clock
from phm.gcs.frames import NO_AUTOPILOT, POWEROFF, Heartbeat, RadioStatus
from phm.gcs.samples import sender_name
from phm.gcs.web import events
from phm.gcs.web.alarms import AlarmList
from phm.gcs.web.events import GRADES
from phm.gcs.web.feed import StationFeed
from phm.gcs.web.history.collector import Collector
from phm.gcs.web.history.faults import FaultList
from phm.gcs.web.history.reader import HistoryReader
from phm.gcs.web.history.store import EVENT, FAULT, HistoryRow, HistorySample, HistoryStore
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.replay.player import Player
from phm.gcs.web.replay.record import Entry, GroundRecord
from phm.gcs.web.server import WebServer
from phm.gcs.web.site import Site
from phm.gcs.web.view import View, dumps

NO_REQUESTS = "a record is being replayed: no request can be sent"
WRITE_LIMIT_S = 60.0
SAMPLES = 1000
"""One line of a record gives fewer samples than this."""


class ReplayPage:
    """Listens once it is constructed. Raises OSError if the address cannot be used."""

    def __init__(self, record: GroundRecord, options: ListenOptions, clock: Clock, speed: float = 1.0) -> None:
        self._record, self._clock = record, clock
        self.player = Player(record, speed)
        self._view, alarms = View(self.player.clock), AlarmList()
        self._store = HistoryStore(None, clock, max_age_s=float("inf"))
        site = Site(
            self._view,
            clock,
            page="replay",
            no_requests=NO_REQUESTS,
            alarms=alarms,
            history=HistoryReader(self._store.path),
            replay=self.player,
            on_clients=self._count,
        )
        try:
            self.server = WebServer(site, options)
        except OSError:
            self._store.close()
            raise
        self._feed = StationFeed(self.player, self._view, self.player.clock, alarms)
        self._feed.ground = self._ground
        self.player.on_jump, self.player.on_change = self._feed.reset, self._feed.refresh

    @property
    def url(self) -> str:
        return self.server.url

    @property
    def address(self) -> tuple[str, int]:
        return self.server.address

    def start(self) -> None:
        self._store.start()
        self._remember()
        self._feed.start()
        self.server.start()
        self.player.start()

    def about(self) -> str:
        return self.server.about()

    def close(self) -> None:
        self.player.close()
        self._feed.close()
        self.server.close()
        self._store.close()

    def _remember(self) -> None:
        """The history of the whole record; queries end at the time that is shown. Levels are from its heartbeats, radios of the ground
        also from its snapshots, all other series from its samples."""
        book = FaultList()
        series = Collector(self._store, book)
        for entry in self._record.entries:
            self._samples(series, entry)
            if entry.line is None or entry.line["event"] == "snapshot":
                continue
            try:
                line = events.from_line({**entry.line, "mono": entry.at})
                faults = book.take(line)
                series.presence(line)
            except (KeyError, TypeError, ValueError, OverflowError):
                continue
            if not line.get("repeat"):
                values = (line["utc_s"], line["who"], GRADES.index(line["grade"]), line["event"], line["words"])
                self._put(HistoryRow(EVENT, (*values, dumps(line))))
            for one in faults:
                self._put(
                    HistoryRow(FAULT, (one.key, one.who, one.at, line["utc_s"], int(one.open), dumps(one.json())))
                )

    def _samples(self, series: Collector, entry: Entry) -> None:
        self._make_room()
        utc = self._record.utc(entry.at)
        for frame, link in entry.frames:
            if isinstance(frame, RadioStatus):
                series.radio(frame, link, utc)
            elif isinstance(frame, Heartbeat) and frame.state != POWEROFF and frame.autopilot == NO_AUTOPILOT:
                series.level(sender_name(frame.system, frame.component), frame.custom_mode, entry.at, utc)
        for name, kind, value in entry.samples:
            self._put(HistorySample(name, kind, utc, value))

    def _put(self, row: HistoryRow | HistorySample) -> None:
        self._make_room()
        self._store.put(row)

    def _make_room(self) -> None:
        """Wait where the disk is slower than the reader: nothing of a record is to be dropped."""
        if self._store.waiting + SAMPLES >= self._store.room:
            self._store.flush(WRITE_LIMIT_S)

    def _ground(self) -> dict[str, Any]:
        return {**self.player.state(), "history": {"problem": self._store.problem()}}

    def _count(self, clients: int, dropped: int) -> None:
        self._view.put(ground={"clients": clients, "dropped": dropped})
