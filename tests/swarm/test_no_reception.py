"""The receiver of one agent fails: it still sends to all, and the ground still receives it and reaches it."""

from __future__ import annotations

from phm.core.model import Level
from sitl.simulation.fleet import Fleet
from tests.swarm.test_lost_leader import Watched


def stop_receiving(fleet: Fleet, agent: int) -> None:
    fleet.cut = {(other, agent) for other in fleet.agents if other != agent}


def test_leader_that_receives_no_agent_is_replaced() -> None:
    """It would not know that another agent is lost; and it does not contradict the next leader."""
    watched = Watched(8)
    fleet = watched.fleet
    watched.run(60)
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
    watched = Watched(8)
    fleet = watched.fleet
    watched.run(60)
    stop_receiving(fleet, 1)
    watched.run(200)
    fleet.cut = set()
    watched.run(30)
    assert {agent.probe.snapshot().leader for agent in fleet.agents.values()} == {1}


def test_the_loss_of_all_others_is_reported_by_the_last_one() -> None:
    watched = Watched(3)
    fleet = watched.fleet
    watched.run(60)
    fleet.lines()
    fleet.down.add(1)
    watched.run(30)
    fleet.down.add(3)
    watched.run(30)
    assert fleet.lines(3)[:2] == ["A02 FAIL 12 A01 lost", "A02 FAIL 12 all peers lost"]


def test_an_agent_that_receives_none_is_one_report() -> None:
    """Not one about each agent that it does not receive; and it lasts for as long as the fault does."""
    watched = Watched(8)
    fleet = watched.fleet
    watched.run(60)
    fleet.lines()
    stop_receiving(fleet, 5)
    fleet.no_gcs = {5}
    watched.run(200)
    assert [line for line in fleet.lines(4) if " 12 " in line] == ["A01 WARN 12 A05 receives no other agent"]
    assert fleet.agents[1].units["peers/A05"].level is Level.WARN
