"""To the other agents: this one's view of them. To the ground, by the elected speaker: the swarm in one line.

`docs/swarm.md` states what is sent as a contract; all of it is bound by the links' budgets, after changes of the agent itself.
"""

from __future__ import annotations

from typing import Any, ClassVar

from phm.model import Event, worst_by_slot
from phm.reporters.base import MavlinkPort, Reporter, ReporterContext
from phm.swarm import digest
from phm.swarm.consensus import Consensus, State, Verdict
from phm.swarm_facts import SwarmFact, SwarmProbe
from phm.transport.dialect import mavlink
from phm.transport.mavlink_budget import Class, periods
from phm.wire import status_word, tunnel
from phm.wire.status_line import Severity
from phm.wire.tunnel import Seen, View

VIEW_HEARTBEATS = 20
"""A view every so many heartbeats when nothing changes; at once when something does, and once more a heartbeat later."""
CALM_S = 1.0
"""Changes within this time, or half a heartbeat, go out as one view: agents are lost and found in groups."""
TUNNEL_BYTES = 128


class Swarm(Reporter):
    """See the module. All of it runs in the bus's thread for this reporter."""

    name = "swarm"
    period_s: ClassVar[float | None] = 0.2
    kinds = ()

    def __init__(self, context: ReporterContext, port: MavlinkPort, probe: SwarmProbe) -> None:
        self._context, self._port, self._probe = context, port, probe
        self._agent = context.settings.agent.id
        self._sequence = 0
        self._viewed: object = None
        self._again = False
        self._view_at = float("-inf")
        self._told_line, self._line_at = "", float("-inf")
        self._relayed: dict[int, object] = {}

    @classmethod
    def build(cls, context: ReporterContext) -> Swarm | None:
        if context.mavlink is None or context.swarm is None:
            return None
        return cls(context, context.mavlink, context.swarm)

    def handle(self, event: Event) -> None:
        """Nothing: the swarm is looked at, not told."""

    def tick(self) -> None:
        if not self._context.alive():
            return
        fact, now = self._probe.look(), self._context.clock.mono()
        if not fact.peers:
            return
        self._view(fact, now)
        if fact.speaker == self._agent:
            self._speak(fact, now)
        else:
            self._told_line, self._relayed = "", {}

    # ------------------------------------------------------------ to the agents

    def _view(self, fact: SwarmFact, now: float) -> None:
        pilot = self._context.pilot() if self._context.pilot is not None else False
        seen = {agent: _seen(peer.state, self._agent in peer.heard_by) for agent, peer in fact.peers.items()}
        said = (fact.gcs, pilot, tuple(sorted(seen.items())))
        heartbeat_s = self._context.settings.mavlink.heartbeat or periods(fact.members)[0]
        since_s = now - self._view_at
        if said == self._viewed:
            if since_s < (heartbeat_s if self._again else VIEW_HEARTBEATS * heartbeat_s):
                return
            self._again = False
        elif since_s < max(CALM_S, heartbeat_s / 2):
            return
        else:
            self._again = True
        self._viewed, self._view_at = said, now
        self._sequence = (self._sequence + 1) % 256
        payload = tunnel.encode(View(self._sequence, fact.gcs, pilot, False, seen))
        for link in fact.links:
            self._port.send(_tunnel(payload), Class.SWARM, key="view", link=link)

    # ------------------------------------------------------------ to the ground

    def _speak(self, fact: SwarmFact, now: float) -> None:
        agreed = _consensus(fact)
        word = status_word.encode(worst_by_slot(self._context.states()))
        levels = digest.levels(agreed, word, fact.deaf)
        self._relay(fact)
        line = digest.line(levels)
        refresh_s = self._context.settings.mavlink.refresh or periods(fact.members)[1]
        since_s = now - self._line_at
        if since_s < CALM_S or (line == self._told_line and since_s < refresh_s):
            return
        changed = line != self._told_line
        self._told_line, self._line_at = line, now
        self._port.send(_tunnel(tunnel.encode(digest.digest(agreed, levels))), Class.SWARM, key="digest")
        # INFO is shown and never spoken: each agent speaks for itself, and the speaker's own check for the lost ones.
        self._say(line, Severity.INFO, "swarm line", Class.TRANSITION if changed else Class.REFRESH)

    def _relay(self, fact: SwarmFact) -> None:
        """Say for agents that cannot reach the ground what they would say, once for each change."""
        for agent in fact.deaf:
            peer = fact.peers.get(agent)
            if peer is None:
                continue
            said = digest.worst(peer.word, deaf=True)
            if self._relayed.get(agent) == said:
                continue
            self._relayed[agent] = said
            self._say(
                digest.relay(agent, peer.heard_by, peer.word),
                digest.relay_severity(peer.word),
                f"relay {agent}",
                Class.TRANSITION,
            )
        for agent in [agent for agent in self._relayed if agent not in fact.deaf]:
            del self._relayed[agent]

    def _say(self, text: str, severity: Severity, key: str, kind: Class) -> None:
        message = mavlink.MAVLink_statustext_message(int(severity), text.encode("ascii"))
        self._port.send(message, kind, key=key, urgency=int(severity))


def _seen(state: str, heard: bool) -> Seen:
    """How this agent alone sees it: what the swarm agrees on must not echo back as evidence."""
    if state == State.NEVER.value:
        return Seen.NEVER
    return Seen.ALIVE if heard else Seen.LOST


def _consensus(fact: SwarmFact) -> Consensus:
    verdicts = {
        agent: Verdict(State(peer.state), peer.heard_by, peer.unheard_by, peer.gcs, peer.word)
        for agent, peer in fact.peers.items()
    }
    return Consensus(fact.own, verdicts, split=fact.split)


def _tunnel(payload: bytes) -> Any:
    filled = list(payload.ljust(TUNNEL_BYTES, b"\0"))
    return mavlink.MAVLink_tunnel_message(0, 0, tunnel.PAYLOAD_TYPE, len(payload), filled)
