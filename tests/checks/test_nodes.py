"""Slot 6: what the ROS graph says about a node."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm import api, testing
from phm_checks._graph_evidence import TWICE_S
from phm_checks._liveness import GOODBYE_S
from phm_checks.nodes import Nodes
from tests.fakes.nodes_bench import (
    GRACE_S,
    MAIN,
    NAME,
    NODE,
    ONE,
    TOPIC,
    Bench,
    active_topic,
    live_beacon,
    rated,
)


def test_without_configured_nodes_no_check_is_built() -> None:
    """There is nothing to check."""
    assert list(Nodes.build(testing.settings())) == []


def test_a_listed_node_is_ok() -> None:
    """Names match with and without the leading slash."""
    bench = Bench()
    result = bench.result()
    assert (result.level, result.summary) == (api.Level.OK, "Node agent_1/node_1 is running")
    assert result.values == {"listed": 1, "process": "71 S"}
    (unit,) = bench.check.units
    assert unit == api.Unit(
        NODE, ("container/ros_app", "network/ros_app"), target="ros_app", grace_s=GRACE_S, node="/agent_1/node_1"
    )


def test_a_node_without_a_known_container_depends_on_none() -> None:
    """With two containers and no assignment there is no container to blame or restart, and no process list."""
    settings = testing.settings(containers=[{"name": "a"}, {"name": "b"}], ros={"nodes": [{"name": "/n"}]})
    (check,) = Nodes.build(settings)
    assert check.units == [api.Unit("nodes/n", grace_s=GRACE_S, node="/n")]
    docker = testing.FakeDocker()
    check.run(testing.world(docker=docker, ros=testing.FakeRos(nodes={"/n": 1})))
    assert docker.calls == docker.listings == 0


def test_each_node_has_its_own_result() -> None:
    """One dead node is one fault."""
    bench = Bench(nodes=[{"name": "/agent_1/node_1"}, {"name": "/agent_1/node_2"}])
    levels = {unit: result.level for unit, result in bench.results().items()}
    assert levels == {NODE: api.Level.OK, "nodes/agent_1/node_2": api.Level.ERROR}


# ---------------------------------------------------------------- the graph


def test_a_node_that_left_the_graph_is_dead() -> None:
    """Seen before, missing now, and for long enough that its container is not stopping too."""
    bench = Bench()
    bench.processes(MAIN)
    bench.result()
    bench.ros.change(nodes={})
    assert bench.result().level is api.Level.OK
    bench.clock.advance(GOODBYE_S + 0.01)
    result = bench.result()
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "node_missing", "node_1 dead")
    assert result.target == "ros_app"
    assert "Missing node: agent_1/node_1; it is no longer running in ros_app: it is not in the graph" in result.summary


def test_a_node_that_was_never_seen_never_started() -> None:
    """The advice differs: check names and the launch file."""
    bench = Bench()
    bench.processes(MAIN)
    bench.ros.change(nodes={"/agent_1/nod_1": 1})
    result = bench.result()
    assert (result.condition, result.brief) == ("node_missing", "node_1 never started")
    assert "/agent_1/nod_1" in result.summary


def test_a_new_snapshot_proves_no_absence() -> None:
    """Discovery needs seconds to fill the graph."""
    bench = Bench()
    bench.ros.change(nodes={}, up_s=3.0)
    assert bench.result().level is api.Level.STALE


def test_an_outdated_snapshot_proves_nothing() -> None:
    """Neither presence nor absence."""
    bench = Bench()
    bench.ros.change(age_s=30.0)
    result = bench.result()
    assert result.level is api.Level.STALE
    assert "30 s old" in result.summary or "its process 71 is running" in result.summary


def test_without_a_snapshot_every_node_is_stale() -> None:
    """A dead ROS child process is PHM's own problem."""
    bench = Bench(nodes=[{"name": "/agent_1/node_1"}, {"name": "/agent_1/node_2"}])
    bench.processes()
    bench.ros.fail("the ROS child is being replaced")
    for result in bench.results().values():
        assert (result.level, "the ROS child is being replaced" in result.summary) == (api.Level.STALE, True)


def test_without_a_snapshot_a_terminated_process_is_still_a_dead_node() -> None:
    """The process list does not need ROS."""
    bench = Bench()
    bench.result()
    bench.ros.fail("the ROS child is being replaced")
    bench.processes(MAIN)
    result = bench.after(1.0)
    assert result.brief == "node_1 dead"
    assert "its process 71 has ended" in result.summary


def test_a_node_that_a_new_snapshot_had_and_lost_is_dead() -> None:
    """The warm-up applies to nodes that were not discovered yet, not to nodes that were discovered and are gone."""
    bench = Bench()
    bench.processes()
    bench.ros.change(up_s=2.0)
    bench.result()
    bench.ros.change(nodes={}, up_s=3.0)
    assert bench.after(0.5).level is api.Level.ERROR
    bench.ros.change(up_s=0.5)
    assert bench.result().level is api.Level.STALE


