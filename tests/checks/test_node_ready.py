"""Slot 6: a node may run and not be ready."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm_checks.node_ready import NodeReady
from phm_checks.topics import Topics

NODE = "/a/planner"
UNIT = "node_ready/a/planner"


def settings(**ready: Any) -> api.Settings:
    return testing.settings(
        containers=[{"name": "ros_app"}],
        ros={"nodes": [{"name": NODE, "ready": ready or {"lifecycle": "active"}}]},
    )


def build(**ready: Any) -> api.Check:
    (check,) = NodeReady.build(settings(**ready))
    return check


def evaluate(check: api.Check, **fields: Any) -> api.Result:
    """Run the check once on a snapshot with these fields."""
    results = check.run(testing.world(ros=testing.FakeRos(**fields)))
    assert not isinstance(results, api.Result)
    return results[UNIT]


def in_state(check: api.Check, state: str, **fields: Any) -> api.Result:
    return evaluate(check, lifecycle={NODE: api.AnswerFact(state, served=True)}, **fields)


def received(
    silent_s: float | None, *, durability: str = "volatile", hz: float | None = None, **fields: Any
) -> dict[str, api.TopicFact]:
    end = api.EndpointFact(NODE, "std_msgs/msg/String", "reliable", durability)
    return {"/a/plan": api.TopicFact((end,), (), api.RateFact(hz, silent_s, **fields))}


def advertised_elsewhere(silent_s: float | None) -> dict[str, api.TopicFact]:
    """A latched topic that another node only advertises, with the default QoS."""
    (seen,) = received(silent_s, durability="transient_local").values()
    other = replace(seen.publishers[0], node="/a/tool", durability="volatile")
    return {"/a/plan": replace(seen, publishers=(*seen.publishers, other))}


def test_readiness_is_opt_in() -> None:
    """Without `ready` there is no unit."""
    assert not list(NodeReady.build(testing.settings(ros={"nodes": [{"name": NODE}]})))


def test_a_node_in_its_state_is_ready() -> None:
    """The state is kept as a value."""
    result = in_state(build(), "active")
    assert (result.level, result.summary) == (api.Level.OK, "Node /a/planner is ready")
    assert result.values["lifecycle"] == "active"


@pytest.mark.parametrize("state", ["unconfigured", "inactive", "finalized", "errorprocessing", "unknown"])
def test_another_lifecycle_state_is_not_ready(state: str) -> None:
    """The text names both states; the state was observed, so a busy machine does not explain it."""
    result = in_state(build(), state)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "not_ready", "ros_app")
    assert f"node /a/planner runs and is not ready: its lifecycle state is {state}, expected active" in result.summary
    assert result.brief == f"planner not ready: {state}" and result.evidence.conclusive


def test_a_standby_node_may_be_required_to_be_inactive() -> None:
    """Then active is wrong."""
    check = build(lifecycle="inactive")
    assert in_state(check, "inactive").level is api.Level.OK
    assert in_state(check, "active").level is api.Level.ERROR


def test_the_level_is_configurable() -> None:
    """A WARN opens no fault and has no target."""
    result = in_state(build(lifecycle="active", level="warn"), "inactive")
    assert (result.level, result.target) == (api.Level.WARN, "")


@pytest.mark.parametrize(
    ("fact", "up_s", "level", "words"),
    [
        (api.AnswerFact(), 60.0, api.Level.ERROR, "it has no service /a/planner/get_state"),
        (api.AnswerFact(), 2.0, api.Level.STALE, "it has no service /a/planner/get_state"),
        (api.AnswerFact("", served=True), 60.0, api.Level.STALE, "has not answered yet"),
        (api.AnswerFact("active", served=True, unanswered_s=4.0), 60.0, api.Level.OK, "is ready"),
        (api.AnswerFact("active", served=True, unanswered_s=6.0), 60.0, api.Level.ERROR, "not answered for 6.0 s"),
        (
            api.AnswerFact(problem="lifecycle_msgs is not installed"),
            60.0,
            api.Level.STALE,
            "cannot be called: lifecycle",
        ),
    ],
)
def test_a_node_without_an_answer(fact: api.AnswerFact, up_s: float, level: api.Level, words: str) -> None:
    """No service and no answer are not ready; what PHM cannot know yet is STALE."""
    result = evaluate(build(), lifecycle={NODE: fact}, up_s=up_s)
    assert result.level is level and words in result.summary and not result.evidence.conclusive


UNANSWERED = api.AnswerFact("active", served=True, unanswered_s=6.0)


@pytest.mark.parametrize(
    ("ready", "fields", "target"),
    [
        ({"lifecycle": "active"}, {"lifecycle": {NODE: UNANSWERED}}, ""),
        ({"call": "/a/s"}, {"calls": {"/a/s": UNANSWERED}}, ""),
        (
            {"lifecycle": "active", "topics": ["/a/plan"]},
            {"lifecycle": {NODE: UNANSWERED}, "topics": received(9.0)},
            "",
        ),
        (
            {"lifecycle": "active", "services": ["/a/t"]},
            {"lifecycle": {NODE: UNANSWERED}, "services": {"/a/t": 0}},
            "ros_app",
        ),
        (
            {"lifecycle": "active", "call": "/a/s"},
            {"lifecycle": {NODE: api.AnswerFact("inactive", served=True)}, "calls": {"/a/s": UNANSWERED}},
            "ros_app",
        ),
        ({"topics": ["/a/plan"]}, {"topics": received(9.0)}, "ros_app"),
    ],
)
def test_a_node_that_only_does_not_answer_is_not_restarted(
    ready: dict[str, Any], fields: dict[str, Any], target: str
) -> None:
    """It may be busy, e.g. in a long callback, and then it publishes nothing either. A state that was answered, and a server that
    does not exist, are no such case."""
    result = evaluate(build(**ready), **fields)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "not_ready", target)
    assert ("PHM restarts nothing for this: it may be busy" in result.summary) is (not target)


def test_a_node_that_was_started_again_has_its_start_up_time() -> None:
    """From unconfigured on, through inactive, it has `within`; a node that is only deactivated has not."""
    check = build(lifecycle="active", within="20s")
    assert in_state(check, "active").level is api.Level.OK
    assert in_state(check, "inactive").settle_s is None
    assert in_state(check, "active").level is api.Level.OK
    assert [in_state(check, state).settle_s for state in ("unconfigured", "inactive")] == [20.0, 20.0]
    assert in_state(check, "active").level is api.Level.OK
    assert in_state(check, "inactive").settle_s is None


def test_a_node_that_is_never_ready_gets_no_second_start_up_time() -> None:
    """A crash loop must not hide itself: the time begins again only after the node was ready."""
    check = build()
    assert [in_state(check, state).settle_s for state in ("unconfigured", "configuring")] == [None, None]


def test_services_need_a_server() -> None:
    """The first missing one is on the operator's line; all are in the text."""
    check = build(services=["a/plan_path", "/a/clear"])
    assert evaluate(check, services={"/a/plan_path": 1, "/a/clear": 1}).level is api.Level.OK
    result = evaluate(check, services={"/a/plan_path": 0, "/a/clear": 0})
    assert (result.level, result.brief) == (api.Level.ERROR, "planner not ready: no plan_path")
    assert "service /a/plan_path has no server; service /a/clear has no server. Check its log" in result.summary
    assert evaluate(check, services={}, up_s=1.0).level is api.Level.STALE
    unknown = evaluate(check, services={"/a/plan_path": 1, "/a/clear": None})
    assert (unknown.level, unknown.condition) == (api.Level.STALE, "")
    assert "the servers of /a/clear are unknown" in unknown.summary


