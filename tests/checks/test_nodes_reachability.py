"""Slot 6: no node of a container is reachable although all of its processes run."""

from __future__ import annotations

import pytest

from phm import api
from phm_checks._graph_evidence import UNNAMED_S
from phm_checks._liveness import LOST_S
from phm_checks._process_table import OLD_S
from tests.fakes.nodes_bench import (
    GRACE_S,
    MAIN,
    NAME,
    ONE,
    TOPIC,
    Bench,
    live_beacon,
    pair,
)


def test_when_no_node_of_a_container_is_received_though_all_run_nothing_is_restarted() -> None:
    """Discovery between PHM and the container is broken; the nodes themselves may be OK."""
    bench = pair()
    bench.after(3.0)
    bench.ros.change(nodes={})
    result = bench.after(LOST_S + 1.0)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "node_unreachable", "")
    assert "or any other node of ros_app" in result.summary and "its process 71 is running" in result.summary
    bench.ros.change(nodes={NAME: 1, "/agent_1/node_2": 1})
    assert bench.after(1.0).level is api.Level.OK


def test_nodes_of_one_process_that_left_the_graph_are_missing() -> None:
    """A hung component container: its nodes are one witness, and a restart helps."""
    bench = Bench(nodes=[{"name": f"agent_1/node_{n}", "process": ["component_container"]} for n in (1, 2)])
    bench.ros.change(nodes={NAME: 1, "/agent_1/node_2": 1})
    bench.processes(MAIN, api.ProcessFact(71, 1, "S", 5.0, "component_container"))
    bench.after(3.0)
    bench.ros.change(nodes={})
    result = bench.after(LOST_S + 1.0)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "node_missing", "ros_app")


def test_a_transport_that_hides_names_restarts_no_node() -> None:
    """Node names arrive as data: publishers exist, but no node is listed or was ever seen."""
    bench = pair(topics=[{"name": TOPIC, "rate": 10, "publishers": [NAME]}])
    nameless = api.TopicFact((api.EndpointFact("", "std_msgs/msg/String"),), (), api.RateFact(None, None))
    bench.ros.change(nodes={}, topics={TOPIC: nameless})
    result = bench.after(GRACE_S + LOST_S + 1.0)
    assert (result.condition, result.target) == ("node_unreachable", "")


def test_a_node_that_lost_only_its_name_is_not_missing() -> None:
    """Its topic has a publisher without a name: PHM lost the names and gets them with a new participant, so it waits."""
    bench = Bench(topics=[{"name": TOPIC, "publishers": [NAME]}])
    named, nameless = (api.TopicFact((api.EndpointFact(node, "std_msgs/msg/String"),)) for node in (NAME, ""))
    bench.ros.change(topics={TOPIC: named})
    assert bench.after(GRACE_S).level is api.Level.OK
    levels = []
    bench.ros.change(nodes={}, topics={TOPIC: nameless})
    bench.after(UNNAMED_S - 1.0, lambda _: levels.append(bench.result().level))
    assert api.Level.ERROR not in levels
    bench.ros.change(nodes={NAME: 1}, topics={TOPIC: named})
    assert bench.after(1.0).level is api.Level.OK
    bench.ros.change(nodes={}, topics={TOPIC: nameless})
    assert bench.after(UNNAMED_S + 1.0).condition == "node_missing"


@pytest.mark.parametrize("publisher", ["/agent_1/bridge", ""])
def test_a_dead_node_beside_a_publisher_without_a_node_is_found_as_fast(publisher: str) -> None:
    """PX4's uXRCE-DDS agent never gets a name, so its endpoint is not the lost one of the node."""
    bench = Bench(topics=[{"name": TOPIC, "subscribers": [NAME]}])
    bench.docker.lists.clear()
    theirs, own = ((api.EndpointFact(node, "std_msgs/msg/String"),) for node in (publisher, NAME))
    bench.ros.change(topics={TOPIC: api.TopicFact(theirs, own)})
    assert bench.after(GRACE_S).level is api.Level.OK
    bench.ros.change(nodes={}, topics={TOPIC: api.TopicFact(theirs)})
    assert bench.after(LOST_S).condition == "node_missing"


def test_a_lost_name_beside_a_publisher_without_a_node_is_not_a_missing_node() -> None:
    """One more endpoint without a name than before: it may be the node's."""
    bench = Bench(topics=[{"name": TOPIC, "subscribers": [NAME]}])
    bench.docker.lists.clear()
    bare, own = ((api.EndpointFact(node, "std_msgs/msg/String"),) for node in ("", NAME))
    bench.ros.change(topics={TOPIC: api.TopicFact(bare, own)})
    bench.after(GRACE_S)
    bench.ros.change(nodes={}, topics={TOPIC: api.TopicFact(bare, bare)})
    assert bench.after(UNNAMED_S - 1.0).level is not api.Level.ERROR


@pytest.mark.parametrize("why", ["one is received", "one is listed", "one ended", "the processes are unknown"])
def test_a_node_is_dead_unless_all_nodes_of_its_container_run_unreachable(why: str) -> None:
    """One received node, or one unknown process, and a missing node is a missing node."""
    bench = pair()
    bench.after(3.0)
    bench.ros.change(nodes={"/agent_1/node_2": 1} if why == "one is listed" else {})
    if why == "one is received":
        bench.after(LOST_S + 1.0, lambda _: bench.ros.change(beacons={"/agent_1/node_2": live_beacon()[NAME]}))
    if why == "one ended":
        bench.processes(MAIN, ONE)
    if why == "the processes are unknown":
        del bench.docker.lists["ros_app"]
        bench.after(OLD_S)
    result = bench.after(LOST_S + 1.0)
    assert (result.condition, result.target) == ("node_missing", "ros_app")
