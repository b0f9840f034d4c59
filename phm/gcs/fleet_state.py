"""Frames go in, news come out. Pure; the caller brings time.

Agents are found by what they send: none needs to be known before, and none of their clocks is asked. A line counts as PHM's
only when it comes from a PHM and says something about it (or about another agent, where that is what it is for).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from phm.core.model import Stamp
from phm.gcs import snapshot, statustext_parser
from phm.gcs.agent import PHM_COMPONENT, Agent, Told
from phm.gcs.events import News
from phm.gcs.fleet import Fleet
from phm.gcs.frames import ARMED, GCS, NO_AUTOPILOT, ONBOARD_CONTROLLER, POWEROFF, Beat, Frame, Payload, Radio, Said
from phm.gcs.presence import State
from phm.gcs.statustext_parser import Kind, Line
from phm.wire import tunnel
from phm.wire.text import one_line
from phm.wire.tunnel import AGENTS, PAYLOAD_TYPE, Detail, Digest, TunnelError, View, Words

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""


class Store:
    """Not thread-safe: the caller's lock."""

    def __init__(self, expected: Iterable[int] = (), own: tuple[int, int] = (0, 0), *, signed: bool = False) -> None:
        """expected: agents that are missed before they were ever heard. own: our own MAVLink ids, not judged here. signed: what is
        not signed is not PHM's."""
        self.fleet, self._own, self._signed = Fleet(expected), own, signed

    def hear(self, frame: Frame, link: str, at: Stamp) -> list[News]:
        """One frame that came by a link; what is new by it."""
        if (frame.system, frame.component) == self._own:
            return []
        if isinstance(frame, Beat):
            return list(self._beat(frame, link, at))
        if isinstance(frame, Said):
            return list(self._said(frame, link, at))
        if isinstance(frame, Radio):
            self.fleet.radio(link, frame, at.mono)
            return []
        return list(self._payload(frame, at))

    def links(self, found: Mapping[str, tuple[bool, str]], at: Stamp) -> list[News]:
        """How the ground's own links are: by name, whether open, and if not why."""
        known = self.fleet.links
        changed = {name: how for name, how in found.items() if name not in known or known[name][0] is not how[0]}
        self.fleet.links = dict(found)
        return [News(at, "link", {"link": name, "open": how[0], "error": how[1]}) for name, how in changed.items()]

    def tick(self, at: Stamp) -> list[News]:
        """What follows from time passing. Call a few times a second."""
        found: list[News] = []
        if self.fleet.began is None:
            self.fleet.began = at.mono
        for system, pilot in self.fleet.pilots.items():
            lost = pilot.seen(at.mono) is State.LOST
            if lost and pilot.shown is not State.LOST:
                pilot.shown = State.LOST
                found.append(News(at, "pilot", {"system": system, **snapshot.pilot(pilot, at.mono)}))
        for agent in self.fleet.agents.values():
            found += self._presence(agent, at)
        look = self.fleet.look(at.mono)
        for agent in self.fleet.agents.values():
            hop = look.hop(agent)
            # Seconds of silence in the evidence go on; that is no news.
            key = None if hop is None else (hop.name, hop.certain)
            if key != agent.hop:
                agent.hop = key
                found.append(News(at, "hop", {**snapshot.who(agent), "hop": snapshot.hop(hop)}))
        return found

    def snapshot(self, at: Stamp) -> dict[str, Any]:
        """How everybody is, JSON-able."""
        return snapshot.whole(self.fleet, at)

    # ------------------------------------------------------------ heartbeats

    def _beat(self, beat: Beat, link: str, at: Stamp) -> Iterator[News]:
        if beat.kind == GCS:
            self.fleet.station(beat.system, beat.component, at.mono)
        elif beat.autopilot != NO_AUTOPILOT:
            if beat.component == AUTOPILOT:
                yield from self._pilot(beat, at)
        elif _is_phm(beat) and (beat.signed or not self._signed):
            agent = self.fleet.agent(beat.system, beat.component, at.mono)
            if agent is not None:
                yield from self._agent(agent, beat, link, at)

    def _agent(self, agent: Agent, beat: Beat, link: str, at: Stamp) -> Iterator[News]:
        agent.presence.beat(at.mono, leaving=beat.state == POWEROFF)
        agent.link, agent.last = link, at
        if agent.first is None:
            agent.first, agent.shown = at, State.ALIVE
            ids = {"system": agent.system, "component": agent.component, "link": link}
            yield News(at, "agent", {**snapshot.who(agent), **ids})
        state, restarts, problem = agent.state, agent.restarts, agent.problem
        changed = agent.beat(beat)
        yield from self._presence(agent, at)
        if agent.restarts != restarts:
            yield News(at, "restart", {**snapshot.who(agent), "restarts": agent.restarts})
        if agent.problem and agent.problem != problem:
            yield News(at, "problem", {"text": f"{agent.name}: {agent.problem}"})
        if changed or agent.state != state:
            names = {str(int(slot)): [old.name, new.name] for slot, (old, new) in changed.items()}
            yield News(at, "slots", {**snapshot.who(agent), **snapshot.word(agent), "changed": names})

    def _presence(self, agent: Agent, at: Stamp) -> Iterator[News]:
        """Lost, left and back are news; one that is late may have lost a frame."""
        state = self.fleet.state(agent, at.mono)
        shown = State.ALIVE if state is State.LATE else state
        if shown is agent.shown:
            return
        was, agent.shown = agent.shown, shown
        silent_s = snapshot.seconds(agent.presence.silent_s(at.mono))
        yield News(
            at, "presence", {**snapshot.who(agent), "presence": shown.value, "was": was.value, "silent_s": silent_s}
        )

    def _pilot(self, beat: Beat, at: Stamp) -> Iterator[News]:
        pilot = self.fleet.pilot(beat.system, at.mono)
        if pilot is None:
            return
        before = (pilot.armed, pilot.mode, pilot.shown)
        pilot.presence.beat(at.mono)
        pilot.armed, pilot.mode, pilot.state = bool(beat.base_mode & ARMED), beat.custom_mode, beat.state
        pilot.shown = State.ALIVE
        if before != (pilot.armed, pilot.mode, pilot.shown):
            yield News(at, "pilot", {"system": beat.system, **snapshot.pilot(pilot, at.mono)})

    # ------------------------------------------------------------ text

    def _said(self, said: Said, link: str, at: Stamp) -> Iterator[News]:
        line, agent = statustext_parser.read(said.text), self.fleet.agents.get((said.system, said.component))
        repeat = False
        if line is not None and (said.signed or not self._signed) and _believed(said, line, agent):
            agent = agent or self.fleet.agent(said.system, said.component, at.mono)
            if agent is not None:
                repeat = agent.repeats(line, said.text, at.mono)
                self._take(line, said, agent, at)
        else:
            line = None
        yield News(at, "text", {**snapshot.text(said, line), "link": link, "repeat": repeat})

    def _take(self, line: Line, said: Said, agent: Agent, at: Stamp) -> None:
        if line.kind is Kind.SWARM:
            swarm = self.fleet.swarm
            swarm.line, swarm.line_by, swarm.line_at = said.text, said.system, at
            unwell = statustext_parser.named(line)
            for other in self.fleet.agents.values():
                if unwell is not None and other.system not in unwell:
                    other.deaf = None  # a relay is said once, and its end by nobody
        elif line.kind is Kind.RELAY and line.agent != said.system:
            about = self.fleet.agent(line.agent, PHM_COMPONENT, at.mono)
            if about is not None:
                about.told, about.deaf = Told(said.text, said.severity, at, via=said.system), True
        else:
            agent.told = Told(said.text, said.severity, at)
            agent.line(line, at)

    # ------------------------------------------------------------ tunnels

    def _payload(self, payload: Payload, at: Stamp) -> Iterator[News]:
        """Only of agents whose heartbeat was heard: anybody may use the number of the payload."""
        agent = self.fleet.agents.get((payload.system, payload.component))
        if payload.kind != PAYLOAD_TYPE or agent is None or agent.first is None:
            return
        try:
            message = tunnel.decode(payload.data)
        except TunnelError:
            return
        who = snapshot.who(agent)
        if isinstance(message, View):
            old, agent.view, agent.view_at = agent.view, message, at
            agent.deaf = not message.gcs
            if old is None or snapshot.view(old) != snapshot.view(message):
                yield News(at, "view", {**who, **snapshot.view(message)})
        elif isinstance(message, Digest):
            yield self._digest(agent, message, at)
        elif isinstance(message, Words):
            yield News(at, "words", {**who, "words": {str(one): word for one, word in sorted(message.words.items())}})
        elif isinstance(message, Detail):
            text = agent.part(message)
            if text is not None:
                yield News(at, "detail", {**who, "fault": message.fault, "text": one_line(text)})

    def _digest(self, agent: Agent, digest: Digest, at: Stamp) -> News:
        swarm = self.fleet.swarm
        changed = swarm.digest != digest
        swarm.digest, swarm.digest_by, swarm.digest_at = digest, agent.system, at
        for number in digest.levels:
            self.fleet.agent(number, PHM_COMPONENT, at.mono)  # known of, though perhaps never heard
        return News(at, "digest", {**snapshot.who(agent), **snapshot.digest(digest), "changed": changed})


def _is_phm(beat: Beat) -> bool:
    """By the version in the word: other programs aboard leave the field zero, or hold a small number there."""
    if beat.kind != ONBOARD_CONTROLLER or beat.system not in AGENTS:
        return False
    version = beat.custom_mode >> 30
    return version == 1 or (version > 1 and beat.component == PHM_COMPONENT)


def _believed(said: Said, line: Line, agent: Agent | None) -> bool:
    """Whether it is PHM's: from one whose heartbeat is PHM's, or from the usual component of one not heard beating yet. An agent
    speaks of itself; of others only where the line is made for that.
    """
    if agent is not None and agent.first is not None:
        return line.kind in (Kind.SWARM, Kind.RELAY) or line.agent == said.system
    return said.component == PHM_COMPONENT and line.agent == said.system
