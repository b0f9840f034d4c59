"""Slot 6: nodes that share one process, as in a component container."""

from __future__ import annotations

import pytest

from phm import api
from phm_checks._liveness import LOST_S
from tests.fakes.nodes_bench import GRACE_S, MAIN, NAME, NODE, Bench, live_beacon

OTHER = "/agent_1/node_2"


def components(state: str = "R") -> Bench:
    """Two components of one process, neither of which is listed. "R": it uses the CPU."""
    bench = Bench(nodes=[{"name": f"agent_1/node_{n}", "process": ["component_container"]} for n in (1, 2)])
    bench.processes(MAIN, api.ProcessFact(71, 1, state, 5.0, "component_container"))
    bench.ros.change(nodes={})
    return bench


@pytest.mark.parametrize("state", ["R", "S"])
def test_a_component_that_was_not_loaded_is_missing(state: str) -> None:
    """Its process shows only that the other one runs, however busy it is."""
    bench = components(state)
    bench.ros.change(nodes={OTHER: 1}, up_s=0.0)
    assert bench.after(GRACE_S / 2).level is api.Level.STALE
    bench.ros.change(up_s=GRACE_S)
    result = bench.after(1.0)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "node_missing", "ros_app")
    assert bench.results()["nodes/agent_1/node_2"].level is api.Level.OK


def test_a_component_that_was_unloaded_is_missing() -> None:
    """As any node that leaves the graph."""
    bench = components()
    bench.ros.change(nodes={NAME: 1, OTHER: 1})
    assert bench.after(GRACE_S).level is api.Level.OK
    bench.ros.change(nodes={OTHER: 1})
    assert bench.after(1.0).condition == "node_missing"


def test_a_busy_process_none_of_whose_nodes_is_listed_is_not_known() -> None:
    """It gets no CPU for its announcements, or PHM does not receive it."""
    bench = components()
    bench.ros.change(nodes={NAME: 1, OTHER: 1})
    bench.after(GRACE_S)
    bench.ros.change(nodes={})
    assert bench.after(LOST_S + 1.0).level is api.Level.STALE


def test_a_node_whose_neighbour_sends_gets_time_until_the_names_are_known() -> None:
    """Names may be missing although both run, until the child is replaced."""
    bench = components()
    bench.ros.change(nodes={NAME: 1, OTHER: 1})
    bench.after(GRACE_S)
    levels = []
    beacons = {OTHER: live_beacon()[NAME]}
    bench.ros.change(nodes={}, beacons=beacons)
    bench.after(LOST_S - 1.0, lambda _: levels.append(bench.results()[NODE].level))
    assert api.Level.ERROR not in levels
    assert bench.after(2.0).condition == "node_missing"


def test_a_component_that_sends_is_alive_although_it_is_not_listed() -> None:
    """Its own beacon counts, and so does its process while its executor is late."""
    bench = components()
    bench.ros.change(nodes={NAME: 1, OTHER: 1}, beacons=live_beacon())
    bench.after(GRACE_S)
    bench.ros.change(nodes={OTHER: 1}, beacons=live_beacon(late_s=3.0))
    assert bench.after(1.0).level is api.Level.OK


def test_a_stopped_process_is_hung_with_all_its_nodes() -> None:
    """What the engine reports about it counts for each."""
    bench = components("T")
    bench.ros.change(nodes={OTHER: 1})
    bench.after(GRACE_S)
    assert bench.result().condition == "node_hung"
