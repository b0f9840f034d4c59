"""The objects that the routes of the page work with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from phm.core.clock import Clock
from phm.gcs.web.view import View

if TYPE_CHECKING:
    from phm.gcs.station import GroundStation
    from phm.gcs.web.alarms import AlarmList
    from phm.gcs.web.history.reader import HistoryReader

Json = dict[str, Any]


class RequestRefused(Exception):
    """A request of the operator is not sent; the message says why."""


class Requests(Protocol):
    """Takes requests of the operator (`phm.gcs.web.requests.RequestHandler`). Thread-safe, never waits for an agent."""

    def choices(self, agent: str) -> Json:
        """What can be requested of an agent. Raises RequestRefused."""

    def submit(self, body: Mapping[str, Any], by: str) -> Json:
        """Send a request and return it as JSON. Raises RequestRefused, and ValueError for an invalid body."""

    def recent(self) -> list[Json]:
        """The last requests, oldest first."""


class ReplayControl(Protocol):
    """Controls a replay (`phm.gcs.web.replay.player.Player`). Thread-safe."""

    def control(self, body: Mapping[str, Any]) -> None:
        """Apply a control of the page, such as pause. Raises ValueError for an invalid one."""


@dataclass(frozen=True)
class Site:
    """page: what is shown: gcs, status or replay. requests, alarms, history, replay: None where the page has none. stream: for
    `/stream` and `/snapshot`. extra: what an option hands to a module of `routes`."""

    view: View
    clock: Clock
    page: str = "gcs"
    requests: Requests | None = None
    alarms: AlarmList | None = None
    history: HistoryReader | None = None
    replay: ReplayControl | None = None
    stream: GroundStation | None = None
    extra: Mapping[str, object] = field(default_factory=dict)
    no_requests: str = "requests are not possible here"
    """Why the page takes no requests."""
    on_clients: Callable[[int, int], None] | None = None
    """Takes how many clients there are, and how many were dropped, when that changes."""
