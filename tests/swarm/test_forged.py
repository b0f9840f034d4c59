"""Invented agents on a real socket, with pymavlink's own frames: their effect on a swarm with listed agents, and on one
with signing.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.model import Level, Slot
from phm.core.settings import MavlinkSettings
from phm.probes.swarm import SwarmMonitor
from phm.testing import FakeClock, settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm.transport.mavlink_signing import EPOCH_S, TICKS
from phm.transport.priority import SIZES, default_periods
from phm.wire import status_word, tunnel
from phm.wire.tunnel import PeerState, PeerView
from tests.fakes.mavlink import Sender, free_port, heartbeat
from tests.fakes.until import until

KEY = bytes(range(1, 33))
HEALTHY = status_word.encode(dict.fromkeys(list(Slot)[:8], Level.OK))
FAREWELL = mavlink.MAVLink_heartbeat_message(18, 8, 0, HEALTHY, mavlink.MAV_STATE_POWEROFF, 3)
OURS = (1, 2, 3)
Start = Callable[..., "Agent"]


class Agent:
    """Agent 1 of a swarm of three on a loopback socket, and its senders."""

    def __init__(self, agents: list[int], key: Path | None) -> None:
        self.port, self.clock = free_port(socket.SOCK_DGRAM), SystemClock()
        chosen = settings(
            agent={"id": 1},
            swarm={"agents": agents},
            mavlink={
                "endpoints": [{"url": f"udpin:127.0.0.1:{self.port}", "budget": 0}],
                "signing": {"key": str(key) if key else None},
            },
        )
        assert isinstance(chosen.mavlink, MavlinkSettings)
        self.hub = MavlinkHub(chosen.mavlink, 1, self.clock)
        self.swarm = SwarmMonitor(
            self.hub, chosen.agent.id, chosen.mavlink, chosen.swarm, self.clock, lambda: None, lambda: None
        )
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sent = 0
        self._senders: dict[tuple[int, bool], Any] = {}
        self.hub.start()
        until(self.hub.links, "the port opening")

    def send(self, agent: int, *messages: Any, signed: bool = False) -> None:
        sender = self._senders.setdefault((agent, signed), mavlink.MAVLink(None, srcSystem=agent, srcComponent=193))
        if signed:
            sender.signing.secret_key, sender.signing.sign_outgoing = KEY, True
            now = round((self.clock.utc() - EPOCH_S) * TICKS)
            sender.signing.timestamp = max(sender.signing.timestamp + 1, now)
        for message in messages:
            self._out.sendto(message.pack(sender), ("127.0.0.1", self.port))
            sender.seq = (sender.seq + 1) % 256
            self._sent += 1
            if self._sent % 50 == 0:
                self.read()  # more would not fit into the socket's buffer

    def read(self) -> None:
        """Wait until all sent frames have been read."""
        (counters,) = self.hub.counters().values()
        until(lambda: counters.received >= self._sent, f"{self._sent} frames")

    def close(self) -> None:
        self.hub.close()
        self._out.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start agents, and close them at the end."""
    made: list[Agent] = []

    def begin(agents: list[int], *, signs: bool = False) -> Agent:
        key = tmp_path / "key"
        key.write_bytes(KEY)
        key.chmod(0o600)
        made.append(Agent(agents, key if signs else None))
        return made[-1]

    yield begin
    for one in made:
        one.close()


def view(gcs: bool, peers: dict[int, PeerState]) -> Any:
    payload = tunnel.encode(PeerView(1, gcs, True, True, peers))
    return mavlink.MAVLink_tunnel_message(0, 0, tunnel.PAYLOAD_TYPE, len(payload), list(payload.ljust(128, b"\0")))


def states(agent: Agent) -> dict[int, str]:
    return {number: peer.state for number, peer in agent.swarm.snapshot().peers.items()}


LOST = view(True, {2: PeerState.LOST, 3: PeerState.LOST})