@pytest.mark.parametrize(
    ("topics", "level", "words"),
    [
        (received(0.2), api.Level.OK, "is ready: /a/plan"),
        (received(4.0), api.Level.ERROR, "topic /a/plan is silent for 4.0 s, expected a message at least every 3.0 s"),
        (received(4.0, not_counted_s=2.0), api.Level.OK, "is ready"),
        (received(4.0, sample_bytes=1e6, hz=2.0), api.Level.OK, "is ready"),
        (received(400.0, durability="transient_local"), api.Level.OK, "is ready"),
        (advertised_elsewhere(400.0), api.Level.OK, "is ready"),
        (advertised_elsewhere(None), api.Level.ERROR, "topic /a/plan was never received"),
        (received(None), api.Level.ERROR, "topic /a/plan was never received"),
        (received(None, problem="type unknown: a/msg/B"), api.Level.STALE, "cannot be received: type unknown"),
        (received(None, problem="QoS mismatch: x"), api.Level.STALE, "cannot be received: QoS mismatch"),
        (received(0.2, problem="ambiguous: 2 publishers"), api.Level.OK, "is ready"),
        ({}, api.Level.ERROR, "topic /a/plan has no publisher"),
    ],
)
def test_topics_need_messages(topics: dict[str, api.TopicFact], level: api.Level, words: str) -> None:
    """A latched topic needs one message, even if another node advertises it, too; time in which PHM did not look does not count."""
    result = evaluate(build(topics=["/a/plan"]), topics=topics)
    assert result.level is level and words in result.summary and not result.evidence.conclusive


