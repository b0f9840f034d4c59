"""To the other agents: this one's view of them. To the ground, by the elected speaker: the swarm in one line.

`docs/reference/swarm.md` states what is sent as a contract; all of it is bound by the links' budgets, after changes of the agent itself.
"""

from __future__ import annotations

import threading
from typing import Any, ClassVar

from phm.core.model import Event, worst_by_slot
from phm.facts.swarm import SwarmFact, SwarmProbe
from phm.reporters.base import MavlinkPort, Reporter, ReporterContext
from phm.reporters.flap_damping import Damper
from phm.reporters.gcs_presence import Stations
from phm.reporters.statustext import Line
from phm.swarm import digest
from phm.swarm.consensus import Consensus, State, Verdict
from phm.transport.dialect import mavlink
from phm.transport.priority import Class, periods
from phm.wire import status_word, tunnel
from phm.wire.status_line import Severity
from phm.wire.tunnel import Seen, View

VIEW_HEARTBEATS = 20
"""A view every so many heartbeats when nothing changes; at once when something does, and once more a heartbeat later."""
CALM_S = 1.0
"""Changes within this time, or half a heartbeat, go out as one view: agents are lost and found in groups."""
TUNNEL_BYTES = 128
UNTOLD_HEARTBEATS = 6
"""A speaker is known to be lost after five of its heartbeats: what became so within them it may not have told."""
RELAY = "relay "


class Swarm(Reporter):
    """See the module. All but `_hear` runs in the bus's thread for this reporter."""

    name = "swarm"
    period_s: ClassVar[float | None] = 0.4
    kinds = ()

    def __init__(self, context: ReporterContext, port: MavlinkPort, probe: SwarmProbe) -> None:
        self._context, self._port, self._probe = context, port, probe
        self._agent = context.settings.agent.id
        self._sequence = 0
        self._viewed: object = None
        self._again = False
        self._view_at = float("-inf")
        self._told_line, self._line_at = "", float("-inf")
        self._relayed: dict[int, tuple[object, float]] = {}
        """What the ground was told for each agent that cannot reach it, by this or another speaker, and since when it is so."""
        self._spoke, self._damper = False, Damper()
        self._stations = Stations(self._agent, context.settings.mavlink.gcs_timeout)
        self._appeared = threading.Event()
        port.listen(self._hear, (mavlink.MAVLINK_MSG_ID_HEARTBEAT,))

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
        speaks = fact.speaker == self._agent
        if speaks and self._appeared.is_set():
            self._told_line, self._relayed = "", {}
        elif speaks and not self._spoke:
            # What the last speaker may have been lost with, untold, is told; the rest would be repeated aloud.
            untold_s = UNTOLD_HEARTBEATS * self._heartbeat_s()
            self._relayed = {agent: told for agent, told in self._relayed.items() if now - told[1] > untold_s}
        self._appeared.clear()
        self._spoke = speaks
        if speaks:
            self._speak(fact, now)
        else:
            self._told_line = ""
            self._relay(fact, now)

    def _hear(self, message: Any, link: str) -> None:
        """A HEARTBEAT, in an endpoint's thread."""
        if self._stations.appears(message, self._context.clock.mono()):
            self._appeared.set()

    def _heartbeat_s(self) -> float:
        return self._context.settings.mavlink.heartbeat or periods(self._port.agents)[0]

    # ------------------------------------------------------------ to the agents

    def _view(self, fact: SwarmFact, now: float) -> None:
        pilot, radio = (ask is not None and ask() for ask in (self._context.pilot, self._context.radio))
        seen = {agent: _seen(peer.state, self._agent in peer.heard_by) for agent, peer in fact.peers.items()}
        said = (fact.gcs, pilot, radio, tuple(sorted(seen.items())))
        heartbeat_s = self._heartbeat_s()
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
        payload = tunnel.encode(View(self._sequence, fact.gcs, pilot, radio, seen))
        for link in fact.links:
            self._port.send(_tunnel(payload), Class.SWARM, key="view", link=link)

    # ------------------------------------------------------------ to the ground

    def _speak(self, fact: SwarmFact, now: float) -> None:
        agreed = _consensus(fact)
        word = status_word.encode(worst_by_slot(self._context.states()))
        levels = digest.levels(agreed, word, fact.deaf)
        self._tell(self._relay(fact, now), fact, now)
        line = digest.line(levels)
        refresh_s = self._context.settings.mavlink.refresh or periods(self._port.agents)[1]
        since_s = now - self._line_at
        if since_s < CALM_S or (line == self._told_line and since_s < refresh_s):
            return
        changed = line != self._told_line
        self._told_line, self._line_at = line, now
        self._port.send(_tunnel(tunnel.encode(digest.digest(agreed, levels))), Class.SWARM, key="digest")
        # INFO is shown and never spoken: each agent speaks for itself, and the speaker's own check for the lost ones.
        self._say(line, Severity.INFO, "swarm line", Class.TRANSITION if changed else Class.REFRESH)

    def _relay(self, fact: SwarmFact, now: float) -> list[Line]:
        """What agents that cannot reach the ground would say, once for each change."""
        lines = []
        for agent in fact.deaf:
            peer = fact.peers.get(agent)
            if peer is None:
                continue
            said = digest.worst(peer.word, deaf=True)
            if agent not in self._relayed or self._relayed[agent][0] != said:
                self._relayed[agent] = (said, now)
                text, severity = digest.relay(agent, peer.heard_by, peer.word), digest.relay_severity(peer.word)
                lines.append(Line(f"{RELAY}{agent}", severity, text))
        for agent in [agent for agent in self._relayed if agent not in fact.deaf]:
            del self._relayed[agent]
        return lines

    def _tell(self, lines: list[Line], fact: SwarmFact, now: float) -> None:
        """These lines, unless their agent comes and goes again and again; then its last one when that has ended."""
        deaf = {f"{RELAY}{agent}" for agent in fact.deaf}
        told = [line for line in self._damper.calm(now) if line.key in deaf]
        for line in lines:
            told += self._damper.through([line], now, digest.flapping(int(line.key.removeprefix(RELAY))))
        for line in told:
            self._say(line.text, line.severity, line.key, line.kind)

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
