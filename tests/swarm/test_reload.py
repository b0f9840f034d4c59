"""After a reload the agents that were received before are still known, and the time of listening goes on."""

from __future__ import annotations

import pytest

from phm.core.model import Level, Slot
from phm.core.settings import SwarmSettings
from phm.probes.swarm import SwarmMonitor
from phm.testing import FakeClock, settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm.wire import status_word
from tests.fakes.mavlink import Sender, heartbeat

LINK = {"url": "udpin:127.0.0.1:14550", "name": "radio"}
WORD = status_word.encode({Slot.CONTAINER: Level.OK})


class Ports:
    """Closed endpoints, which stay the same, with one monitor after the other."""

    def __init__(self) -> None:
        self.clock, self.chosen = FakeClock(), settings(agent={"id": 1}, mavlink={"endpoints": [LINK]})
        self.hub = MavlinkHub(self.chosen.mavlink, 1, self.clock)

    def monitor(self, *agents: int) -> SwarmMonitor:
        listed = SwarmSettings(agents=agents)
        return SwarmMonitor(self.hub, 1, self.chosen.mavlink, listed, self.clock, lambda: None, lambda: None)

    def receive(self, agent: int) -> None:
        message = heartbeat(WORD, kind=mavlink.MAV_TYPE_ONBOARD_CONTROLLER)
        self.hub._deliver(Sender(agent, self.chosen.mavlink.component_id).received(message), "radio")


@pytest.mark.parametrize(("listed", "expected"), [((), {2: "lost"}), ((1, 2), {2: "lost"})])
def test_an_agent_that_is_lost_does_not_become_one_that_was_never_there(
    listed: tuple[int, ...], expected: dict[int, str]
) -> None:
    ports = Ports()
    before = ports.monitor(*listed)
    ports.receive(2)
    ports.clock.advance(600.0)
    after = ports.monitor(*listed)
    after.resume(before)
    assert {agent: peer.state for agent, peer in after.snapshot().peers.items()} == expected


def test_an_agent_in_both_lists_is_kept() -> None:
    """It stays lost though the list has another agent now; and an agent that is no longer listed is forgotten."""
    ports = Ports()
    before = ports.monitor(1, 2, 4)
    ports.receive(2)
    ports.receive(4)
    ports.clock.advance(600.0)
    assert before.snapshot().peers[2].state == "lost"
    after = ports.monitor(1, 2, 3)
    after.resume(before)
    peers = after.snapshot().peers
    assert {agent: peer.state for agent, peer in peers.items()} == {2: "lost", 3: "never seen"}
    ports.clock.advance(10.0)
    assert after.snapshot().peers[2].since_s >= 10.0


def test_agents_of_another_list_are_not_taken_over() -> None:
    ports = Ports()
    before = ports.monitor(2)
    ports.receive(2)
    after = ports.monitor(3)
    after.resume(before)
    assert {agent: peer.state for agent, peer in after.snapshot().peers.items()} == {3: "never seen"}


@pytest.mark.parametrize(("last", "heartbeat_s"), [(8, 2.0), (50, 15.0), (220, 40.0)])
def test_the_fact_has_the_period_of_a_swarm_of_this_size(last: int, heartbeat_s: float) -> None:
    """How long an agent may be silent depends on it."""
    agents = (*range(1, min(last, 50) + 1), *range(101, last + 1))
    assert Ports().monitor(*agents).snapshot().heartbeat_s == heartbeat_s


@pytest.mark.parametrize(("then", "up_s"), [((1, 2), 600.0), ((1, 2, 3), 0.0)])
def test_listening_goes_on_for_the_same_agents(then: tuple[int, ...], up_s: float) -> None:
    """Else one that was never received would be unknown again for some minutes."""
    ports = Ports()
    before = ports.monitor(1, 2)
    ports.clock.advance(600.0)
    after = ports.monitor(*then)
    after.resume(before)
    assert after.snapshot().up_s == up_s
