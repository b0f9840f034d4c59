"""The receiver of one agent fails: it still sends to all, and the ground still receives it and reaches it."""

from __future__ import annotations

from phm.core.model import Level
from phm.swarm.consensus import compute_consensus
from phm.swarm.leader_election import LeaderElection
from phm.swarm.peers import Peers
from sitl.simulation.fleet import Fleet
from tests.swarm.test_lost_leader import Watched


def flying(agents: int) -> Watched:
    """A swarm in which all receive each other, for a minute."""
    watched = Watched(agents)
    watched.run(60)
    return watched


def stop_receiving(fleet: Fleet, agent: int) -> None:
    fleet.cut = {(other, agent) for other in fleet.agents if other != agent}


def test_leader_that_receives_no_agent_is_replaced() -> None:
    """It would not know that another agent is lost; and it does not contradict the next leader."""
    watched = flying(8)
    fleet = watched.fleet
    stop_receiving(fleet, 1)
    watched.run(20)
    assert {agent.probe.snapshot().leader for number, agent in fleet.agents.items() if number != 1} == {2}
    assert "A01 FAIL 12 all peers lost" in fleet.lines(3)
    fleet.down.add(5)
    watched.run(60)
    sent = [(agent, text) for agent, severity, text in fleet.ground if severity <= 3 or text.startswith("SWARM")]
    assert (2, "A02 FAIL 12 A05 lost") in sent
    assert {agent for agent, _ in sent} == {2}


def test_a_leader_that_receives_agents_again_leads_again() -> None:
    watched = flying(8)
    fleet = watched.fleet
    stop_receiving(fleet, 1)
    watched.run(200)
    fleet.cut = set()
    watched.run(30)
    assert {agent.probe.snapshot().leader for agent in fleet.agents.values()} == {1}


def test_the_loss_of_all_others_is_reported_by_the_last_one() -> None:
    watched = flying(3)
    fleet = watched.fleet
    fleet.lines()
    fleet.down.add(1)
    watched.run(30)
    fleet.down.add(3)
    watched.run(30)
    assert fleet.lines(3)[:2] == ["A02 FAIL 12 A01 lost", "A02 FAIL 12 all peers lost"]


def test_an_agent_that_receives_none_is_one_report() -> None:
    """Not one about each agent that it does not receive; and it lasts for as long as the fault does."""
    watched = flying(8)
    fleet = watched.fleet
    fleet.lines()
    stop_receiving(fleet, 5)
    fleet.no_gcs = {5}
    watched.run(200)
    assert [line for line in fleet.lines(4) if " 12 " in line] == ["A01 WARN 12 A05 receives no other agent"]
    assert fleet.agents[1].units["peers/A05"].level is Level.WARN


def test_an_agent_that_receives_one_that_this_agent_does_not_is_not_blamed() -> None:
    """A01's transmitter fails, and A03 is out of its range: A02 receives A03, so its receiver works."""
    watched = flying(3)
    fleet = watched.fleet
    fleet.cut = {(1, 2), (1, 3), (3, 1)}
    watched.run(60)
    assert 2 not in fleet.agents[1].probe.snapshot().receive_none


def test_an_agent_that_only_one_receives_does_not_lead() -> None:
    """A08 is at the edge of the range and receives A01 alone: A01's receiver works, and nothing is split."""
    watched = flying(8)
    fleet = watched.fleet
    fleet.ground.clear()
    fleet.cut = {(8, other) for other in range(1, 8)} | {(other, 8) for other in range(2, 8)}
    watched.run(60)
    assert fleet.agents[8].probe.snapshot().leader == 1
    assert not [text for agent, severity, text in fleet.ground if agent == 8 and severity <= 3]


def test_what_it_reported_alone_it_also_ends() -> None:
    """The leader knows of no such failure."""
    watched = flying(8)
    fleet = watched.fleet
    stop_receiving(fleet, 5)
    watched.run(60)
    fleet.cut = set()
    watched.run(120)
    sent = [(agent, text) for agent, _, text in fleet.ground]
    assert (5, "A05 FAIL 12 all peers lost") in sent
    assert (5, "A05 OK 12 cleared: all peers lost") in sent


def test_the_last_agent_in_the_air_leads() -> None:
    """The others have landed and said so: that it receives none is not a failure."""
    peers, election = Peers(1, 2.0, [1, 2, 3]), LeaderElection()
    for now in range(2, 21, 2):
        for agent in (2, 3):
            peers.heartbeat(agent, 1, now)
        peers.watch(now, 2.0)
    for agent in (2, 3):
        peers.heartbeat(agent, 1, 21, leaving=True)
    for now in range(22, 60):
        peers.watch(now, 2.0)
        leader = election.leader(compute_consensus(peers, now), True, now)
    assert leader == 1