def test_the_silence_of_its_topics_is_configurable() -> None:
    """Instead of `ros.silence`."""
    assert evaluate(build(topics=["/a/plan"], silence="10s"), topics=received(9.0)).level is api.Level.OK


@pytest.mark.parametrize(
    ("fact", "level", "words"),
    [
        (api.AnswerFact("true", served=True), api.Level.OK, "is ready: /a/is_ready"),
        (api.AnswerFact("false", "no map", served=True), api.Level.ERROR, "service /a/is_ready answers: no map. "),
        (api.AnswerFact("false", served=True), api.Level.ERROR, "service /a/is_ready answers: not ready. "),
        (api.AnswerFact("true", served=True, unanswered_s=7.0), api.Level.ERROR, "has not answered for 7.0 s"),
        (api.AnswerFact(served=True), api.Level.STALE, "has not answered yet"),
        (api.AnswerFact(), api.Level.ERROR, "service /a/is_ready has no server"),
        (api.AnswerFact(problem="std_srvs is not installed"), api.Level.STALE, "cannot be called: std_srvs"),
    ],
)
def test_a_service_may_say_whether_the_node_is_ready(fact: api.AnswerFact, level: api.Level, words: str) -> None:
    """The application knows best; its text is shown."""
    result = evaluate(build(call="/a/is_ready"), calls={"/a/is_ready": fact})
    assert result.level is level and words in result.summary


def test_an_unknown_requirement_hides_no_other() -> None:
    """A missing service is reported although a topic cannot be read."""
    check = build(topics=["/a/plan"], services=["/a/s"])
    result = evaluate(check, topics=received(None, problem="type unknown: x"))
    assert result.level is api.Level.ERROR and "service /a/s" in result.summary


def test_an_old_snapshot_is_unknown() -> None:
    """PHM's own failure is not the node's."""
    assert evaluate(build(), age_s=9.0).level is api.Level.STALE


def test_a_dead_node_blocks_its_readiness() -> None:
    """One alarm at the cause; the start-up time is the unit's grace."""
    (unit,) = build().units
    assert unit.needs == ("container/ros_app", "network/ros_app", "nodes/a/planner")
    assert (unit.target, unit.grace_s) == ("ros_app", 30.0)


def test_topics_of_a_lifecycle_node_need_its_readiness() -> None:
    """An inactive node publishes nothing: one alarm, of the node."""
    ros = {
        "nodes": [{"name": NODE, "ready": {"lifecycle": "active"}}, {"name": "/a/b", "ready": {"services": ["/a/s"]}}],
        "topics": [{"name": "/a/path", "publishers": [NODE], "subscribers": ["/a/b"]}],
    }
    (check,) = Topics.build(testing.settings(ros=ros))
    assert check.units[0].needs == ("nodes/a/planner", "nodes/a/b", UNIT)
