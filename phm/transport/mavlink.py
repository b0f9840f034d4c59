"""The MAVLink endpoints that PHM's reporter writes to and its link probe listens to.

Each endpoint has a thread, a codec and an outbox of its own: one that hangs, or whose name cannot be
found, keeps nobody waiting.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import Any

from phm.clock import Clock
from phm.facts import LinkFact
from phm.settings import MavlinkSettings
from phm.transport.mavlink_budget import Class, Count
from phm.transport.mavlink_codec import Codec, Counters
from phm.transport.mavlink_endpoint import RADIO_STATUS, Endpoint
from phm.transport.mavlink_traffic import Traffic

logger = logging.getLogger(__name__)

Listener = Callable[[Any, str], None]
"""Gets a decoded pymavlink message and the endpoint's name, in the endpoint's thread. Must not wait."""
CLOSE_LIMIT_S = 1.0


class MavlinkHub:
    """All endpoints of one agent. Making it opens nothing; `start` does."""

    def __init__(self, settings: MavlinkSettings, system_id: int, clock: Clock) -> None:
        self.system_id, self.component_id = system_id, settings.component_id
        self.signs = False
        self._listeners: tuple[tuple[Listener, frozenset[int]], ...] = ()
        self._watchers: tuple[Callable[[], None], ...] = ()
        self._errors = 0
        self._agents = 1
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

    def send(
        self, message: Any, kind: Class = Class.TRANSITION, *, key: str = "", urgency: int = 0, link: str = ""
    ) -> None:
        """Queue one unpacked message for every endpoint, or for the one named `link`; never blocks.

        kind, urgency: what leaves first where the link's budget makes others wait. key: a newer message with the same
        key replaces this one while it waits. HEARTBEATs leave at once. The caller must not change the message after.
        """
        for endpoint in self._endpoints:
            if link in ("", endpoint.name):
                endpoint.send(message, kind, key, urgency)

    @property
    def agents(self) -> int:
        """How many agents share the links, this one included."""
        return self._agents

    def share(self, agents: int, *, speaks: bool = False) -> None:
        """So many agents share the links, this one included; whether it speaks for them."""
        self._agents = max(1, agents)
        for endpoint in self._endpoints:
            endpoint.share(self._agents, speaks=speaks)

    def budgets(self) -> dict[str, tuple[dict[Class, Count], float]]:
        """For each endpoint: counts by class, and by how much its radio slows it down (1: not at all)."""
        return {endpoint.name: endpoint.budget() for endpoint in self._endpoints}

    def listen(self, callback: Listener, ids: Iterable[int]) -> None:
        """Have `callback` called with each message of these ids. Others are not even decoded."""
        self._listeners = (*self._listeners, (callback, frozenset(ids)))

    def watch(self, callback: Callable[[], None]) -> None:
        """Have `callback` called when an endpoint opens or closes, and about twice a second meanwhile."""
        self._watchers = (*self._watchers, callback)

    def links(self) -> tuple[LinkFact, ...]:
        """Endpoints that were tried at least once."""
        return tuple(fact for endpoint in self._endpoints if (fact := endpoint.fact()) is not None)

    def traffic(self) -> dict[str, Traffic]:
        """What went over each endpoint since the start."""
        return {endpoint.name: endpoint.traffic() for endpoint in self._endpoints}

    def reopen(self, link: str, timeout_s: float) -> bool:
        """Close the endpoint of this name and open it anew; whether it was open again in time. Blocks for so long at most."""
        return any(endpoint.reopen(timeout_s) for endpoint in self._endpoints if endpoint.name == link)

    def counters(self) -> dict[str, Counters]:
        return {endpoint.name: endpoint.codec.counters for endpoint in self._endpoints}

    def report(self) -> list[dict[str, Any]]:
        """Each endpoint for `phm status`, JSON-able. `slowed`: 1 to 10, by how much its radio slows it down; `sent`: by class
        of message how many left, were replaced by newer ones, or were dropped, and bytes on the wire.
        """
        found = []
        for endpoint in self._endpoints:
            fact, (counts, slowed), counters = endpoint.fact(), endpoint.budget(), endpoint.codec.counters
            by_class = {kind.name.lower(): asdict(count) for kind, count in counts.items() if count != Count()}
            found.append({
                "name": endpoint.name, "open": bool(fact and fact.open), "error": fact.error if fact else "",
                "slowed": round(slowed, 2), "sent": by_class,
                "bytes_out": counters.bytes_out, "bytes_in": counters.bytes_in,
            })  # fmt: skip
        return found

    def echo(self, frame: bytes) -> bool:
        """Whether one of the endpoints sent this very frame lately, so that it comes back from a router."""
        return any(endpoint.codec.sent(frame) for endpoint in self._endpoints)

    # ------------------------------------------------------------ from the endpoints' threads

    def _wanted(self, message_id: int) -> bool:
        return message_id == RADIO_STATUS or any(message_id in ids for _, ids in self._listeners)

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
