"""The MAVLink endpoints that PHM's reporters write to and its link probe listens to.

Each endpoint has its own thread, codec and send queue: one that hangs, or whose host name cannot be resolved,
delays no other.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Set
from dataclasses import asdict
from typing import Any

from phm.core.clock import Clock
from phm.core.settings import MavlinkSettings
from phm.facts import LinkFact
from phm.transport.mavlink_codec import V2, Codec, LinkCounters
from phm.transport.mavlink_endpoint import RADIO_STATUS, Endpoint
from phm.transport.mavlink_signing import Signer, Signing, read_key, unsigned_of
from phm.transport.mavlink_traffic import Traffic
from phm.transport.priority import MessageCount, MessagePriority
from phm.transport.send_queue import HEARTBEAT

logger = logging.getLogger(__name__)

Listener = Callable[[Any, str], None]
"""Receives a decoded pymavlink message and the endpoint's name, in the endpoint's thread. Must not block."""
CLOSE_LIMIT_S = 1.0


class MavlinkHub:
    """All endpoints of one agent. `start` opens them."""

    def __init__(
        self,
        settings: MavlinkSettings,
        system_id: int,
        clock: Clock,
        state_dir: str | None = None,
        synchronized: Callable[[], bool | None] = lambda: None,
        dev_root: str = "/dev",
    ) -> None:
        """state_dir: directory for the time of signing; None: not stored. synchronized: whether the machine's clock is
        synchronized; None if unknown. dev_root: where the host's /dev is. Raises InvalidKey."""
        self._synchronized, self._command_age_s = synchronized, settings.signing.command_age
        self.system_id, self.component_id = system_id, settings.component_id
        key = settings.signing.key if settings.endpoints else None
        self._signing = Signing(read_key(key), clock, state_dir) if key is not None else None
        self._listeners: tuple[tuple[Listener, frozenset[int]], ...] = ()
        self._watchers: tuple[Callable[[], None], ...] = ()
        self._heartbeat_sent: Callable[[int], None] | None = None
        self._errors = 0
        self._agents = 1
        self._true: Set[str] = frozenset()
        self._endpoints = tuple(
            Endpoint(
                entry,
                Codec(system_id, settings.component_id, self._wanted, self._signer(settings, place)),
                clock,
                self._deliver,
                self._changed,
                self._sent,
                dev_root,
            )
            for place, entry in enumerate(settings.endpoints)
        )

    @property
    def signs(self) -> bool:
        """Whether signing is on."""
        return self._signing is not None

    def remember(self) -> None:
        """Save the newest signing times, so that a signed frame is not accepted again after a restart of PHM. Raises
        OSError with a sentence if they cannot be saved, TimeoutError if the disk does not answer in time."""
        if self._signing is not None and (problem := self._signing.save_in_time()):
            raise OSError(problem)

    def clock_problem(self) -> str:
        """Why the age of signed frames is unknown, else empty.

        If the clock is behind the newest signature, either the clock is wrong, and then recorded frames look new, or it
        is right, and the sender's is ahead. Only a clock known to be synchronized distinguishes the two.
        """
        ahead_s = self._signing.ahead_s() if self._signing is not None else 0.0
        if ahead_s <= self._command_age_s or self._synchronized():
            return ""
        return (
            f"signed frames are {ahead_s:.0f} s ahead of this computer's clock, which is not known to be synchronized, so "
            "an old command could not be distinguished from a new one: set this computer's clock, or the sender's"
        )

    def problem(self) -> str:
        """A sentence if there is a problem with signing, else empty."""
        return self._signing.problem() if self._signing is not None else ""

    def start(self) -> None:
        if self._signing is not None:
            self._signing.start()
        for endpoint in self._endpoints:
            endpoint.start()

    def close(self) -> None:
        """Send queued messages for at most a third of a second, and close all endpoints."""
        for endpoint in self._endpoints:
            endpoint.stop()
        ended = [endpoint.join(CLOSE_LIMIT_S) for endpoint in self._endpoints]
        if self._signing is not None:
            self._signing.close(ended=all(ended))

    def send(
        self,
        message: Any,
        kind: MessagePriority = MessagePriority.TRANSITION,
        *,
        key: str = "",
        urgency: int = 0,
        link: str = "",
        only_while: tuple[str, ...] = (),
        only_replace: bool = False,
    ) -> None:
        """Queue one unpacked message for every endpoint, or for the one named `link`; never blocks. An endpoint that leads only
        to other agents gets just HEARTBEATs unless it is named: agents read no other broadcast.

        kind, urgency: what leaves first where the link's budget makes others wait. key: a newer message with the same
        key replaces this one while it waits. only_while: it waits until all of these are true (`set_true`). only_replace: it is
        sent only where an older one with its key waits. HEARTBEATs leave immediately. The caller must not change the message after.
        """
        for endpoint in self._endpoints:
            for_all = not link and (not endpoint.to_peers or message.get_msgId() == HEARTBEAT)
            if for_all or link == endpoint.name:
                endpoint.send(message, kind, key, urgency, only_while, only_replace=only_replace)

    def set_true(self, names: Set[str]) -> None:
        """What is true now, in place of what was before."""
        if self._true != names:
            for endpoint in self._endpoints:
                endpoint.set_true(names)
            self._true = names

    @property
    def agents(self) -> int:
        """How many agents share the links, this one included."""
        return self._agents

    def set_agent_count(self, agents: int, *, leads: bool = False) -> None:
        """Set how many agents share the links, this one included. leads: this agent is the leader of the swarm."""
        self._agents = max(1, agents)
        for endpoint in self._endpoints:
            endpoint.set_agent_count(self._agents, leads=leads)

    def budgets(self) -> dict[str, tuple[dict[MessagePriority, MessageCount], float]]:
        """For each endpoint: counts by class, and by how much its radio slows it down (1: not at all)."""
        return {endpoint.name: endpoint.budget() for endpoint in self._endpoints}

    def listen(self, callback: Listener, ids: Iterable[int]) -> None:
        """Have `callback` called with each message of these ids. Others are not even decoded."""
        self._listeners = (*self._listeners, (callback, frozenset(ids)))

    def on_heartbeat_sent(self, callback: Callable[[int], None]) -> None:
        """Have `callback` called by each endpoint's thread with the frame number of a HEARTBEAT that it has sent: each endpoint
        counts its own frames."""
        self._heartbeat_sent = callback

    def watch(self, callback: Callable[[], None]) -> None:
        """Have `callback` called when an endpoint opens or closes, and about twice a second meanwhile."""
        self._watchers = (*self._watchers, callback)

    def subscribers(self) -> tuple[object, ...]:
        """Listeners and watchers registered now; for `forget`."""
        return (*self._listeners, *self._watchers)

    def forget(self, those: Iterable[object]) -> None:
        """Remove these listeners and watchers."""
        gone = tuple(those)
        self._listeners = tuple(entry for entry in self._listeners if entry not in gone)
        self._watchers = tuple(entry for entry in self._watchers if entry not in gone)

    def links(self) -> tuple[LinkFact, ...]:
        """Endpoints that were tried at least once."""
        return tuple(fact for endpoint in self._endpoints if (fact := endpoint.fact()) is not None)

    def read_at(self, link: str) -> float | None:
        """The time up to which received data of this endpoint has been read (monotonic seconds); None: it is not open."""
        return next((endpoint.read_at() for endpoint in self._endpoints if endpoint.name == link), None)

    def traffic(self) -> dict[str, Traffic]:
        """Traffic of each endpoint since the start."""
        return {endpoint.name: endpoint.traffic() for endpoint in self._endpoints}

    def reopen(self, link: str, timeout_s: float) -> bool:
        """Close and reopen the endpoint of this name; whether it was open again within `timeout_s`. Blocks for this long at most."""
        return any(endpoint.reopen(timeout_s) for endpoint in self._endpoints if endpoint.name == link)

    def retry_now(self, container: str) -> None:
        """A container started: try its closed endpoints immediately."""
        for endpoint in self._endpoints:
            if endpoint.container == container:
                endpoint.retry_now()

    def counters(self) -> dict[str, LinkCounters]:
        return {endpoint.name: endpoint.codec.counters for endpoint in self._endpoints}

    def report(self) -> list[dict[str, Any]]:
        """Each endpoint for `phm status`, JSON-able. `slowed`: 1 to 10, by how much its radio slows it down; `sent`: by class
        of message how many left, were replaced by newer ones, or were dropped, and bytes on the wire; `refused`, with
        signing on: frames whose signature was forged or old, or that needed one.
        """
        found = []
        for endpoint in self._endpoints:
            fact, (counts, slowed), counters = endpoint.fact(), endpoint.budget(), endpoint.codec.counters
            by_class = {kind.name.lower(): asdict(count) for kind, count in counts.items() if count != MessageCount()}
            found.append(
                {
                    "name": endpoint.name,
                    "open": bool(fact and fact.open),
                    "error": fact.error if fact else "",
                    "slowed": round(slowed, 2),
                    "sent": by_class,
                    "bytes_out": counters.bytes_out,
                    "bytes_in": counters.bytes_in,
                    **({"refused": endpoint.codec.refused()} if self.signs else {}),
                }
            )
        return found

    def echo(self, frame: bytes) -> bool:
        """Whether an endpoint sent this exact frame recently, so that it is an echo from a router."""
        return any(endpoint.codec.sent(frame) for endpoint in self._endpoints)

    # ------------------------------------------------------------ from the endpoints' threads

    def _signer(self, settings: MavlinkSettings, place: int) -> Signer | None:
        if self._signing is None:
            return None
        chosen = settings.endpoints[place].link_id
        # MAVLink has 256 link ids: from there on they are used again.
        return Signer(self._signing, place % 256 if chosen is None else chosen, unsigned_of(settings.signing.unsigned))

    def _wanted(self, message_id: int) -> bool:
        return message_id == RADIO_STATUS or any(message_id in ids for _, ids in self._listeners)

    def _deliver(self, message: Any, link: str) -> None:
        number = message.get_msgId()  # `message.id` may be a field of the message
        for callback, ids in self._listeners:
            if number in ids:
                self._guarded(lambda call=callback: call(message, link))  # type: ignore[misc]

    def _sent(self, message: Any, frame: bytes) -> None:
        callback = self._heartbeat_sent
        if callback is not None and message.get_msgId() == HEARTBEAT:
            self._guarded(lambda: callback(frame[4 if frame[0] == V2 else 2]))

    def _changed(self) -> None:
        for callback in self._watchers:
            self._guarded(callback)

    def _guarded(self, call: Callable[[], None]) -> None:
        try:
            call()
        except Exception:  # a defect of a listener must not close the link
            self._errors += 1
            if self._errors in (1, 10, 100) or self._errors % 1000 == 0:
                logger.exception("a MAVLink listener failed (%d times)", self._errors)
