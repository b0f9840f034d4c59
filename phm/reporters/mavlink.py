"""Reports to the ground: a HEARTBEAT that carries the status word, and a line of text for each change.

`docs/reference/mavlink.md` states what is sent as a contract. The heartbeat stops when the check
scheduler hangs, so that silence means that this agent is not monitored.
"""

from __future__ import annotations

from typing import Any, ClassVar

from phm.core.model import (
    ActionEvent,
    Event,
    FaultClosed,
    FaultOpened,
    HoldChanged,
    Report,
    Slot,
    Transition,
    UnitState,
    worst_by_slot,
)
from phm.core.rate_limiter import TokenBucket
from phm.reporters.base import MavlinkSender, Reporter, ReporterContext
from phm.reporters.flap_damping import FlapDamper
from phm.reporters.gcs_presence import GcsPresence
from phm.reporters.statustext import StatusTextBuilder, StatusTextLine, while_asked, while_bad
from phm.reporters.swarm import MISSED_HEARTBEATS
from phm.transport.dialect import mavlink
from phm.transport.priority import MessagePriority, default_periods
from phm.wire import status_line, status_word
from phm.wire.command import STATUSTEXT, requested_key
from phm.wire.status_line import Severity

PEERS = "peers/"
"""Units about other agents."""
FULL_EVERY_S = 5.0
"""Ground stations that come and go have the full state sent again at most this often."""
FULL_BURST = 3
"""Full states that may follow each other like this. Then one is sent in the period of the refresh: a sender that uses one system id
after another must not fill the link with them."""
AGAIN_S = (0.7, 2.0, 4.0)
"""After a change while the radio is bad its line may be lost, so refreshes follow after these times; they are not spoken."""
SPREAD_S = 0.02
"""Seconds by which agents' answers to the same ground station differ, times the agent's number: as long as a 64 kbit/s radio
needs for a heartbeat and a refresh."""


