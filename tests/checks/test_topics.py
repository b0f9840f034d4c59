"""Slot 7: rules of the topics check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.topics import Topics

NAME = "/agent_1/topic_1"
UNIT = "topics/agent_1/topic_1"
STRING = "std_msgs/msg/String"


def end(node: str = "/agent_1/node_1", type_: str = STRING, *qos: str) -> api.EndpointFact:
    return api.EndpointFact(node, type_, *qos)


def build(**topic: Any) -> api.Check:
    settings = testing.settings(containers=[{"name": "ros_app"}], ros={"topics": [{"name": NAME, **topic}]})
    (check,) = Topics.build(settings)
    return check


def judge(check: api.Check, fact: api.TopicFact | None, **ros: Any) -> api.Result:
    topics = {} if fact is None else {NAME: fact}
    results = check.run(testing.world(ros=testing.FakeRos(topics=topics, **ros)))
    assert not isinstance(results, api.Result)
    return results[UNIT]


PAIR = api.TopicFact((end(),), (end("/agent_1/node_2"),))


def test_a_connected_topic_is_ok() -> None:
    """All named ends are there and of the configured type."""
    check = build(type=STRING, publishers=["agent_1/node_1"], subscribers=["/agent_1/node_2"])
    assert judge(check, PAIR).level is api.Level.OK


def test_a_topic_needs_its_nodes_and_their_container() -> None:
    """A dead node is told once, at the node; the topic's evidence arrives earlier, so it settles first."""
    (unit,) = build(publishers=["/agent_1/node_1"], subscribers=["/agent_1/node_2"]).units
    assert unit.needs == ("container/ros_app", "network/ros_app", "nodes/agent_1/node_1", "nodes/agent_1/node_2")
    assert (unit.target, unit.settle_s, unit.grace_s) == ("ros_app", 1.5, 8.0)


@pytest.mark.parametrize("fact", [None, api.TopicFact()])
def test_a_topic_without_ends_is_missing(fact: api.TopicFact | None) -> None:
    """Nobody knows it."""
    result = judge(build(), fact)
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "topic_missing", "topic_1 missing")


def test_a_topic_with_subscribers_alone_lacks_its_publisher() -> None:
    """Any publisher will do when none is named, but one must be."""
    assert judge(build(), api.TopicFact((), (end(),))).condition == "publisher_missing"


@pytest.mark.parametrize(
    ("side", "condition"), [("publishers", "publisher_missing"), ("subscribers", "subscriber_missing")]
)
def test_a_named_end_that_is_lacking_is_told(side: str, condition: str) -> None:
    """Another node in its place does not count, and a near name is offered."""
    result = judge(build(**{side: ["/agent_1/node_7"]}), PAIR)
    assert (result.level, result.condition) == (api.Level.ERROR, condition)
    assert "node_7" in result.brief and "is one of these meant" in result.summary


def test_another_type_than_the_configured_is_an_error() -> None:
    """Ends of different type do not connect although both are listed."""
    fact = api.TopicFact((end(),), (end("/agent_1/node_2", "std_msgs/msg/Int32"),))
    result = judge(build(type=STRING), fact)
    assert (result.level, result.condition) == (api.Level.ERROR, "type_wrong")
    assert "std_msgs/msg/Int32" in result.summary


def test_mixed_types_are_a_warning_when_none_is_configured() -> None:
    """Which of them is wrong is not known."""
    fact = api.TopicFact((end(),), (end("/agent_1/node_2", "std_msgs/msg/Int32"),))
    assert judge(build(), fact).level is api.Level.WARN


@pytest.mark.parametrize(
    ("offered", "asked", "policy"),
    [
        (("best_effort", "volatile"), ("reliable", "volatile"), "reliability"),
        (("BEST_EFFORT", "VOLATILE"), ("RELIABLE", "VOLATILE"), "reliability"),
        (("reliable", "volatile"), ("reliable", "transient_local"), "durability"),
        (("reliable", "transient_local"), ("best_effort", "volatile"), ""),
        (("", ""), ("reliable", "transient_local"), ""),
    ],
)
def test_quality_of_service_that_does_not_fit_is_a_warning(
    offered: tuple[str, str], asked: tuple[str, str], policy: str
) -> None:
    """The policy and both sides are named; offering more than is asked fits; what is not told is not judged."""
    fact = api.TopicFact((end("/talker", STRING, *offered),), (end("/listener", STRING, *asked),))
    result = judge(build(), fact)
    assert result.level is (api.Level.WARN if policy else api.Level.OK)
    if policy:
        assert f"{policy}: publisher /talker" in result.summary and "subscriber /listener" in result.summary


def test_a_young_picture_proves_no_absence() -> None:
    """Discovery needs seconds to fill the graph."""
    assert judge(build(), None, up_s=2.0).level is api.Level.STALE


def test_an_old_picture_proves_nothing() -> None:
    """A frozen graph is not judged."""
    assert judge(build(), PAIR, age_s=30.0).level is api.Level.STALE


def test_no_picture_makes_every_topic_stale() -> None:
    """Without rclpy the rest of PHM goes on."""
    ros = testing.FakeRos()
    ros.fail("rclpy is not installed")
    results = build().run(testing.world(ros=ros))
    assert not isinstance(results, api.Result)
    assert results[UNIT].level is api.Level.STALE
    assert "rclpy" in results[UNIT].summary


def test_no_topics_no_check() -> None:
    """Nothing to judge, nothing built."""
    assert list(Topics.build(testing.settings())) == []