def test_invented_agents_have_no_effect_where_the_agents_are_listed(start: Start) -> None:
    """Neither on the heartbeat's period and the budget, nor as votes, nor as leader; they are named."""
    agent = start([*OURS])
    for _turn in range(3):
        for forged in range(4, 251):
            agent.send(forged, heartbeat(HEALTHY), LOST)
        for ours in (2, 3):
            agent.send(ours, heartbeat(HEALTHY), view(False, {1: PeerState.ALIVE, 5 - ours: PeerState.ALIVE}))
        agent.read()
    agent.swarm.wake_if_changed()

    def refresh() -> None:
        """On a busy machine the last heartbeats may be old."""
        for ours in (2, 3):
            agent.send(ours, heartbeat(HEALTHY))
        agent.read()

    until(lambda: states(agent) == {2: "alive", 3: "alive"}, "our agents", lambda: states(agent), step=refresh)
    fact = agent.swarm.snapshot()
    assert agent.hub.agents == 3
    assert default_periods(agent.hub.agents) == SIZES[0][1:]
    assert (fact.members, fact.leader, len(fact.unlisted)) == (3, None, 247)


def test_invented_agents_do_not_slow_heartbeats_immediately(start: Start) -> None:
    """Where no agents are listed, a flood of them does not hide a loss by a sudden change of the period."""
    agent = start([])
    for _turn in range(4):
        for forged in range(2, 251):
            agent.send(forged, heartbeat(HEALTHY))
        agent.read()
        agent.swarm.wake_if_changed()
    assert agent.hub.agents < 30
    assert default_periods(agent.hub.agents)[0] <= SIZES[1][1]


@pytest.mark.parametrize("system", [0, 251, 255])
def test_a_system_that_cannot_be_an_agent_is_ignored(start: Start, system: int) -> None:
    """Agents are 1 to 250: a view with another id could not be encoded, so this agent would send none any more."""
    agent = start([])
    for _turn in range(3):
        agent.send(system, heartbeat(HEALTHY), LOST)
        agent.send(2, heartbeat(HEALTHY))
    agent.read()
    until(lambda: 2 in states(agent), "agent 2")
    assert system not in states(agent)
    assert {*agent.swarm.snapshot().peers} <= {*tunnel.AGENTS}


def test_with_signing_an_unsigned_frame_is_ignored(start: Start) -> None:
    """A forged shutdown of a live agent, and heartbeats of agents that do not exist, change nothing."""
    agent = start([*OURS], signs=True)
    for _turn in range(3):
        agent.send(2, heartbeat(HEALTHY), signed=True)
    agent.send(2, FAREWELL)
    agent.send(3, heartbeat(HEALTHY))
    agent.read()

    def refresh() -> None:
        """On a busy machine the last heartbeat may be old."""
        agent.send(2, heartbeat(HEALTHY), signed=True)
        agent.read()

    until(lambda: states(agent) == {2: "alive", 3: "never seen"}, "agent 2 alone", lambda: states(agent), step=refresh)
    assert agent.swarm._peers.peer(2).leaving is False  # type: ignore[union-attr]
    agent.send(2, FAREWELL, signed=True)
    until(lambda: agent.swarm._peers.peer(2).leaving, "the announced shutdown")  # type: ignore[union-attr]


@pytest.mark.parametrize(("signs", "state"), [(False, "left"), (True, "lost")])
def test_only_signing_prevents_a_forged_shutdown_of_a_lost_agent(tmp_path: Path, signs: bool, state: str) -> None:
    """A list of agents does not, and PHM must take it: after a radio outage an agent's own shutdown may be the first frame."""
    key = tmp_path / "key"
    key.write_bytes(KEY)
    key.chmod(0o600)
    signing = {"key": str(key) if signs else None}
    chosen = settings(
        agent={"id": 1},
        swarm={"agents": [1, 3]},
        mavlink={"endpoints": [{"url": "udpin:127.0.0.1:14550", "name": "radio"}], "signing": signing},
    )
    clock = FakeClock()
    hub = MavlinkHub(chosen.mavlink, 1, clock)  # not started: frames are delivered by hand
    swarm = SwarmMonitor(hub, 1, chosen.mavlink, chosen.swarm, clock, lambda: None, lambda: None)
    agent, forger = Sender(3, 193), Sender(3, 193)
    real = agent.received(heartbeat(HEALTHY))
    real._signed = signs
    hub._deliver(real, "radio")
    clock.advance(600.0)
    assert swarm.snapshot().peers[3].state == "lost"
    hub._deliver(forger.received(FAREWELL), "radio")
    clock.advance(600.0)
    assert swarm.snapshot().peers[3].state == state
