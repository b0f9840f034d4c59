"""Slot 4: discovery passes and no data does, told once at the network and not as nodes that hang."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm_checks.network import Network

NET = "swarm_net"
NODES = ("/a/one", "/a/two")
ROWS = tuple(api.ProcessFact(10 + k, 1, "S", 1.0, f"node --name {name[3:]}") for k, name in enumerate(NODES))


class Passing(testing.FakeClock):
    """Whoever waits finds that time has passed, and what has happened meanwhile."""

    def __init__(self) -> None:
        super().__init__()
        self.meanwhile: Callable[[float], None] = lambda seconds: None
        self.waits = 0

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        self.waits += 1
        self.advance(timeout_s or 0.0)
        self.meanwhile(timeout_s or 0.0)
        return event.is_set()


class Aboard:
    """A container with two nodes whose beacons are heard; the check has met this life of the container."""

    def __init__(self) -> None:
        self.clock = Passing()
        fact = testing.container("ros_app", networks=(api.Attachment(NET, "id-1", "172.20.0.3"),))
        self.docker = testing.FakeDocker(fact, networks={NET: "id-1"})
        self.docker.lists["ros_app"] = ROWS
        self.ros = testing.FakeRos(up_s=60.0, age_s=0.0)
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
    assert result.evidence.never_ok is False
    assert "Data was received earlier" in result.summary


def test_without_a_test_of_the_address_nothing_is_restarted(aboard: Aboard) -> None:
    """What is broken may be PHM's own way to a container that is well."""
    made = testing.settings(
        containers=[{"name": "ros_app", "networks": [NET], "address": False}],
        ros={"nodes": [{"name": name} for name in NODES]},
    )
    (aboard.check,) = Network.build(made)
    aboard.look()
    result = aboard.later(10.0, 4.0, 4.4)
    assert (result.condition, result.target) == ("transport_blocked", "")


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


@pytest.mark.parametrize("ages_s", [(0.1, 5.0), (0.5, 0.6), (4.0, 8.0), (5.0,)])
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
    assert (result.condition, result.evidence.never_ok) == ("transport_blocked", True)
    assert "nothing has been received since it was started" in result.summary


def test_without_a_picture_nothing_is_said(aboard: Aboard) -> None:
    """Cannot tell: a ROS child that is being replaced, an engine that lists no processes."""
    aboard.ros.fail()
    assert aboard.later(10.0, 4.0, 4.0).level is api.Level.OK
    aboard.ros.work()
    aboard.docker.lists.clear()
    assert aboard.later(1.0, 5.0, 5.0).level is api.Level.OK


# ---------------------------------------------------------------- soon


def silent(aboard: Aboard, *ages_s: float) -> api.Result:
    """Nothing comes any more: the beacons are so old, and older with each moment."""
    aboard.clock.meanwhile = lambda seconds: aboard.heard(*(age_s + seconds for age_s in ages_s))
    return aboard.later(10.0, *ages_s)


def test_a_second_of_silence_of_all_sleeping_nodes_will_do(aboard: Aboard) -> None:
    """Beacons have threads of their own, and none of the processes waits for a processor; a second look confirms it."""
    result = silent(aboard, 0.9, 1.0)
    assert (result.condition, aboard.clock.waits) == ("transport_blocked", 1)
    assert "for 1.3 s" in result.summary


def test_what_was_told_stays_until_something_is_heard(aboard: Aboard) -> None:
    """Also when a process happens to work at the moment of a look; and that costs no second look."""
    silent(aboard, 0.9, 1.0)
    aboard.docker.lists["ros_app"] = (ROWS[0], replace(ROWS[1], state="R"))
    assert aboard.later(0.5, 1.8, 1.9).condition == "transport_blocked"
    assert aboard.clock.waits == 1
    assert aboard.later(0.5, 0.1, 2.4).level is api.Level.OK


@pytest.mark.parametrize(
    "why",
    ["one computes", "heard again", "the child is late", "one after the other", "no beacons", "one left", "child lost"],
)
def test_a_silence_with_another_reason_is_waited_for(aboard: Aboard, why: str) -> None:
    """A starved machine, a flicker, PHM's own child, nodes that end, and topics alone, which may have one source."""
    if why == "one computes":
        aboard.docker.lists["ros_app"] = (ROWS[0], replace(ROWS[1], state="R"))
    if why == "one after the other":
        assert silent(aboard, 0.9, 1.9).level is api.Level.OK
        return
    if why == "the child is late":
        aboard.ros.change(age_s=0.8)
    aboard.clock.advance(10.0)
    aboard.heard(0.9, 1.0)
    if why == "no beacons":
        aboard.ros.change(beacons={})
    later: dict[str, Callable[[float], None]] = {
        "heard again": lambda _: aboard.heard(0.1, 0.1),
        "one left": lambda seconds: aboard.ros.change(nodes={NODES[0]: 1}),
        "child lost": lambda seconds: aboard.ros.fail(),
    }
    aboard.clock.meanwhile = later.get(why, lambda seconds: aboard.heard(0.9 + seconds, 1.0 + seconds))
    assert aboard.look().level is api.Level.OK


def test_a_silence_that_ended_by_itself_is_remembered(aboard: Aboard) -> None:
    """This machine stands still at times: from then on twice as long is waited for, but for no longer than ten minutes."""
    aboard.heard(1.0, 1.0)
    aboard.clock.advance(10.0)
    aboard.clock.meanwhile = lambda _: aboard.heard(0.1, 0.1)
    assert aboard.look().level is api.Level.OK
    assert silent(aboard, 1.5, 1.6).level is api.Level.OK
    assert silent(aboard, 2.5, 2.6).condition == "transport_blocked"
    aboard.later(600.0, 0.1, 0.1)
    assert silent(aboard, 1.0, 1.0).condition == "transport_blocked"


# ---------------------------------------------------------------- discovery does not pass either


def test_nodes_that_are_neither_listed_nor_heard_are_one_fault(aboard: Aboard) -> None:
    """Told at the network, before each node would be by itself; nothing is restarted for it."""
    aboard.later(20.0, 4.5, 4.6)
    aboard.ros.change(nodes={})
    result = aboard.look()
    assert (result.level, result.condition) == (api.Level.ERROR, "nodes_unreachable")
    assert "none of its 2 nodes is listed" in result.summary


@pytest.mark.parametrize(
    "why", ["one is listed", "not long enough", "one process ended", "one computes", "a young child", "a young life"]
)
def test_nodes_that_are_not_there_for_another_reason_are_their_own_faults(aboard: Aboard, why: str) -> None:
    """They start, they have ended, or they come and go."""
    aboard.later(1.0 if why == "a young life" else 20.0, *((1.0, 1.1) if why == "not long enough" else (4.5, 4.6)))
    aboard.ros.change(
        nodes={NODES[1]: 1} if why == "one is listed" else {}, up_s=3.0 if why == "a young child" else 60.0
    )
    if why in ("one process ended", "one computes"):
        aboard.docker.lists["ros_app"] = (
            ROWS[:1] if why == "one process ended" else (ROWS[0], replace(ROWS[1], state="R"))
        )
    assert aboard.look().level is api.Level.OK
