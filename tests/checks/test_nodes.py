"""Slot 6: rules of the nodes check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.nodes import SETTLE_S, TWICE_S, Nodes

NODE = "nodes/agent_1/node_1"


class Bench:
    """One node in one container, with the fakes at hand."""

    def __init__(self, *, nodes: list[dict[str, Any]] | None = None) -> None:
        settings = testing.settings(
            containers=[{"name": "ros_app"}], ros={"nodes": nodes or [{"name": "agent_1/node_1"}], "grace": "8s"}
        )
        (self.check,) = Nodes.build(settings)
        self.clock, self.ros = testing.FakeClock(), testing.FakeRos(nodes={"/agent_1/node_1": 1})
        self.docker = testing.FakeDocker(testing.container("ros_app"))

    def results(self) -> dict[str, api.Result]:
        results = self.check.run(testing.world(clock=self.clock, ros=self.ros, docker=self.docker))
        assert not isinstance(results, api.Result)
        return dict(results)

    def result(self) -> api.Result:
        return self.results()[NODE]


def test_no_nodes_no_check() -> None:
    """Nothing to judge, nothing built."""
    assert list(Nodes.build(testing.settings())) == []


def test_a_listed_node_is_ok() -> None:
    """Names match with and without their first slash."""
    bench = Bench()
    assert bench.result().level is api.Level.OK
    (unit,) = bench.check.units
    assert unit == api.Unit(
        NODE, ("container/ros_app", "network/ros_app"), target="ros_app", settle_s=SETTLE_S, grace_s=8.0
    )


def test_a_node_that_vanished_is_dead() -> None:
    """Seen before, gone now."""
    bench = Bench()
    bench.result()
    bench.ros.change(nodes={})
    result = bench.result()
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "node_missing", "node_1 dead")
    assert result.target == "ros_app"
    assert "Missing node: agent_1/node_1" in result.summary


def test_a_node_never_seen_never_started() -> None:
    """The remedy is another: look at names and launch file."""
    bench = Bench()
    bench.ros.change(nodes={"/agent_1/nod_1": 1})
    result = bench.result()
    assert result.brief == "node_1 never started"
    assert "/agent_1/nod_1" in result.summary


def test_what_was_seen_before_the_container_restarted_does_not_count() -> None:
    """After a restart the node has to start anew; until then it never did."""
    bench = Bench()
    bench.result()
    bench.docker.change("ros_app", started_at="later")
    bench.ros.change(nodes={})
    assert bench.result().brief == "node_1 never started"


def test_a_young_picture_proves_no_absence() -> None:
    """Discovery needs seconds to fill the graph."""
    bench = Bench()
    bench.ros.change(nodes={}, up_s=3.0)
    assert bench.result().level is api.Level.STALE


def test_an_old_picture_proves_nothing() -> None:
    """Neither presence nor absence."""
    bench = Bench()
    bench.ros.change(age_s=30.0)
    assert bench.result().level is api.Level.STALE


def test_no_picture_makes_every_node_stale() -> None:
    """A dead ROS child is PHM's trouble."""
    bench = Bench(nodes=[{"name": "/agent_1/node_1"}, {"name": "/agent_1/node_2"}])
    bench.ros.fail("the ROS child is being replaced")
    assert {unit: result.level for unit, result in bench.results().items()} == {
        NODE: api.Level.STALE,
        "nodes/agent_1/node_2": api.Level.STALE,
    }


def test_each_node_is_judged_for_itself() -> None:
    """One dead node is one fault."""
    bench = Bench(nodes=[{"name": "/agent_1/node_1"}, {"name": "/agent_1/node_2"}])
    levels = {unit: result.level for unit, result in bench.results().items()}
    assert levels == {NODE: api.Level.OK, "nodes/agent_1/node_2": api.Level.ERROR}


def test_a_node_listed_twice_is_told_only_after_the_lease() -> None:
    """A restarted node is listed beside its old self until the lease ends."""
    bench = Bench()
    bench.ros.change(nodes={"/agent_1/node_1": 2})
    levels = [bench.result().level]
    bench.clock.advance(TWICE_S + 1)
    levels.append(bench.result().level)
    bench.ros.change(nodes={"/agent_1/node_1": 1})
    levels.append(bench.result().level)
    assert levels == [api.Level.OK, api.Level.WARN, api.Level.OK]


@pytest.mark.parametrize("gone", [True, False])
def test_a_silent_engine_does_not_hide_a_dead_node(gone: bool) -> None:
    """The container's life is asked for the wording alone."""
    bench = Bench()
    bench.docker.fail()
    bench.result()
    if gone:
        bench.ros.change(nodes={})
    assert bench.result().level is (api.Level.ERROR if gone else api.Level.OK)


def test_a_node_of_an_unknown_container_needs_none() -> None:
    """With two containers and no word which one, there is nobody to blame or to restart."""
    settings = testing.settings(containers=[{"name": "a"}, {"name": "b"}], ros={"nodes": [{"name": "/n"}]})
    (check,) = Nodes.build(settings)
    assert check.units == (api.Unit("nodes/n", settle_s=SETTLE_S, grace_s=8.0),)


def test_a_node_that_a_young_picture_had_and_lost_is_dead() -> None:
    """The warm-up protects nodes that were not found yet, not nodes that were found and are gone."""
    bench = Bench()
    bench.ros.change(up_s=2.0)
    bench.result()
    bench.ros.change(nodes={}, up_s=3.0)
    assert bench.result().level is api.Level.ERROR
    bench.ros.change(up_s=0.5)
    assert bench.result().level is api.Level.STALE
