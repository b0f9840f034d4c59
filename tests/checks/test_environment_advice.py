"""A visible difference between the ROS environments comes first in the text of a fault, else the general advice."""

from __future__ import annotations

import pytest

from phm import api, testing
from phm_checks._environment_advice import advice
from phm_checks._liveness import LOST_S
from phm_checks.rates import Rates
from tests.fakes.nodes_bench import GRACE_S, MAIN, NAME, Bench, pair

DOMAIN = api.EnvironmentDifference("ROS_DOMAIN_ID", "ROS_DOMAIN_ID is 7 in ros_app and 0 in PHM: set it")
PROFILE = api.EnvironmentDifference("FASTDDS_DEFAULT_PROFILES_FILE", "ros_app loads a profile", certain=False)
OTHERWISE = "check the network"


def world(*found: api.EnvironmentDifference) -> api.World:
    environment = testing.FakeEnvironment()
    environment.found["ros_app"] = found
    return testing.world(environment=environment)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ((), OTHERWISE),
        ((DOMAIN,), DOMAIN.text),
        ((DOMAIN, PROFILE), DOMAIN.text),
        ((PROFILE,), f"{OTHERWISE}; {PROFILE.text}"),
    ],
)
def test_a_certain_difference_replaces_the_general_advice(
    found: tuple[api.EnvironmentDifference, ...], expected: str
) -> None:
    """One that may be harmless is added to it."""
    assert advice(world(*found), "ros_app", OTHERWISE) == expected


def test_where_discovery_works_only_transports_are_named() -> None:
    """Another domain cannot be the cause then."""
    assert advice(world(DOMAIN), "ros_app", OTHERWISE, data_only=True) == OTHERWISE


def test_without_a_container_or_an_engine_the_advice_is_general() -> None:
    """Nothing is known of the application's environment."""
    assert advice(world(DOMAIN), "", OTHERWISE) == OTHERWISE
    environment = testing.FakeEnvironment()
    environment.fail("the engine is silent")
    assert advice(testing.world(environment=environment), "ros_app", OTHERWISE) == OTHERWISE


def test_foreign_text_is_cut() -> None:
    """Values come from a container's configuration."""
    long = api.EnvironmentDifference("ROS_STATIC_PEERS", "x" * 5000)
    assert len(advice(world(long), "ros_app", OTHERWISE)) <= 400


def test_nodes_that_are_not_received_name_the_difference() -> None:
    """Their processes run, and nothing of them is in the graph."""
    bench = pair()
    bench.after(3.0)
    bench.environment.found["ros_app"] = (DOMAIN,)
    bench.ros.change(nodes={})
    result = bench.after(LOST_S + 1.0)
    assert result.condition == "node_unreachable"
    assert DOMAIN.text in result.summary and "firewalls" not in result.summary


def test_a_node_that_was_never_seen_names_the_difference() -> None:
    """Only while no node of its container is listed: another domain would hide all of them."""
    bench = Bench()
    bench.environment.found["ros_app"] = (DOMAIN,)
    bench.processes(MAIN)
    bench.ros.change(nodes={})
    result = bench.after(GRACE_S + 1.0)
    assert result.condition == "node_missing" and DOMAIN.text in result.summary
    bench = pair()
    bench.environment.found["ros_app"] = (DOMAIN,)
    bench.processes(MAIN)
    bench.ros.change(nodes={"/agent_1/node_2": 1})
    summary = bench.after(GRACE_S + 1.0).summary
    assert NAME.lstrip("/") in summary and DOMAIN.text not in summary


def test_a_blocked_transport_names_the_difference() -> None:
    """Publishers are discovered without the names of their nodes."""
    settings = testing.settings(containers=[{"name": "ros_app"}], ros={"topics": [{"name": "/t", "rate": 10}]})
    (check,) = Rates.build(settings)
    publisher = (api.EndpointFact("", "std_msgs/msg/String"),)
    ros = testing.FakeRos(topics={"/t": api.TopicFact(publisher, (), api.RateFact(None, None))})
    environment = testing.FakeEnvironment()
    environment.found["ros_app"] = (PROFILE,)
    results = check.run(testing.world(ros=ros, environment=environment))
    assert not isinstance(results, api.Result)
    assert PROFILE.text in results["rates/t"].summary
