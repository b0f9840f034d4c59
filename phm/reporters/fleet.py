"""Reports to a fleet on IP: the status as a small JSON over Zenoh, on each change and periodically, and a liveliness token.

`docs/reference/fleet.md` states keys and payload as a contract. When the check scheduler hangs the token is
withdrawn, nothing is published, and no query is answered.
"""

from __future__ import annotations

from typing import Any, ClassVar, Protocol

from phm.core.model import Event, FaultClosed, FaultOpened, Report, Transition
from phm.reporters.base import Reporter, ReporterContext
from phm.reporters.open_faults import OpenFaults
from phm.transport.zenoh_link import FleetFact, FleetKeys, ZenohLink
from phm.wire import fleet_status, status_word

ALONG_S = 0.1
"""Changes within this time of the last status wait for the next tick, so that a burst costs one."""
TICK_S = 0.25
AGAIN_S = 1.0
"""A change is published once more after this time: in a burst of many agents a router drops what a reader cannot take."""
_ATTEMPTS = 2
"""A fleet that is unreachable for this many deadlines is reported as a problem: a lost packet or a roaming radio is not."""


class FleetLink(Protocol):
    """`phm.transport.zenoh_link.ZenohLink`."""

    def start(self) -> None: ...
    def put(self, payload: bytes) -> None: ...
    def present(self, yes: bool) -> None: ...
    def fact(self) -> FleetFact: ...
    def close(self, last: bytes = b"") -> None: ...


class FleetReporter(Reporter):
    """Publishes the status over Zenoh; see the module."""

    name = "fleet"
    period_s: ClassVar[float | None] = TICK_S
    kinds = (Transition, FaultOpened, FaultClosed, Report)

    def __init__(self, context: ReporterContext, link: FleetLink) -> None:
        self._context, self._link = context, link
        self._settings, self._agent = context.settings.fleet, context.settings.agent
        self._open = OpenFaults(context.restored)
        self._sequence = 0
        self._complete = self._changed = False
        self._sent_at, self._again_at = float("-inf"), float("inf")
        link.start()

    @classmethod
    def build(cls, context: ReporterContext) -> FleetReporter | None:
        fleet, agent = context.settings.fleet, context.settings.agent.name
        if not fleet.enabled:
            return None
        keys = FleetKeys(
            fleet_status.key(fleet.name, agent),
            fleet_status.alive_key(fleet.name, agent, context.boot_id),
            fleet_status.alive_key(fleet.name, agent, "*"),
        )
        return cls(context, ZenohLink(fleet, keys, context.clock))

    def handle(self, event: Event) -> None:
        self._open.take(event)
        if isinstance(event, Report):
            if self._complete:
                return
            self._complete = True
        self._changed = True
        if self._context.clock.mono() - self._sent_at >= ALONG_S:
            self.tick()

    def tick(self) -> None:
        alive = self._context.alive()
        self._link.present(alive)
        now = self._context.clock.mono()
        if alive and (self._changed or now >= min(self._again_at, self._sent_at + self._settings.refresh)):
            self._again_at = now + AGAIN_S if self._changed else float("inf")
            self._sent_at, self._changed = now, False
            self._link.put(self._status())

    def close(self) -> None:
        """Publish POWEROFF; a token that disappears without it means an unexpected end."""
        self._link.close(self._status(fleet_status.POWEROFF))

    def hand_over(self) -> None:
        """Publish BOOT, so that readers do not take the end of the token for a failure; the next reporter opens its own session."""
        self._link.close(self._status(fleet_status.STATES[status_word.BOOT]))

    def problem(self) -> str:
        fact = self._link.fact()
        if fact.namesakes:
            key = fleet_status.key(self._settings.name, self._agent.name)
            return f"another PHM is present as {key}: give each agent a unique name (agent.name)"
        if fact.connected or fact.since_s < _ATTEMPTS * self._settings.deadline:
            return ""
        return f"Zenoh does not reach the fleet {self._settings.name}: {fact.error}"

    def report(self) -> dict[str, Any]:
        fact = self._link.fact()
        return {
            "fleet": self._settings.name,
            "connected": fact.connected,
            "error": fact.error,
            "since_s": round(fact.since_s, 1),
            "published": fact.published,
            "answered": fact.answered,
            "bytes_out": fact.bytes_out,
            "connects": fact.connects,
        }

    def _status(self, state: str = "") -> bytes:
        self._sequence += 1
        context, states, agent = self._context, self._context.states(), self._agent
        state = state or fleet_status.STATES[status_word.system_status(states, complete=self._complete)]
        faults = list(self._open.values())
        return fleet_status.encode(
            (agent.name, agent.id), context.boot_id, self._sequence, context.clock.stamp(), states, faults, state
        )
