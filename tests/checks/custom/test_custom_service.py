"""Checks of the types `service` and `lifecycle`."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.custom import Custom

SERVICE, NODE = "/agent_1/is_ready", "/agent_1/planner"
CALL = "std_srvs/srv/Trigger"


def build(**entry: Any) -> api.Check:
    nodes = [{"name": NODE, "container": "app"}]
    (check,) = Custom.build(
        testing.settings(
            containers=[{"name": "app"}, {"name": "other"}], ros={"nodes": nodes}, custom=[{"name": "it", **entry}]
        )
    )
    return check


def service(**entry: Any) -> api.Check:
    return build(type="service", service=SERVICE, **entry)


def lifecycle(**entry: Any) -> api.Check:
    return build(type="lifecycle", node="agent_1/planner", **entry)


def evaluate(check: api.Check, up_s: float = 60.0, **fact: Any) -> api.Result:
    result = check.run(testing.world(ros=testing.FakeRos(up_s=up_s, **fact)))
    assert isinstance(result, api.Result)
    return result


def test_a_service_needs_a_server() -> None:
    """By default it is not called."""
    assert evaluate(service(), services={SERVICE: 1}).level is api.Level.OK
    gone = evaluate(service(), services={SERVICE: 0})
    assert (gone.level, gone.brief) == (api.Level.ERROR, "it no is_ready")
    with pytest.raises(api.CannotTell, match="has no server yet"):
        evaluate(service(), up_s=1.0)
    with pytest.raises(api.CannotTell, match=r"servers of .* are unknown"):
        evaluate(service(), services={SERVICE: None})


@pytest.mark.parametrize(
    ("fact", "words"),
    [
        (api.AnswerFact("true", "12 satellites", served=True), "answers: 12 satellites"),
        (api.AnswerFact("false", "no \x1bfix", served=True), "answers success: false (no fix)"),
        (api.AnswerFact("true", served=True, unanswered_s=3.0), "has not answered for 3.0 s, expected within 3.0 s"),
        (api.AnswerFact(), "has no server"),
    ],
)
def test_the_answer_of_a_call_counts(fact: api.AnswerFact, words: str) -> None:
    """It must come within `timeout`, and report success."""
    result = evaluate(service(call=CALL, timeout=3.0), calls={SERVICE: fact})
    assert words in result.summary
    assert result.level is (api.Level.OK if "12" in words else api.Level.ERROR)


@pytest.mark.parametrize(
    ("fact", "words"),
    [
        (api.AnswerFact(served=True, unanswered_s=1.0), "has not answered yet"),
        (api.AnswerFact(problem="std_srvs is not installed beside PHM"), "cannot be called: std_srvs is not installed"),
    ],
)
def test_an_answer_that_phm_does_not_have_is_not_known(fact: api.AnswerFact, words: str) -> None:
    """CannotTell with the reason, not an ERROR."""
    with pytest.raises(api.CannotTell, match=words):
        evaluate(service(call=CALL), calls={SERVICE: fact})


@pytest.mark.parametrize(
    ("fact", "words"),
    [
        (api.AnswerFact("active", served=True), "/agent_1/planner is active"),
        (api.AnswerFact("inactive", served=True), "its lifecycle state is inactive, expected active"),
        (api.AnswerFact("active", served=True, unanswered_s=9.0), "has not answered for 9.0 s"),
        (api.AnswerFact(), "it has no service /agent_1/planner/get_state"),
    ],
)
def test_a_lifecycle_node_is_in_its_state(fact: api.AnswerFact, words: str) -> None:
    """By the rules of `ready.lifecycle`."""
    result = evaluate(lifecycle(), lifecycle={NODE: fact})
    assert words in result.summary
    assert result.level is (api.Level.OK if "planner is active" in words else api.Level.ERROR)


@pytest.mark.parametrize("container", ["app", "other"])
def test_recovery_restarts_nothing_for_a_lifecycle_node_that_only_does_not_answer(container: str) -> None:
    """It may be busy, as with `ready.lifecycle`; a wrong state was observed."""
    check = lifecycle(recovery={"container": container})
    busy = evaluate(check, lifecycle={NODE: api.AnswerFact("active", served=True, unanswered_s=9.0)})
    assert (busy.level, busy.condition, busy.target) == (api.Level.ERROR, "custom_failed", "")
    assert busy.summary.endswith("PHM restarts nothing for this: it may be busy")
    wrong = evaluate(check, lifecycle={NODE: api.AnswerFact("inactive", served=True)})
    assert (wrong.level, wrong.target) == (api.Level.ERROR, container)
    assert "busy" not in wrong.summary
    alone = evaluate(lifecycle(), lifecycle={NODE: api.AnswerFact("active", served=True, unanswered_s=9.0)})
    assert "busy" not in alone.summary


def test_another_state_may_be_expected_and_an_unknown_one_is_not_a_fault() -> None:
    """`finalized` is one; a package that is missing beside PHM is its problem, not the node's."""
    found = api.AnswerFact("finalized", served=True)
    assert evaluate(lifecycle(state="finalized"), lifecycle={NODE: found}).level is api.Level.OK
    with pytest.raises(api.CannotTell, match="lifecycle_msgs is not installed"):
        evaluate(lifecycle(), lifecycle={NODE: api.AnswerFact(problem="lifecycle_msgs is not installed beside PHM")})


def test_a_dead_node_is_one_fault() -> None:
    """The check of its state needs its node and its container."""
    (unit,) = lifecycle().units
    assert unit.needs == ("container/app", "nodes/agent_1/planner")
    (unit,) = service(container="other").units
    assert unit.needs == ("container/other",)
