"""PHM of one agent is restarted on lossy links: it has not received each heartbeat yet, which is not a fault of others."""

from __future__ import annotations

import pytest

from phm.swarm.consensus import MemberState
from phm.swarm.peers import LOST_PERIODS, Peers
from phm.wire.tunnel import PeerState, PeerView
from sitl.simulation.fleet import Agent, Fleet
from tests.swarm.test_core import PERIOD_S, Swarm


def test_a_restarted_agent_causes_no_warning_about_others() -> None:
    """In its first five heartbeat periods it must not be counted among those that do not receive an agent."""
    fleet = Fleet(12, loss=0.3, step_s=0.5)
    for number, agent in fleet.agents.items():
        agent.reporters[0]._heartbeat_at += 5 * number / 12  # type: ignore[union-attr]
    fleet.run(60)
    fleet.agents[6] = Agent(6, fleet.clock, list(fleet.agents), 158.0)
    blamed = set()
    for _ in range(49):  # 24.5 s
        fleet.run(0.5)
        for agent in fleet.agents.values():
            peers = agent.probe.snapshot().peers.items()
            blamed |= {other for other, peer in peers if agent.number != 6 and peer.not_received_by == (6,)}
    assert blamed == set()


def test_a_restarted_agent_does_not_lead_beside_the_leader() -> None:
    """The others send it their views as soon as its heartbeat says BOOT."""
    fleet = Fleet(8)
    fleet.run(60)
    agent = fleet.agents[5] = Agent(5, fleet.clock, list(fleet.agents), 158.0)
    agent.reporters[0]._refresh_at = None  # type: ignore[union-attr]  # its first report is not complete
    leaders = []
    for _ in range(60):
        fleet.run(1)
        leaders.append(agent.probe.snapshot().leader)
    assert set(leaders) == {None, 1}
    assert leaders.index(1) < 10


def test_an_agent_leads_if_those_with_lower_ids_send_no_views() -> None:
    """It waits for them only after its start."""
    fleet = Fleet(3)
    fleet.agents[1].reporters = fleet.agents[1].reporters[:1]  # type: ignore[assignment]
    fleet.down = {2}
    fleet.run(60)
    assert fleet.agents[3].probe.snapshot().leader == 3


def test_an_agent_that_was_started_now_has_no_vote_on_those_it_has_not_received_yet() -> None:
    """It has lost none; nor does it hide that an agent is lost, or was never there."""
    swarm = Swarm(range(1, 6))
    swarm.down = {5}
    swarm.run(20)
    swarm.peers[4] = Peers(4, PERIOD_S, swarm.agents)
    for hearer in (1, 2, 3):
        view = PeerView(200, True, True, True, swarm.peers[4].states(swarm.now))
        swarm.peers[hearer].add_view(4, PeerView(200, True, True, True, {**view.peers, 1: PeerState.ALIVE}), swarm.now)
    for agent in (1, 2, 3):
        states = {other: status.state for other, status in swarm.agreed(agent).statuses.items()}
        assert states.pop(5) is MemberState.NEVER
        assert set(states.values()) == {MemberState.ALIVE}
    assert swarm.agreed(1).statuses[5].not_received_by == (1, 2, 3, 4)
    swarm.down = {3, 5}
    swarm.peers[4] = Peers(4, PERIOD_S, swarm.agents)
    swarm.run(LOST_PERIODS * PERIOD_S + 2 * PERIOD_S)
    assert {swarm.agreed(agent).statuses[3].state for agent in (1, 2, 4)} == {MemberState.LOST}


@pytest.mark.long
def test_a_restarted_agent_of_a_large_swarm_does_not_lead() -> None:
    """Heartbeats come every 15 s, so the leader may be unknown to it for as long."""
    fleet = Fleet(40, step_s=1.0)
    for number, one in fleet.agents.items():
        one.reporters[0]._heartbeat_at += 15 * ((number * 7) % 40) / 40  # type: ignore[union-attr]
    fleet.run(120)
    agent = fleet.agents[2] = Agent(2, fleet.clock, list(fleet.agents), 158.0)
    leaders = set()
    for _ in range(60):
        fleet.run(1)
        leaders.add(agent.probe.snapshot().leader)
    assert leaders <= {None, 1}