class MavlinkReporter(Reporter):
    """See the module. All but `_receive` runs in the bus's thread for this reporter."""

    name = "mavlink"
    period_s: ClassVar[float | None] = 0.2
    kinds = (Transition, FaultOpened, FaultClosed, ActionEvent, HoldChanged, Report)

    def __init__(self, context: ReporterContext, port: MavlinkSender) -> None:
        self._context, self._port = context, port
        self._settings, self._agent = context.settings.mavlink, context.settings.agent.id
        now = context.clock.mono()
        self._builder, self._damper = StatusTextBuilder(self._agent, context.settings.approval_s), FlapDamper()
        open_before = {fault.unit for fault in context.restored}
        states = {state.unit: state for state in context.states()}
        self._builder.restore_reported([state for unit, state in states.items() if unit in open_before])
        for request in context.requests:
            self._builder.action(request, states)  # its line is sent to each ground station that appears
        self._heartbeat_at = now
        self._refresh_at: float | None = None
        self._again: tuple[float, ...] = ()
        self._full_at: float | None = None
        self._last_full, self._full_room = float("-inf"), TokenBucket(FULL_BURST, now)
        self._left_to_leader: dict[str, tuple[StatusTextLine, float]] = {}
        """By key, the newest line about another agent that only the leader sends, and when."""
        self._said_alone: frozenset[str] = frozenset()
        """Keys of failures sent while this agent received no other one: it sends their end, too."""
        self._stations = GcsPresence(self._agent, self._settings.gcs_timeout)
        port.listen(self._receive, (mavlink.MAVLINK_MSG_ID_HEARTBEAT,))

    @classmethod
    def build(cls, context: ReporterContext) -> MavlinkReporter | None:
        return cls(context, context.mavlink) if context.mavlink is not None else None

    def handle(self, event: Event) -> None:
        if isinstance(event, Transition):
            self._change(self._builder.transition(event), event.state.slot, status_line.brief_of(event.state))
        elif isinstance(event, (FaultOpened, FaultClosed)):
            fault = event.fault
            if isinstance(event, FaultOpened):
                self._damper.begin_failure(fault.unit)
            self._change(self._builder.fault(event), fault.slot, fault.result.brief or fault.unit)
        elif isinstance(event, ActionEvent):
            self._say(self._builder.action(event, {state.unit: state for state in self._context.states()}))
        elif isinstance(event, HoldChanged):
            self._say(self._builder.hold(event))
        elif isinstance(event, Report) and self._refresh_at is None:
            self._refresh_at = self._context.clock.mono()
        self._set_true()

    def tick(self) -> None:
        """Send heartbeat, refresh and the full state when due, while the check scheduler runs."""
        now = self._context.clock.mono()
        self._say(self._damper.settled(now, self._still_true))
        self._take_over(now)
        if self._context.alive():
            if now >= self._heartbeat_at:
                self._heartbeat_at = _next(self._heartbeat_at, self._heartbeat_s(), now)
                self._heartbeat()
            if self._full_at is not None and now >= self._full_at and self._full_allowed(now):
                self._full_at, self._last_full = None, now
                self._heartbeat()
                self._say(self._builder.full(self._context.states()))
            elif self._refresh_at is not None and now >= self._refresh_at:
                self._refresh_at = _next(self._refresh_at, self._refresh_s(), now)
                states = self._context.states()
                self._say([*self._builder.reconcile(states), self._builder.refresh(states)])
            elif self._again and now >= self._again[0]:
                self._again = self._again[1:]
                self._say_again()
        self._set_true()

    def close(self) -> None:
        """Send a last heartbeat with POWEROFF: a planned end is not a failure."""
        self._send_heartbeat(self._context.states(), mavlink.MAV_STATE_POWEROFF)

    def hand_over(self) -> None:
        """Send nothing: the next reporter continues."""

    def gcs_appeared(self) -> None:
        """Send the full state soon: a new ground station has received nothing yet."""
        if self._full_at is None:
            soon = self._context.clock.mono() + SPREAD_S * self._agent
            self._full_at = max(soon, self._last_full + FULL_EVERY_S)

    def _full_allowed(self, now: float) -> bool:
        self._full_room.refill(now, 1 / self._refresh_s(), FULL_BURST)
        return self._full_room.take()

    def _heartbeat_s(self) -> float:
        return self._settings.heartbeat or default_periods(self._port.agents)[0]

    def _refresh_s(self) -> float:
        return self._settings.refresh or default_periods(self._port.agents)[1]

    def _receive(self, message: Any, link: str) -> None:
        """A HEARTBEAT, in an endpoint's thread."""
        if self._stations.appears(message, self._context.clock.mono()):
            self.gcs_appeared()

    def _change(self, lines: list[StatusTextLine], slot: Slot, brief: str) -> None:
        """Send changes of one unit, unless it flaps."""
        if lines and self._refresh_at is not None:
            self._again = tuple(self._context.clock.mono() + after_s for after_s in AGAIN_S)
        flapping = status_line.flapping(self._agent, slot, brief)
        self._say(self._damper.filter(lines, self._context.clock.mono(), flapping))

    def _still_true(self, line: StatusTextLine) -> bool:
        """Whether a line that was held back may be sent now. The unit of a failure may be unknown by now, or blocked."""
        if line.severity > Severity.WARNING:
            return True
        return any(state.unit == line.key and state.level.bad for state in self._context.states())

    def _say_again(self) -> None:
        states = self._context.states()
        if any(state.slot is Slot.RADIO and state.level.bad for state in states):
            self._say([self._builder.refresh(states)])

    def _leads(self) -> bool:
        """Whether this agent is the leader of the swarm: each agent detects a lost peer, and the leader reports it."""
        swarm = self._context.swarm
        return swarm is None or swarm.snapshot().leader == self._agent

    def _alone(self) -> bool:
        """Whether this agent receives no other one: what it reports then is about itself, and if all others died no one else does."""
        swarm = self._context.swarm
        return swarm is not None and self._agent in swarm.snapshot().receive_none

    def _take_over(self, now: float) -> None:
        """As the new leader, send what the last one may not have sent before it or its radio failed; the rest would be a
        repetition.
        """
        heartbeat_s = self._heartbeat_s()
        missed_s = max(MISSED_HEARTBEATS * heartbeat_s, self._settings.gcs_timeout + heartbeat_s)
        recent = {key: (line, at) for key, (line, at) in self._left_to_leader.items() if now - at <= missed_s}
        self._left_to_leader = recent
        if recent and (self._leads() or self._alone()):
            self._say([line for line, _ in recent.values()])

    def _set_true(self) -> None:
        """Lines that wait for a link's budget are sent only while they are true. After new lines: they replace outdated ones."""
        names = {while_bad(state.unit) for state in self._context.states() if state.level.bad}
        names |= {while_asked(unit) for unit in self._builder.asked()}
        self._port.set_true(names)

    def _say(self, lines: list[StatusTextLine]) -> None:
        for line in lines:
            if line.key.startswith(PEERS):
                alone = self._alone()
                if not (self._leads() or alone or line.key in self._said_alone):
                    self._left_to_leader[line.key] = (line, self._context.clock.mono())
                    continue
                self._left_to_leader.pop(line.key, None)
                ended = line.severity > Severity.WARNING
                self._said_alone = (
                    self._said_alone - {line.key} if ended or not alone else self._said_alone | {line.key}
                )
            # A text that was limited takes turns with the refresh line, which would otherwise wait for it without an end.
            urgency = Severity.INFO if line.kind is MessagePriority.REFRESH else line.severity
            self._port.send(
                _statustext(line), line.kind, key=line.key, urgency=int(urgency), only_while=line.only_while
            )
        if any(line.kind is MessagePriority.TRANSITION for line in lines):
            self._renew_refresh()

    def _renew_refresh(self) -> None:
        """A refresh that waits for a link's budget, also a requested one, leaves after the lines about changes, and must not deny them."""
        line = self._builder.refresh(self._context.states())
        self._port.send(_statustext(line), line.kind, key=line.key, urgency=int(line.severity), only_replace=True)
        key = requested_key(STATUSTEXT)
        self._port.send(_statustext(line), MessagePriority.REQUEST, key=key, urgency=1, only_replace=True)

    def _heartbeat(self) -> None:
        states = self._context.states()
        self._send_heartbeat(states, status_word.system_status(states, complete=self._refresh_at is not None))

    def _send_heartbeat(self, states: tuple[UnitState, ...], system_status: int) -> None:
        word = status_word.encode(worst_by_slot(states))
        kind, autopilot = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
        self._port.send(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, word, system_status, 3))


def _statustext(line: StatusTextLine) -> Any:
    return mavlink.MAVLink_statustext_message(int(line.severity), line.text.encode("ascii"))


def _next(due: float, period_s: float, now: float) -> float:
    """When it is due again: in step with before, unless a turn was missed; missed turns are not repeated."""
    return due + period_s if due + period_s > now else now + period_s
