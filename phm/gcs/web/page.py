"""The page of a ground station: its parts, started and closed together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from phm.core.clock import Clock
from phm.gcs.station import GroundStation
from phm.gcs.web.alarms import AlarmList
from phm.gcs.web.feed import StationFeed
from phm.gcs.web.history.collector import Collector
from phm.gcs.web.history.faults import FaultList
from phm.gcs.web.history.reader import HistoryReader
from phm.gcs.web.history.store import HistoryStore
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.requests import RequestHandler
from phm.gcs.web.server import WebServer
from phm.gcs.web.site import Site
from phm.gcs.web.stream import LineTap
from phm.gcs.web.view import View


class GroundPage:
    """The server of the page; it listens once it is constructed. Raises OSError if it cannot.

    history: the file; None: the history ends with the program. extra: see `Site`.
    """

    def __init__(
        self,
        station: GroundStation,
        options: ListenOptions,
        clock: Clock,
        history: Path | None = None,
        extra: Mapping[str, object] | None = None,
    ) -> None:
        self._view, alarms = View(clock), AlarmList(station.expected)
        handler = RequestHandler(station, self._view, clock)
        self._store = HistoryStore(history, clock)
        reader = HistoryReader(self._store.path)
        site = Site(
            self._view,
            clock,
            requests=handler,
            alarms=alarms,
            history=reader,
            stream=station,
            on_clients=self._count,
            extra=extra or {},
        )
        try:
            self.server = WebServer(site, options)
        except OSError:
            self._store.close()
            raise
        collector = Collector(self._store, FaultList(reader.open_faults()))
        self._feed = StationFeed(station, self._view, clock, alarms, [handler, collector])
        self._feed.ground = lambda: {"history": {"problem": self._store.problem()}}
        station.subscribe(LineTap(clock, self.server, "/stream"))

    @property
    def url(self) -> str:
        return self.server.url

    @property
    def address(self) -> tuple[str, int]:
        return self.server.address

    def start(self) -> None:
        self._store.start()
        self._feed.start()
        self.server.start()

    def about(self) -> str:
        return "; ".join(filter(None, (self.server.about(), self._store.problem())))

    def close(self) -> None:
        self._feed.close()
        self.server.close()
        self._store.close()

    def _count(self, clients: int, dropped: int) -> None:
        self._view.put(ground={"clients": clients, "dropped": dropped})
