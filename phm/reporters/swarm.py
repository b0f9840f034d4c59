"""Sends this agent's view to the other agents, and, as the elected leader, the swarm's status to the ground.

`docs/reference/swarm.md` states what is sent as a contract. The links' budgets apply; changes of the agent itself come first.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any, ClassVar

from phm.core.model import Event, worst_by_slot
from phm.core.rate_limiter import TokenBucket
from phm.facts.swarm import PeerFact, SwarmFact, SwarmProbe
from phm.reporters.base import MavlinkSender, Reporter, ReporterContext
from phm.reporters.flap_damping import FlapDamper
from phm.reporters.gcs_presence import GcsPresence
from phm.reporters.statustext import StatusTextLine
from phm.swarm import digest
from phm.swarm.consensus import Consensus, MemberState, MemberStatus
from phm.swarm.peers import LOST_PERIODS
from phm.transport.dialect import mavlink
from phm.transport.priority import MessagePriority, default_periods
from phm.wire import status_word, tunnel
from phm.wire.status_line import Severity
from phm.wire.tunnel import PeerState, PeerView

VIEW_HEARTBEATS = 20
"""Heartbeats between two views without a change. A view is also sent immediately after a change, and again a heartbeat later."""
CALM_S = 1.0
"""Changes within this time, or half a heartbeat, go out as one view: agents are lost and found in groups."""
GROUND_S = 3.0
"""An agent that was started now says only after this time that it receives no ground station: their heartbeats come once a second."""
TUNNEL_BYTES = 128
MISSED_HEARTBEATS = 6
"""The loss of a leader is detected after five of its heartbeats: it may not have reported changes within them."""
RELAY = "relay "
REPEATS = 3
"""How often the lines may be repeated one after another for new ground stations. Then once in the period of the refresh: a sender that
uses one system id after another must not fill the link."""


class SwarmReporter(Reporter):
    """See the module. All but `_receive` runs in the bus's thread for this reporter."""

    name = "swarm"
    period_s: ClassVar[float | None] = 0.4
    kinds = ()

    def __init__(self, context: ReporterContext, port: MavlinkSender, probe: SwarmProbe) -> None:
        self._context, self._port, self._probe = context, port, probe
        self._agent, self._settings = context.settings.agent.id, context.settings.mavlink
        self._sequence = 0
        self._viewed: object = None
        self._restarts = 0
        """Of all peers, when the last view was sent."""
        self._again = False
        self._view_at = float("-inf")
        self._sent_line, self._line_at, self._line_again = "", float("-inf"), False
        self._relayed: dict[int, tuple[object, float]] = {}
        """The report sent for each agent that cannot reach the ground, by this or another leader, and when it became so."""
        self._spoke, self._damper = False, FlapDamper(every_line=True)
        self._stations = GcsPresence(self._agent, self._settings.gcs_timeout)
        self._appeared = threading.Event()
        self._repeats, self._repeating = TokenBucket(REPEATS, context.clock.mono()), False
        port.listen(self._receive, (mavlink.MAVLINK_MSG_ID_HEARTBEAT,))

    @classmethod
    def build(cls, context: ReporterContext) -> SwarmReporter | None:
        if context.mavlink is None or context.swarm is None:
            return None
        return cls(context, context.mavlink, context.swarm)

    def handle(self, event: Event) -> None:
        """Ignored: the swarm is polled."""

    def tick(self) -> None:
        if not self._context.alive():
            return
        fact, now = self._probe.snapshot(), self._context.clock.mono()
        if not fact.peers:
            return
        self._view(fact, now)
        leads = fact.leader == self._agent
        self._repeating = leads and self._appeared.is_set() and self._may_repeat(now)
        if self._repeating:
            self._line_again, self._relayed = True, {}
        elif leads and not self._spoke:
            # Send what the last leader may not have sent before it was lost; the rest would be a repetition.
            missed_s = MISSED_HEARTBEATS * self._heartbeat_s()
            self._relayed = {agent: sent for agent, sent in self._relayed.items() if now - sent[1] > missed_s}
        if self._repeating or not leads:
            self._appeared.clear()
        self._spoke = leads
        if leads:
            self._speak(fact, now)
        else:
            self._sent_line = ""
            self._relay(fact, now)

    def _receive(self, message: Any, link: str) -> None:
        """A HEARTBEAT, in an endpoint's thread."""
        if self._stations.appears(message, self._context.clock.mono()):
            self._appeared.set()

    def _heartbeat_s(self) -> float:
        return self._settings.heartbeat or default_periods(self._port.agents)[0]

    def _refresh_s(self) -> float:
        return self._settings.refresh or default_periods(self._port.agents)[1]

    def _may_repeat(self, now: float) -> bool:
        self._repeats.refill(now, 1 / self._refresh_s(), REPEATS)
        return self._repeats.take()

    # ------------------------------------------------------------ to the agents

    def _view(self, fact: SwarmFact, now: float) -> None:
        if fact.up_s < GROUND_S and not fact.gcs:
            return
        autopilot, radio = (ask is not None and ask() for ask in (self._context.autopilot, self._context.radio))
        new = fact.up_s < LOST_PERIODS * self._heartbeat_s()
        seen = {agent: _seen(peer, self._agent in peer.received_by, new) for agent, peer in fact.peers.items()}
        said = (fact.gcs, autopilot, radio, tuple(sorted(seen.items())))
        heartbeat_s = self._heartbeat_s()
        since_s = now - self._view_at
        restarts = sum(peer.restarts for peer in fact.peers.values())
        if said == self._viewed and restarts != self._restarts and since_s >= LOST_PERIODS * heartbeat_s:
            # An agent that was started again has no views: it must not lead beside the leader until the next ones are due.
            self._again = False
        elif said == self._viewed:
            if since_s < (heartbeat_s if self._again else VIEW_HEARTBEATS * heartbeat_s):
                return
            self._again = False
        elif since_s < max(CALM_S, heartbeat_s / 2):
            return
        else:
            self._again = True
        self._viewed, self._view_at, self._restarts = said, now, restarts
        self._sequence = (self._sequence + 1) % 256
        payload = tunnel.encode(PeerView(self._sequence, fact.gcs, autopilot, radio, seen))
        for link in fact.links:
            self._port.send(_tunnel(payload), MessagePriority.SWARM, key="view", link=link)

    # ------------------------------------------------------------ to the ground

    def _speak(self, fact: SwarmFact, now: float) -> None:
        agreed = _consensus(fact)
        word = status_word.encode(worst_by_slot(self._context.states()))
        levels = digest.member_levels(agreed, word, fact.no_gcs)
        self._send_lines(self._relay(fact, now), fact, now)
        line = digest.digest_line(levels)
        refresh_s = self._refresh_s()
        since_s = now - self._line_at
        if since_s < CALM_S or (line == self._sent_line and not self._line_again and since_s < refresh_s):
            return
        same_kind = MessagePriority.STATE if self._line_again else MessagePriority.REFRESH
        kind = same_kind if line == self._sent_line else MessagePriority.TRANSITION
        self._sent_line, self._line_at, self._line_again = line, now, False
        self._port.send(
            _tunnel(tunnel.encode(digest.swarm_digest(agreed, levels))), MessagePriority.SWARM, key="digest"
        )
        # INFO is shown and not spoken: each agent reports its own failures, and the leader's check the lost agents.
        self._say(StatusTextLine("swarm line", Severity.INFO, line, kind))

    def _relay(self, fact: SwarmFact, now: float) -> list[StatusTextLine]:
        """The reports for agents that cannot reach the ground, once for each change."""
        lines = []
        for agent in fact.no_gcs:
            peer = fact.peers.get(agent)
            if peer is None:
                continue
            said = digest.worst_slot(peer.word, no_gcs=True)
            if agent not in self._relayed or self._relayed[agent][0] != said:
                self._relayed[agent] = (said, now)
                text, severity = digest.relay_line(agent, peer.received_by, peer.word), digest.relay_severity(peer.word)
                lines.append(StatusTextLine(f"{RELAY}{agent}", severity, text))
        for agent in [agent for agent in self._relayed if agent not in fact.no_gcs]:
            del self._relayed[agent]
        return lines

    def _send_lines(self, lines: list[StatusTextLine], fact: SwarmFact, now: float) -> None:
        """Send these lines, unless their agent flaps; then its last line when it is stable. Repetitions are not changes."""
        keys = {f"{RELAY}{agent}" for agent in fact.no_gcs}
        passed = [line for line in self._damper.settled(now) if line.key in keys]
        passed += [replace(line, kind=MessagePriority.STATE) for line in lines if self._repeating]
        for line in lines if not self._repeating else ():
            passed += self._damper.filter([line], now, digest.flapping_line(int(line.key.removeprefix(RELAY))))
        for line in passed:
            self._say(line)

    def _say(self, line: StatusTextLine) -> None:
        message = mavlink.MAVLink_statustext_message(int(line.severity), line.text.encode("ascii"))
        self._port.send(message, line.kind, key=line.key, urgency=int(line.severity))


def _seen(peer: PeerFact, received: bool, new: bool) -> PeerState:
    """Its state as seen by this agent alone: the consensus must not count as evidence for itself. new: this agent was started only now,
    and may not have received each heartbeat yet."""
    if peer.state == MemberState.NEVER.value or (new and peer.age_s is None):
        return PeerState.NEVER
    return PeerState.ALIVE if received else PeerState.LOST


def _consensus(fact: SwarmFact) -> Consensus:
    statuses = {
        agent: MemberStatus(MemberState(peer.state), peer.received_by, peer.not_received_by, peer.gcs, peer.word)
        for agent, peer in fact.peers.items()
    }
    return Consensus(fact.own, statuses, split=fact.split)


def _tunnel(payload: bytes) -> Any:
    filled = list(payload.ljust(TUNNEL_BYTES, b"\0"))
    return mavlink.MAVLink_tunnel_message(0, 0, tunnel.PAYLOAD_TYPE, len(payload), filled)
