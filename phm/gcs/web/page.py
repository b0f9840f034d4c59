"""The page of a ground station: its parts, started and closed together."""

from __future__ import annotations

from collections.abc import Mapping

from phm.core.clock import Clock
from phm.gcs.station import GroundStation
from phm.gcs.web.alarms import AlarmBook
from phm.gcs.web.feed import StationFeed
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.requests import RequestDesk
from phm.gcs.web.server import WebServer
from phm.gcs.web.site import Site
from phm.gcs.web.stream import LineTap
from phm.gcs.web.view import View


class GroundPage:
    """Listens from the start. Raises OSError when it cannot. extra: see `Site`."""

    def __init__(
        self, station: GroundStation, options: ListenOptions, clock: Clock, extra: Mapping[str, object] | None = None
    ) -> None:
        self._view, alarms = View(clock), AlarmBook()
        desk = RequestDesk(station, self._view, clock)
        site = Site(
            self._view,
            clock,
            requests=desk,
            alarms=alarms,
            stream=station,
            on_clients=self._count,
            extra=extra or {},
        )
        self.server = WebServer(site, options)
        self._feed = StationFeed(station, self._view, clock, alarms, [desk])
        station.subscribe(LineTap(clock, self.server, "/stream"))

    @property
    def url(self) -> str:
        return self.server.url

    @property
    def address(self) -> tuple[str, int]:
        return self.server.address

    def start(self) -> None:
        self._feed.start()
        self.server.start()

    def about(self) -> str:
        return self.server.about()

    def close(self) -> None:
        self._feed.close()
        self.server.close()

    def _count(self, clients: int, dropped: int) -> None:
        self._view.put(ground={"clients": clients, "dropped": dropped})
