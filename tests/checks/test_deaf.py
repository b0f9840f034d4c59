"""Slot 4: discovery passes and no data does, told once at the network and not as nodes that hang."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm_checks.network import Network

NET = "swarm_net"
NODES = ("/a/one", "/a/two")
ROWS = tuple(api.ProcessFact(10 + k, 1, "S", 1.0, f"node --name {name[3:]}") for k, name in enumerate(NODES))


class Aboard:
    """A container with two nodes whose beacons are heard; the check has met this life of the container."""

    def __init__(self) -> None:
        self.clock = testing.FakeClock()
        fact = testing.container("ros_app", networks=(api.Attachment(NET, "id-1", "172.20.0.3"),))
        self.docker = testing.FakeDocker(fact, networks={NET: "id-1"})
        self.docker.lists["ros_app"] = ROWS
        self.ros = testing.FakeRos(up_s=60.0)
        self.heard(0.1, 0.2)
        made = testing.settings(
            containers=[{"name": "ros_app", "networks": [NET]}], ros={"nodes": [{"name": name} for name in NODES]}
        )
        (self.check,) = Network.build(made)
        assert self.look().level is api.Level.OK

    def heard(self, *ages_s: float) -> None:
        beacons = {name: api.BeaconFact(age_s, 0.2) for name, age_s in zip(NODES, ages_s, strict=False)}
        self.ros.change(nodes=dict.fromkeys(NODES, 1), beacons=beacons)

    def look(self) -> api.Result:
        result = self.check.run(testing.world(docker=self.docker, ros=self.ros, clock=self.clock))
        assert isinstance(result, api.Result)
        return result

    def later(self, seconds: float, *ages_s: float) -> api.Result:
        self.clock.advance(seconds)
        self.heard(*ages_s)
        return self.look()


@pytest.fixture
def aboard() -> Aboard:
    return Aboard()


def test_nodes_that_fall_silent_at_once_are_a_blocked_transport(aboard: Aboard) -> None:
    """Listed, running, and not heard: one fault, which no ladder restarts anything for."""
    result = aboard.later(10.0, 4.0, 4.4)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "transport_blocked", "ros_app")
    assert result.brief == "ros_app transport blocked"
    assert "2 nodes" in result.summary


def test_a_life_in_which_data_came_before_is_told_from_one_in_which_none_did(aboard: Aboard) -> None:
    """A restart may help the first, and not the second; the words say so."""
    result = aboard.later(10.0, 4.0, 4.4)
    assert result.values["never_well"] is False
    assert "Data came before" in result.summary


def test_after_a_restart_it_is_well_when_something_is_heard(aboard: Aboard) -> None:
    """Connected is not healed: what was blocked may be blocked again, which nobody knows before a node speaks."""
    aboard.later(10.0, 4.0, 4.4)
    aboard.docker.change("ros_app", started_at="later")
    assert aboard.later(1.0, 5.0, 5.4).level is api.Level.STALE
    assert aboard.later(2.0, 7.0, 7.4).level is api.Level.STALE
    assert aboard.later(2.0, 0.2).level is api.Level.OK
    assert aboard.later(5.0, 5.0).level is api.Level.OK, "one node that falls silent is its own fault"


def test_after_a_restart_nobody_waits_for_ever(aboard: Aboard) -> None:
    """Nodes that never come are told as such."""
    aboard.later(10.0, 4.0, 4.4)
    aboard.docker.change("ros_app", started_at="later")
    aboard.ros.change(nodes={}, beacons={})
    assert aboard.look().level is api.Level.STALE
    aboard.clock.advance(17.0)
    assert aboard.look().level is api.Level.OK


@pytest.mark.parametrize("ages_s", [(0.1, 5.0), (2.0, 2.1), (4.0, 8.0), (5.0,)])
def test_one_silent_node_is_its_own_fault(aboard: Aboard, ages_s: tuple[float, ...]) -> None:
    """Somebody is heard, the silence is short, they fell silent one after the other, or there is one witness alone."""
    assert aboard.later(10.0, *ages_s).level is api.Level.OK


@pytest.mark.parametrize("rows", [ROWS[:1], (ROWS[0], replace(ROWS[1], state="T"))])
def test_processes_that_ended_or_stopped_explain_the_silence(aboard: Aboard, rows: tuple[Any, ...]) -> None:
    """Then it is not the way to them."""
    aboard.docker.lists["ros_app"] = rows
    assert aboard.later(10.0, 4.0, 4.0).level is api.Level.OK


def test_a_container_that_was_started_again_has_other_processes(aboard: Aboard) -> None:
    """Names of the old ones stay listed until their lease ends; nothing was heard in this life yet."""
    aboard.clock.advance(10.0)
    aboard.docker.change("ros_app", started_at="later")
    aboard.heard(4.0, 4.0)
    assert aboard.look().level is api.Level.OK


def test_publishers_without_names_are_a_blocked_transport_from_the_start(aboard: Aboard) -> None:
    """A PHM that was started behind the firewall never hears a name."""
    made = testing.settings(
        containers=[{"name": "ros_app", "networks": [NET]}],
        ros={
            "nodes": [{"name": name} for name in NODES],
            "topics": [{"name": f"{name}_out", "rate": 1, "publishers": [name]} for name in NODES],
        },
    )
    (aboard.check,) = Network.build(made)
    topics = {f"{name}_out": api.TopicFact(publishers=(api.EndpointFact("", "std_msgs/msg/String"),)) for name in NODES}
    aboard.ros.change(nodes={}, beacons={}, topics=topics)
    assert aboard.look().level is api.Level.OK
    aboard.clock.advance(20.0)
    result = aboard.look()
    assert (result.condition, result.values["never_well"]) == ("transport_blocked", True)
    assert "nothing was ever heard" in result.summary


def test_without_a_picture_nothing_is_said(aboard: Aboard) -> None:
    """Cannot tell: a ROS child that is being replaced, an engine that lists no processes."""
    aboard.ros.fail()
    assert aboard.later(10.0, 4.0, 4.0).level is api.Level.OK
    aboard.ros.work()
    aboard.docker.lists.clear()
    assert aboard.later(1.0, 5.0, 5.0).level is api.Level.OK
