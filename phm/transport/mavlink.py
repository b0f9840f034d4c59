"""The MAVLink endpoints that PHM's reporter writes to and its link probe listens to.

Each endpoint has a thread, a codec and an outbox of its own: one that hangs, or whose name cannot be
found, keeps nobody waiting.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Any

from phm.clock import Clock
from phm.facts import LinkFact
from phm.settings import MavlinkSettings
from phm.transport.mavlink_codec import Codec, Counters
from phm.transport.mavlink_endpoint import Endpoint

logger = logging.getLogger(__name__)

Listener = Callable[[Any, str], None]
"""Gets a decoded pymavlink message and the endpoint's name, in the endpoint's thread. Must not wait."""
CLOSE_LIMIT_S = 1.0


class MavlinkHub:
    """All endpoints of one agent. Making it opens nothing; `start` does."""

    def __init__(self, settings: MavlinkSettings, system_id: int, clock: Clock) -> None:
        self.system_id, self.component_id = system_id, settings.component_id
        self._listeners: tuple[tuple[Listener, frozenset[int]], ...] = ()
        self._watchers: tuple[Callable[[], None], ...] = ()
        self._errors = 0
        self._endpoints = tuple(
            Endpoint(entry, Codec(system_id, settings.component_id, self._wanted), clock, self._deliver, self._changed)
            for entry in settings.endpoints
        )

    def start(self) -> None:
        for endpoint in self._endpoints:
            endpoint.start()

    def close(self) -> None:
        """Send what is queued, for at most a third of a second, and close all endpoints together."""
        for endpoint in self._endpoints:
            endpoint.stop()
        for endpoint in self._endpoints:
            endpoint.join(CLOSE_LIMIT_S)

    def send(self, message: Any) -> None:
        """Queue one unpacked message for every endpoint; never blocks. The caller must not change it after."""
        for endpoint in self._endpoints:
            endpoint.send(message)

    def listen(self, callback: Listener, ids: Iterable[int]) -> None:
        """Have `callback` called with each message of these ids. Others are not even decoded."""
        self._listeners = (*self._listeners, (callback, frozenset(ids)))

    def watch(self, callback: Callable[[], None]) -> None:
        """Have `callback` called when an endpoint opens or closes, and about twice a second meanwhile."""
        self._watchers = (*self._watchers, callback)

    def links(self) -> tuple[LinkFact, ...]:
        """Endpoints that were tried at least once."""
        return tuple(fact for endpoint in self._endpoints if (fact := endpoint.fact()) is not None)

    def counters(self) -> dict[str, Counters]:
        return {endpoint.name: endpoint.codec.counters for endpoint in self._endpoints}

    def echo(self, frame: bytes) -> bool:
        """Whether one of the endpoints sent this very frame lately, so that it comes back from a router."""
        return any(endpoint.codec.sent(frame) for endpoint in self._endpoints)

    # ------------------------------------------------------------ from the endpoints' threads

    def _wanted(self, message_id: int) -> bool:
        return any(message_id in ids for _, ids in self._listeners)

    def _deliver(self, message: Any, link: str) -> None:
        number = message.get_msgId()  # `message.id` may be a field of the message
        for callback, ids in self._listeners:
            if number in ids:
                self._guarded(lambda call=callback: call(message, link))  # type: ignore[misc]

    def _changed(self) -> None:
        for callback in self._watchers:
            self._guarded(callback)

    def _guarded(self, call: Callable[[], None]) -> None:
        try:
            call()
        except Exception:  # a listener's defect must not close the link
            self._errors += 1
            if self._errors in (1, 10, 100) or self._errors % 1000 == 0:
                logger.exception("a MAVLink listener failed (%d times)", self._errors)
