"""The agents that the ground knows, and the state of all at one moment. Pure; the caller brings time.

Everything is capped: a sender can invent any number of agents. A lost agent makes room for a new one, unless it is expected; of
several, the one that was received for the shortest time.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from phm.core.model import Stamp
from phm.gcs.agent import PHM_COMPONENT, Agent
from phm.gcs.frames import RadioStatus
from phm.gcs.hops import BrokenHop, HopEvidence, first_broken
from phm.gcs.presence import Presence, PresenceState
from phm.swarm.peers import LOST_PERIODS, VIEW_LATE_PERIODS
from phm.transport.priority import default_periods
from phm.wire.tunnel import PeerState, PeerView, SwarmDigest

MAX_AGENTS, MAX_AUTOPILOTS, MAX_STATIONS, MAX_RADIOS = 512, 256, 16, 16
AUTOPILOT_GUESS_S = 1.0
"""Autopilots and ground stations send a heartbeat a second."""
STATION_S = RADIO_S = 10.0
FULL_S = 1.0
"""When there is no room, the next search for room is this much later: a flood of invented agents must cost little."""
_THERE = (PeerState.ALIVE, PeerState.LATE)
K = TypeVar("K")
V = TypeVar("V")


@dataclass(slots=True)
class Autopilot:
    """The autopilot of a vehicle, by its HEARTBEAT."""

    presence: Presence = field(default_factory=Presence)
    armed: bool = False
    mode: int = 0
    """custom_mode, whose meaning is the autopilot's own."""
    state: int | None = None
    shown: PresenceState = PresenceState.NEVER

    def phase(self, now: float) -> PresenceState:
        return self.presence.state(now, AUTOPILOT_GUESS_S)

    def lost(self, now: float) -> bool:
        return self.phase(now) is PresenceState.LOST


@dataclass(slots=True)
class SwarmState:
    """The last report of the elected leader: its digest and its line of text."""

    digest: SwarmDigest | None = None
    digest_by: int = 0
    digest_at: Stamp | None = None
    line: str = ""
    line_by: int = 0
    line_at: Stamp | None = None


class Fleet:
    """Not thread-safe. expected: ids of agents that are shown and reported as missing even if never received."""

    def __init__(self, expected: Iterable[int] = ()) -> None:
        self.expected = frozenset(expected)
        self.agents: dict[tuple[int, int], Agent] = {}
        self.autopilots: dict[int, Autopilot] = {}
        self.stations: OrderedDict[tuple[int, int], float] = OrderedDict()
        self.swarm = SwarmState()
        self.links: Mapping[str, tuple[bool, str]] = {}
        """The ground's own, by name: whether open, and if not why."""
        self.radios: OrderedDict[str, tuple[float, RadioStatus]] = OrderedDict()
        """The last RADIO_STATUS on each of the ground's links, and when it was received."""
        self.began: float | None = None
        """The moment at which the ground began to listen."""
        self.refused = 0
        """Number of frames of agents for which there was no room."""
        self._full_until = float("-inf")
        for agent in sorted(self.expected):
            self.agents[agent, PHM_COMPONENT] = Agent(agent, PHM_COMPONENT)

    @property
    def guess_s(self) -> float:
        """Heartbeat period of an agent that was not received often enough: PHM's default for a swarm of this size."""
        return default_periods(len(self.agents))[0]

    def state(self, agent: Agent, now: float) -> PresenceState:
        return agent.presence.state(now, self.guess_s)

    def agent(self, system: int, component: int, now: float) -> Agent | None:
        """The known agent or a new one; None: there is no room."""
        key = (system, component)
        if key not in self.agents:
            if now < self._full_until or not _room(
                self.agents, MAX_AGENTS, lambda one: self._stays(one, now), _received_s
            ):
                self._full_until = self._full_until if now < self._full_until else now + FULL_S
                self.refused += 1
                return None
            self.agents[key] = Agent(system, component)
        return self.agents[key]

    def autopilot(self, system: int, now: float) -> Autopilot | None:
        if system not in self.autopilots:
            if not _room(self.autopilots, MAX_AUTOPILOTS, lambda one: one.phase(now).there):
                return None
            self.autopilots[system] = Autopilot()
        return self.autopilots[system]

    def station(self, system: int, component: int, now: float, *, leaving: bool = False) -> None:
        """A heartbeat of another ground station was received; `leaving`: its last one."""
        self.stations.pop((system, component), None)
        if leaving:
            return
        self.stations[system, component] = now
        while len(self.stations) > MAX_STATIONS:
            self.stations.popitem(last=False)

    def radio(self, link: str, said: RadioStatus, now: float) -> None:
        self.radios.pop(link, None)
        self.radios[link] = (now, said)
        while len(self.radios) > MAX_RADIOS:
            self.radios.popitem(last=False)

    def snapshot(self, now: float) -> FleetSnapshot:
        return FleetSnapshot(self, now)

    def _stays(self, agent: Agent, now: float) -> bool:
        return agent.system in self.expected or self.state(agent, now).there


