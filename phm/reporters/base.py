"""Base of reporters. A reporter is one file that sends events from the bus to one destination.

Reporters are found through the entry-point group ``phm.reporters``. The bus gives each a bounded queue and a thread, so a slow
destination delays no other; when the queue is full, its oldest event is dropped and counted.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from phm.core.clock import Clock
from phm.core.model import ActionEvent, Event, Fault, Result, UnitState
from phm.core.settings import (
    AgentSettings,
    FleetSettings,
    LogSettings,
    MavlinkSettings,
    MetricsSettings,
    NotifySettings,
    RosSettings,
)
from phm.facts import LinkFact, LinkProbe
from phm.facts.ros import DIAGNOSTICS, DiagnosticFact
from phm.facts.swarm import SwarmProbe
from phm.transport.priority import MessagePriority


class MavlinkSender(Protocol):
    """The sending side of the MAVLink endpoints (`phm.transport.mavlink.MavlinkHub`)."""

    @property
    def agents(self) -> int:
        """How many agents share the links, this one included."""

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
        """Queue one unpacked pymavlink message for every endpoint, or for the one named `link`; never blocks.

        What leaves first within a link's budget follows from kind, then urgency. A newer message with the same `key`
        replaces this one while it waits. With `only_while` it waits until all of these are true; with `only_replace` it is sent
        only where an older one waits.
        """

    def set_true(self, names: Set[str]) -> None:
        """What is true now, in place of what was before: messages that wait for a link's budget may have become untrue."""

    def links(self) -> tuple[LinkFact, ...]: ...

    def listen(self, callback: Callable[[Any, str], None], ids: Iterable[int]) -> None:
        """Have `callback` called with each received message of these ids and its endpoint's name; it must not wait."""


class DiagnosticsPublisher(Protocol):
    """The way to /diagnostics and /phm/consensus (`phm.probes.ros.supervisor.RosSupervisor`)."""

    def publish(self, statuses: Mapping[str, DiagnosticFact], topic: str = DIAGNOSTICS) -> int:
        """Publish these statuses by name; never blocks. Returns how many times in a row that failed."""

    def idle(self, topic: str = DIAGNOSTICS) -> bool:
        """Whether no node subscribes to the topic, so that an array would reach none. Arrays for a new subscriber follow in two seconds."""


@dataclass(frozen=True, slots=True)
class ReporterSettings:
    """The sections of the configuration that reporters receive (`phm.runtime.sections`).

    interval_s: time between two full passes.
    approval_s: how long an approval is valid (`recovery.approval`).
    options:    `checks.NAME.options` by the name of the check: for a reporter that belongs to such a check.
    """

    agent: AgentSettings
    interval_s: float
    ros: RosSettings
    mavlink: MavlinkSettings
    fleet: FleetSettings
    log: LogSettings
    notify: NotifySettings
    metrics: MetricsSettings
    approval_s: float
    state_dir: str
    run_dir: str
    options: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class ReporterContext:
    """What a reporter may use.

    states: the units as the tracker publishes them, in configuration order.
    newest: the newest result of a unit, published or not; None: there is none, or the unit does not exist.
    alive:  False when the check scheduler hangs; then a reporter must not report that all is OK.
    health: a snapshot of PHM's own condition for `phm status` (JSON-able).
    swarm:  the other agents. armed: whether the autopilot is armed; None: unknown. autopilot: whether this agent's autopilot is received.
    reported_armed: the same by its heartbeats in this run of PHM alone, without what was known before.
    holds: what is on hold, as in `phm status --json`.
    restored: faults that were open, and were reported, before PHM restarted.
    requests: what was requested of the operator for such a fault, or one that recovery has given up on, and is not answered.
    links: what is received on the MAVLink endpoints. queues: how many events wait for each subscriber of the bus, and were dropped.
    machine_boot: id of this start of the machine, in which the monotonic clock goes on; empty: unknown.
    open_faults, given_up: the current faults, also of units that recovery has given up on and that have not been OK since.
    """

    settings: ReporterSettings
    clock: Clock
    boot_id: str
    states: Callable[[], tuple[UnitState, ...]]
    alive: Callable[[], bool]
    health: Callable[[], dict[str, Any]]
    mavlink: MavlinkSender | None = None
    restored: tuple[Fault, ...] = ()
    requests: tuple[ActionEvent, ...] = ()
    ros: DiagnosticsPublisher | None = None
    swarm: SwarmProbe | None = None
    autopilot: Callable[[], bool] | None = None
    armed: Callable[[], bool | None] = lambda: None
    reported_armed: Callable[[], bool | None] = lambda: None
    radio: Callable[[], bool] | None = None
    holds: Callable[[], list[dict[str, Any]]] = list
    open_faults: Callable[[], tuple[Fault, ...]] = tuple
    given_up: Callable[[], tuple[Fault, ...]] = tuple
    newest: Callable[[str], Result | None] = lambda unit: None
    links: LinkProbe | None = None
    queues: Callable[[], dict[str, tuple[int, int]]] = dict
    machine_boot: str = ""


class Reporter(ABC):
    """One destination. `period_s` asks for `tick` that often; `kinds` are the event classes it takes."""

    name: ClassVar[str]
    period_s: ClassVar[float | None] = None
    kinds: ClassVar[tuple[type, ...]] = ()
    queue_size: ClassVar[int] = 1000

    @classmethod
    @abstractmethod
    def build(cls, context: ReporterContext) -> Reporter | None:
        """The reporter, or None when the configuration does not ask for it."""

    @abstractmethod
    def handle(self, event: Event) -> None:
        """Handle one event. An exception is counted and reported, and does not stop the reporter."""

    def tick(self) -> None:
        """Called every `period_s` seconds, between events."""

    def close(self) -> None:
        """Called once at the end, after the last event."""

    def hand_over(self) -> None:
        """Called instead of `close` when the configuration is reloaded: another reporter of its kind follows immediately, so
        it must not report an end.
        """
        self.close()

    def problem(self) -> str:
        """A sentence when the destination cannot be reached, else empty."""
        return ""

    def report(self) -> dict[str, Any]:
        """State of the destination for `phm status`; JSON-able. Empty: nothing to show."""
        return {}
