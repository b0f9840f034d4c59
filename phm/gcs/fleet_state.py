"""Turns received frames into events. Pure; the caller brings time.

Agents are discovered by their heartbeats; their clocks are not used. A line counts as PHM's only when a PHM sent it about
its own agent, or about another one in a line that is made for that.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

from phm.core.model import Stamp
from phm.gcs import frames, snapshot, statustext_parser
from phm.gcs.agent import PHM_COMPONENT, Agent, ReceivedText
from phm.gcs.events import GcsEvent
from phm.gcs.fleet import Fleet
from phm.gcs.frames import (
    ARMED,
    GCS,
    NO_AUTOPILOT,
    ONBOARD_CONTROLLER,
    POWEROFF,
    CommandAck,
    ComputerStatus,
    Frame,
    Heartbeat,
    NamedValue,
    RadioStatus,
    StatusText,
    TunnelPayload,
)
from phm.gcs.presence import PresenceState
from phm.gcs.statustext_parser import LineKind, ParsedLine
from phm.wire import tunnel
from phm.wire.command import REPLY_TEXT
from phm.wire.text import one_line
from phm.wire.tunnel import AGENTS, PAYLOAD_TYPE, FaultDetail, PeerView, StatusWords, SwarmDigest, TunnelError

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""


class FleetState:
    """Derives the fleet's state and its events from frames. Not thread-safe: the caller holds a lock."""

    def __init__(self, expected: Iterable[int] = (), own: tuple[int, int] = (0, 0), *, signed: bool = False) -> None:
        """expected: agents to report as missing even if never received. own: our own MAVLink ids, which are ignored. signed:
        unsigned frames are not PHM's."""
        self.fleet, self._own, self._signed = Fleet(expected), own, signed

    def receive(self, frame: Frame, link: str, at: Stamp) -> list[GcsEvent]:
        """Take one received frame; the events that follow."""
        if (frame.system, frame.component) == self._own:
            return []
        if isinstance(frame, Heartbeat):
            return list(self._beat(frame, link, at))
        if isinstance(frame, StatusText):
            return list(self._said(frame, link, at))
        if isinstance(frame, RadioStatus):
            self.fleet.radio(link, frame, at.mono)
            return []
        if isinstance(frame, CommandAck):
            return list(self._ack(frame, at))
        if isinstance(frame, (ComputerStatus, NamedValue)):
            return []  # for those who watch the frames
        return list(self._payload(frame, at))

    def is_agent(self, beat: Heartbeat) -> bool:
        """Whether it is the heartbeat of a PHM, signed where that is required."""
        if beat.kind == GCS or beat.autopilot != NO_AUTOPILOT:
            return False
        return _is_phm(beat) and (beat.signed or not self._signed)

    def links(self, found: Mapping[str, tuple[bool, str]], at: Stamp) -> list[GcsEvent]:
        """Take the state of the ground's own links by name: whether open, and if not why."""
        known = self.fleet.links
        changed = {name: how for name, how in found.items() if name not in known or known[name][0] is not how[0]}
        self.fleet.links = dict(found)
        return [GcsEvent(at, "link", {"link": name, "open": how[0], "error": how[1]}) for name, how in changed.items()]

    def tick(self, at: Stamp) -> list[GcsEvent]:
        """The events that follow from the passing of time. Call it a few times a second."""
        found: list[GcsEvent] = []
        if self.fleet.began is None:
            self.fleet.began = at.mono
        for system, autopilot in self.fleet.autopilots.items():
            lost = autopilot.phase(at.mono) is PresenceState.LOST
            if lost and autopilot.shown is not PresenceState.LOST:
                autopilot.shown = PresenceState.LOST
                found.append(
                    GcsEvent(at, "autopilot", {"system": system, **snapshot.autopilot_fields(autopilot, at.mono)})
                )
        for agent in self.fleet.agents.values():
            found += self._presence(agent, at)
        current = self.fleet.snapshot(at.mono)
        for agent in self.fleet.agents.values():
            hop = current.hop(agent)
            # The evidence counts seconds of silence: those are not events.
            key = None if hop is None else (hop.name, hop.certain)
            if key != agent.hop:
                agent.hop = key
                found.append(GcsEvent(at, "hop", {**snapshot.who(agent), "hop": snapshot.hop(hop)}))
        return found

    def snapshot(self, at: Stamp, *, moments: bool = False, only: Collection[int] | None = None) -> dict[str, Any]:
        """The state of all agents, JSON-able: `snapshot.fleet_json`."""
        return snapshot.fleet_json(self.fleet, at, moments=moments, only=only)

    # ------------------------------------------------------------ heartbeats

    def _beat(self, beat: Heartbeat, link: str, at: Stamp) -> Iterator[GcsEvent]:
        if beat.kind == GCS:
            self.fleet.station(beat.system, beat.component, at.mono, leaving=beat.state == POWEROFF)
        elif beat.autopilot != NO_AUTOPILOT:
            if beat.component == AUTOPILOT:
                yield from self._autopilot(beat, at)
        elif self.is_agent(beat):
            agent = self.fleet.agent(beat.system, beat.component, at.mono)
            if agent is not None:
                yield from self._agent(agent, beat, link, at)

    def _agent(self, agent: Agent, beat: Heartbeat, link: str, at: Stamp) -> Iterator[GcsEvent]:
        agent.presence.heartbeat(at.mono, leaving=beat.state == POWEROFF)
        agent.link, agent.last = link, at
        if agent.first is None:
            agent.first, agent.shown = at, PresenceState.ALIVE
            ids = {"system": agent.system, "component": agent.component, "link": link}
            yield GcsEvent(at, "agent", {**snapshot.who(agent), **ids})
        state, restarts, problem = agent.state, agent.restarts, agent.problem
        changed = agent.heartbeat(beat)
        yield from self._presence(agent, at)
        if agent.restarts != restarts:
            yield GcsEvent(at, "restart", {**snapshot.who(agent), "restarts": agent.restarts})
        if agent.problem and agent.problem != problem:
            yield GcsEvent(at, "problem", {"text": f"{agent.name}: {agent.problem}"})
        if changed or agent.state != state:
            names = {str(int(slot)): [old.name, new.name] for slot, (old, new) in changed.items()}
            yield GcsEvent(at, "slots", {**snapshot.who(agent), **snapshot.word(agent), "changed": names})

    def _presence(self, agent: Agent, at: Stamp) -> Iterator[GcsEvent]:
        """Lost, left and back are events; a late agent may have lost a frame, which is only counted."""
        state = self.fleet.state(agent, at.mono)
        late = state is PresenceState.LATE
        if late and not agent.is_late:
            agent.late += 1
        agent.is_late = late
        shown = PresenceState.ALIVE if state is PresenceState.LATE else state
        if shown is agent.shown:
            return
        was, agent.shown = agent.shown, shown
        silent_s = snapshot.seconds(agent.presence.silent_s(at.mono))
        yield GcsEvent(
            at, "presence", {**snapshot.who(agent), "presence": shown.value, "was": was.value, "silent_s": silent_s}
        )

    def _autopilot(self, beat: Heartbeat, at: Stamp) -> Iterator[GcsEvent]:
        autopilot = self.fleet.autopilot(beat.system, at.mono)
        if autopilot is None:
            return
        before = (autopilot.armed, autopilot.mode, autopilot.shown)
        autopilot.presence.heartbeat(at.mono)
        autopilot.armed, autopilot.mode, autopilot.state = bool(beat.base_mode & ARMED), beat.custom_mode, beat.state
        autopilot.shown = PresenceState.ALIVE
        if before != (autopilot.armed, autopilot.mode, autopilot.shown):
            yield GcsEvent(at, "autopilot", {"system": beat.system, **snapshot.autopilot_fields(autopilot, at.mono)})

    # ------------------------------------------------------------ text

    def _said(self, said: StatusText, link: str, at: Stamp) -> Iterator[GcsEvent]:
        line, agent = statustext_parser.parse(said.text), self.fleet.agents.get((said.system, said.component))
        repeat = False
        if line is not None and (said.signed or not self._signed) and _is_from_phm(said, line, agent):
            agent = agent or self.fleet.agent(said.system, said.component, at.mono)
            if agent is not None:
                repeat = agent.repeats(line, said.text, at.mono)
                self._take(line, said, agent, at)
        else:
            line = None
        yield GcsEvent(at, "text", {**snapshot.text(said, line), "link": link, "repeat": repeat})

    def _take(self, line: ParsedLine, said: StatusText, agent: Agent, at: Stamp) -> None:
        if line.kind is LineKind.SWARM:
            swarm = self.fleet.swarm
            swarm.line, swarm.line_by, swarm.line_at = said.text, said.system, at
            unwell = statustext_parser.unhealthy_agents(line)
            for other in self.fleet.agents.values():
                if unwell is not None and other.system not in unwell:
                    other.no_ground = None  # a relay is reported once, and its end is not
        elif line.kind is LineKind.RELAY and line.agent != said.system:
            about = self.fleet.agent(line.agent, PHM_COMPONENT, at.mono)
            if about is not None:
                about.last_text, about.no_ground = ReceivedText(said.text, said.severity, at, via=said.system), True
        else:
            agent.last_text = ReceivedText(said.text, said.severity, at)
            agent.line(line, at)

    def _ack(self, ack: CommandAck, at: Stamp) -> Iterator[GcsEvent]:
        """Take over an agent's answer to a command of this ground station."""
        agent = self.fleet.agents.get((ack.system, ack.component))
        if agent is None or ack.to != self._own or (self._signed and not ack.signed):
            return
        body = {**snapshot.who(agent), "command": ack.command, "result": frames.result_name(ack.result)}
        yield GcsEvent(at, "ack", body)

    # ------------------------------------------------------------ tunnels

    def _payload(self, payload: TunnelPayload, at: Stamp) -> Iterator[GcsEvent]:
        """Only of agents whose heartbeat was received: other programs may use the payload type."""
        agent = self.fleet.agents.get((payload.system, payload.component))
        if payload.kind != PAYLOAD_TYPE or agent is None or agent.first is None:
            return
        try:
            message = tunnel.decode(payload.data)
        except TunnelError:
            return
        who = snapshot.who(agent)
        if isinstance(message, PeerView):
            old, agent.view, agent.view_at = agent.view, message, at
            agent.no_ground = not message.gcs
            if old is None or snapshot.view(old) != snapshot.view(message):
                yield GcsEvent(at, "view", {**who, **snapshot.view(message)})
        elif isinstance(message, SwarmDigest):
            yield self._digest(agent, message, at)
        elif isinstance(message, StatusWords):
            yield GcsEvent(
                at, "words", {**who, "words": {str(one): word for one, word in sorted(message.words.items())}}
            )
        elif isinstance(message, FaultDetail):
            if message.fault == REPLY_TEXT and payload.to[0] != 0 and payload.to != self._own:
                return  # it answers a command of another ground station
            text = agent.part(message)
            if text is not None:
                agent.take_text(message.fault, one_line(text))
                yield GcsEvent(at, "detail", {**who, "fault": message.fault, "text": one_line(text)})

    def _digest(self, agent: Agent, digest: SwarmDigest, at: Stamp) -> GcsEvent:
        swarm = self.fleet.swarm
        changed = swarm.digest != digest
        swarm.digest, swarm.digest_by, swarm.digest_at = digest, agent.system, at
        for number in digest.levels:
            self.fleet.agent(number, PHM_COMPONENT, at.mono)  # known, though perhaps never received
        return GcsEvent(at, "digest", {**snapshot.who(agent), **snapshot.digest(digest), "changed": changed})


def _is_phm(beat: Heartbeat) -> bool:
    """By the version in the status word: other programs on board set the field to zero or a small number."""
    if beat.kind != ONBOARD_CONTROLLER or beat.system not in AGENTS:
        return False
    version = beat.custom_mode >> 30
    return version == 1 or (version > 1 and beat.component == PHM_COMPONENT)


def _is_from_phm(said: StatusText, line: ParsedLine, agent: Agent | None) -> bool:
    """Whether a PHM sent it: an agent with PHM's heartbeat, or PHM's usual component before its first heartbeat. An agent reports
    about itself, and about others only in a line that is made for that.
    """
    if agent is not None and agent.first is not None:
        return line.kind in (LineKind.SWARM, LineKind.RELAY) or line.agent == said.system
    return said.component == PHM_COMPONENT and line.agent == said.system