class FleetSnapshot:
    """The state of all agents at `now` (monotonic seconds). Valid until the fleet changes."""

    def __init__(self, fleet: Fleet, now: float) -> None:
        self._fleet, self._now = fleet, now
        self._states = {key: fleet.state(agent, now) for key, agent in fleet.agents.items()}
        self._views = [(agent, view) for key, agent in fleet.agents.items() if (view := self._counts(key, agent))]
        shut = [f"{name}: {error}" for name, (is_open, error) in fleet.links.items() if not is_open]
        began = now if fleet.began is None else fleet.began
        self._early = now - began <= LOST_PERIODS * fleet.guess_s
        """An agent that was never received may not have sent a heartbeat yet."""
        self._closed = ", ".join(shut) if fleet.links and len(shut) == len(fleet.links) else ""
        # An agent that has left is silent on purpose: it says nothing about the ground's link.
        received = [state for state in self._states.values() if state not in (PresenceState.NEVER, PresenceState.LEFT)]
        self._all_silent = (
            len(received) > 1
            and all(state is PresenceState.LOST for state in received)
            and not any(autopilot.phase(now).there for autopilot in fleet.autopilots.values())
        )

    def state(self, agent: Agent) -> PresenceState:
        return self._states[agent.system, agent.component]

    def received_by(self, agent: Agent) -> tuple[list[int], list[int]]:
        """Which other agents receive it and which do not, by their newest views."""
        sides: tuple[set[int], set[int]] = (set(), set())
        for other, view in self._views:
            if other.system != agent.system:
                sides[view.peers.get(agent.system) not in _THERE].add(other.system)
        return sorted(sides[0]), sorted(sides[1])

    def hop(self, agent: Agent) -> BrokenHop | None:
        """The first broken hop on the path to its autopilot."""
        state = self.state(agent)
        autopilot = self._fleet.autopilots.get(agent.system)
        if state.there or state is PresenceState.LEFT:
            lost_s = (
                autopilot.presence.silent_s(self._now) if autopilot is not None and autopilot.lost(self._now) else None
            )
            return first_broken(agent, state, None, HopEvidence(autopilot_lost_s=lost_s))
        if state is PresenceState.NEVER and self._early:
            return None
        around = HopEvidence(
            self._closed,
            self._all_silent,
            autopilot is not None and autopilot.phase(self._now).there,
            self.received_by(agent)[0],
            any(self._now - received <= RADIO_S for received, _ in self._fleet.radios.values()),
        )
        return first_broken(agent, state, agent.presence.silent_s(self._now), around)

    def stations(self) -> list[tuple[int, int]]:
        """MAVLink ids of the other active ground stations."""
        return sorted(ids for ids, received in self._fleet.stations.items() if self._now - received <= STATION_S)

    def _counts(self, key: tuple[int, int], agent: Agent) -> PeerView | None:
        """Its view, if it is alive and the view is new enough."""
        if agent.view is None or agent.view_at is None or not self._states[key].there:
            return None
        longest_s = VIEW_LATE_PERIODS * agent.presence.period_s(self._fleet.guess_s)
        return agent.view if self._now - agent.view_at.mono <= longest_s else None


def _received_s(agent: Agent) -> float:
    """How long it was received. An agent of which only others report: 0."""
    return 0.0 if agent.first is None or agent.last is None else agent.last.mono - agent.first.mono


def _room(
    held: dict[K, V], most: int, stays: Callable[[V], bool], worth: Callable[[V], float] = lambda one: 0.0
) -> bool:
    """Whether there is room for one more, also by removing one that need not stay, the one with the least worth."""
    if len(held) < most:
        return True
    gone = min((key for key, one in held.items() if not stays(one)), key=lambda key: worth(held[key]), default=None)
    if gone is None:
        return False
    del held[gone]
    return True