def test_after_a_restart_of_the_ros_child_nothing_is_reported_before_discovery() -> None:
    """Its snapshot is empty at first: earlier names and beacons do not count."""
    bench = rated()
    bench.ros.change(beacons=live_beacon())
    bench.after(3.0)
    levels = set()

    def child(passed: float) -> None:
        if passed <= 1.0:
            bench.ros.fail("the ROS child is being replaced")
        else:
            bench.ros.work()
            bench.ros.change(up_s=passed - 1.0, nodes={}, topics={}, beacons={})
            if passed > 5.0:
                bench.ros.change(nodes={NAME: 1}, topics=active_topic(), beacons=live_beacon())
        levels.add(bench.result().level)

    assert bench.after(8.0, child).level is api.Level.OK
    assert levels == {api.Level.OK, api.Level.STALE}


def test_a_node_listed_twice_is_reported_only_after_the_lease() -> None:
    """A restarted node is listed beside its stale entry until the lease expires."""
    bench = Bench()
    bench.result()
    bench.ros.change(nodes={NAME: 2})
    levels = [bench.result().level]
    bench.clock.advance(TWICE_S + 1)
    twice = bench.result()
    levels.append(twice.level)
    bench.ros.change(nodes={NAME: 1})
    levels.append(bench.result().level)
    assert levels == [api.Level.OK, api.Level.WARN, api.Level.OK]
    assert (twice.condition, twice.brief) == ("node_duplicate", "node_1 runs twice")


def test_a_node_with_two_processes_is_a_duplicate_regardless_of_its_lease() -> None:
    """Listed twice with two processes for longer than a restart takes: certain, so it is an error, and the cause."""
    bench = Bench()
    bench.result()
    bench.ros.change(nodes={NAME: 2})
    bench.processes(MAIN, ONE, replace(ONE, pid=99))
    assert bench.result().level is api.Level.OK
    twice = bench.after(4.0)
    assert (twice.level, twice.condition, twice.target) == (api.Level.ERROR, "node_duplicate", "ros_app")
    assert "2 processes" in twice.summary
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(5.0).condition == "node_duplicate", "a graph that is being rebuilt may not list both yet"
    bench.processes(MAIN, ONE)
    assert bench.after(1.0).level is api.Level.OK


def test_two_processes_with_live_beacons_are_a_duplicate_immediately() -> None:
    """Graph, process list and beacons agree, which never happens when a new node overlaps with an old one."""
    bench = Bench()
    bench.ros.change(beacons=live_beacon())
    bench.after(12.0)
    bench.ros.change(nodes={NAME: 2})
    bench.processes(MAIN, ONE, replace(ONE, pid=99))
    assert bench.after(1.0).level is api.Level.OK
    bench.ros.change(beacons={NAME: replace(live_beacon()[NAME], rivals=1)})
    result = bench.after(0.25)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "node_duplicate", "ros_app")


def test_a_second_beacon_elsewhere_is_reported_without_waiting_for_a_lease() -> None:
    """The other node runs in no container of this agent, so nothing here is restarted for it."""
    bench = Bench()
    bench.ros.change(nodes={NAME: 2}, beacons={NAME: replace(live_beacon()[NAME], rivals=1)})
    result = bench.after(0.25)
    assert (result.level, result.condition, result.target) == (api.Level.WARN, "node_duplicate", "")
    assert "two processes send beacons under its name" in result.summary


def test_a_leftover_name_is_not_a_second_node() -> None:
    """The middleware keeps some names forever; its topic endpoints exist once, and a second node would have them, too."""
    bench = rated()
    bench.ros.change(nodes={NAME: 2})
    assert bench.after(2 * TWICE_S).level is api.Level.OK
    ends = (api.EndpointFact(NAME, "std_msgs/msg/String"),) * 2
    bench.ros.change(topics={TOPIC: replace(active_topic()[TOPIC], publishers=ends)})
    assert bench.after(TWICE_S + 0.5).condition == "node_duplicate"


@pytest.mark.parametrize(("listed", "pids"), [(2, (71,)), (1, (71, 99))])
def test_one_indication_of_a_second_node_is_not_enough(listed: int, pids: tuple[int, ...]) -> None:
    """A lease that has not expired, or a process that only resembles the node's."""
    bench = Bench()
    bench.result()
    bench.ros.change(nodes={NAME: listed})
    bench.processes(MAIN, *(replace(ONE, pid=pid) for pid in pids))
    assert bench.after(10.0).level is api.Level.OK


def test_a_name_that_lost_its_endpoints_is_not_alive() -> None:
    """If its process is unknown; endpoints that the node never had are reported by the topic."""
    bench = Bench(topics=[{"name": TOPIC, "publishers": [NAME]}])
    bench.processes()
    bench.ros.change(topics={TOPIC: api.TopicFact()})
    assert bench.after(20.0).level is api.Level.OK
    bench.ros.change(topics={TOPIC: api.TopicFact((api.EndpointFact(NAME, ""),))})
    assert bench.result().level is api.Level.OK
    bench.ros.change(topics={TOPIC: api.TopicFact()})
    assert bench.after(1.0).level is api.Level.STALE
    result = bench.after(2.0)
    assert (result.level, result.condition) == (api.Level.ERROR, "node_missing")
    assert "none of its endpoints is in the graph" in result.summary
