"""Slot 2: a container may run and not be ready."""

from __future__ import annotations

from typing import Any

from phm import api, testing
from phm_checks.container_ready import ContainerReady

UNIT = "container_ready/ros_app"


def settings(**ready: Any) -> api.Settings:
    return testing.settings(
        containers=[{"name": "ros_app", "ready": ready}, {"name": "router"}],
        ros={"nodes": [{"name": "/a/one", "container": "ros_app"}, {"name": "/a/two", "container": "router"}]},
    )


def build() -> api.Check:
    (check,) = ContainerReady.build(settings(services=["/a/plan"], within="12s"))
    return check


def evaluate(**fields: Any) -> api.Result:
    results = build().run(testing.world(ros=testing.FakeRos(**fields)))
    assert not isinstance(results, api.Result)
    return results[UNIT]


def test_readiness_is_opt_in() -> None:
    """Without `ready` there is no check."""
    assert not list(ContainerReady.build(testing.settings(containers=[{"name": "ros_app"}])))


def test_a_container_with_its_services_is_ready() -> None:
    """The text lists what was required."""
    result = evaluate(services={"/a/plan": 1})
    assert (result.level, result.summary) == (api.Level.OK, "Container ros_app is ready: /a/plan")


def test_a_container_without_its_service_is_not_ready() -> None:
    """The text names the service."""
    result = evaluate(services={"/a/plan": 0})
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "not_ready", "ros_app")
    assert result.summary.startswith("container ros_app runs and is not ready: service /a/plan has no server. ")
    assert result.brief == "ros_app not ready: no plan"


def test_without_ros_it_cannot_be_known() -> None:
    """STALE, no alarm."""
    assert evaluate(age_s=60.0).level is api.Level.STALE


def test_a_container_is_ready_only_if_its_health_and_nodes_are() -> None:
    """Its health, its nodes and their readiness come first; another container's nodes do not matter."""
    (unit,) = build().units
    assert unit.needs == (
        "container/ros_app", "network/ros_app", "health/ros_app", "nodes/a/one", "node_ready/a/one",
    )  # fmt: skip
    assert (unit.target, unit.grace_s) == ("ros_app", 12.0)
