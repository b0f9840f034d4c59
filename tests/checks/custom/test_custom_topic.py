"""Checks of type `topic`."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.custom import Custom

NAME, FIELD = "/agent_1/battery", "percentage"
BATTERY = "sensor_msgs/msg/BatteryState"
PUBLISHER = api.EndpointFact("/agent_1/driver", BATTERY)


def build(**entry: Any) -> api.Check:
    entry = {"name": "battery", "type": "topic", "topic": NAME, "field": FIELD, **entry}
    if not entry["field"]:
        del entry["field"]
    (check,) = Custom.build(testing.settings(containers=[{"name": "app"}], custom=[entry]))
    return check


def evaluate(
    check: api.Check, *fields: api.FieldFact, silent_s: float | None = 0.2, problem: str = "", up_s: float = 60.0
) -> api.Result:
    rate = api.RateFact(0.0, silent_s, problem=problem)
    topic = api.TopicFact((PUBLISHER,), (), rate, api.DataFact(samples=9, fields=fields))
    ros = testing.FakeRos(up_s=up_s, topics={NAME: topic}, listened_s=up_s)
    return run(check, ros)


def run(check: api.Check, ros: testing.FakeRos) -> api.Result:
    result = check.run(testing.world(ros=ros))
    assert isinstance(result, api.Result)
    return result


def value(low: float, high: float | None = None, **more: Any) -> api.FieldFact:
    return api.FieldFact(FIELD, low, low if high is None else high, **more)


LIMITS = {"min": 0.2, "warn_min": 0.3, "max": 1.0}


@pytest.mark.parametrize(
    ("fact", "level", "words"),
    [
        (value(0.5), api.Level.OK, "percentage of /agent_1/battery is 0.5"),
        (value(0.2), api.Level.WARN, "is 0.2, allowed is 0.3 or more"),
        (value(0.19), api.Level.ERROR, "is 0.19, allowed is 0.2 to 1"),
        (value(0.5, 1.5), api.Level.ERROR, "is 1.5, allowed is 0.2 to 1"),
        (value(0.5, nan=True), api.Level.ERROR, "is NaN, expected a number"),
        (api.FieldFact(FIELD, text="full"), None, "has no number to compare"),
        (api.FieldFact(FIELD), None, "has no number to compare"),
    ],
)
def test_a_value_is_compared_with_its_limits(fact: api.FieldFact, level: api.Level | None, words: str) -> None:
    """The limits belong to what is allowed; each element of an array counts; what has no number is not known."""
    check = build(**LIMITS)
    if level is None:
        with pytest.raises(api.CannotTell, match=words):
            evaluate(check, fact)
        return
    result = evaluate(check, fact)
    assert (result.level, words in result.summary) == (level, True), result.summary


@pytest.mark.parametrize(
    ("wanted", "fact", "level"),
    [
        (True, value(1.0), api.Level.OK),
        (True, value(0.0), api.Level.ERROR),
        (3, value(3.0), api.Level.OK),
        (3, value(3.0, 4.0), api.Level.ERROR),
        ("charging", api.FieldFact(FIELD, text="charging"), api.Level.OK),
        ("charging", api.FieldFact(FIELD, text="charging "), api.Level.ERROR),
    ],
)
def test_a_value_that_must_equal(wanted: object, fact: api.FieldFact, level: api.Level) -> None:
    """Numbers, true and false, and text."""
    assert evaluate(build(equals=wanted), fact).level is level


def test_a_level_of_warn_is_never_an_error() -> None:
    """The frame's level limits that of the limits."""
    assert evaluate(build(min=0.2, level="warn"), value(0.1)).level is api.Level.WARN


def test_silence_and_absence_are_failures() -> None:
    """After `max_age`, without a publisher, and of a publisher that never sends; not while discovery has just begun."""
    check = build(min=0.0, max_age=2.0)
    assert evaluate(check, value(1.0), silent_s=1.9).level is api.Level.OK
    late = evaluate(check, value(1.0), silent_s=2.1)
    assert (late.level, late.brief) == (api.Level.ERROR, "battery silent")
    assert "never" not in late.summary and "has a publisher, but no message" in evaluate(check, silent_s=None).summary
    nothing = testing.FakeRos()
    assert "has no publisher" in run(check, nothing).summary
    with pytest.raises(api.CannotTell, match="no message of /agent_1/battery received yet"):
        run(check, testing.FakeRos(up_s=1.0))


def test_only_the_arrival_counts_without_a_field() -> None:
    """A custom topic check without `field` judges the age of the newest message alone."""
    assert evaluate(build(field="", max_age=2.0), silent_s=1.0).level is api.Level.OK


def test_another_type_is_a_failure() -> None:
    """With `message`; its name comes from outside."""
    result = evaluate(build(min=0.0, message="std_msgs/msg/Float64"), value(1.0))
    assert (result.level, "is published as sensor_msgs/msg/BatteryState" in result.summary) == (api.Level.ERROR, True)


def test_a_type_that_phm_cannot_read_is_not_known_and_has_a_remedy() -> None:
    """A missing package is not a fault of the vehicle."""
    unread = api.FieldFact(
        FIELD, problem="type unknown: its fields cannot be read: a_msgs/msg/X is not installed beside PHM"
    )
    with pytest.raises(api.CannotTell) as caught:
        evaluate(build(min=0.0), unread)
    assert "a_msgs/msg/X is not installed" in str(caught.value) and "ros.installs" in str(caught.value)


def test_messages_that_cannot_be_received_or_decoded_are_not_known() -> None:
    """Each with its reason."""
    check = build(min=0.0)
    with pytest.raises(api.CannotTell, match="cannot be received: QoS mismatch"):
        evaluate(check, value(1.0), problem="QoS mismatch: another partition")
    topic = api.TopicFact((PUBLISHER,), (), api.RateFact(0.0, 0.1), api.DataFact(samples=1, problem="too \x1blarge"))
    with pytest.raises(api.CannotTell, match="is not known: too large"):
        run(check, testing.FakeRos(topics={NAME: topic}))
    with pytest.raises(api.CannotTell, match="too old to evaluate"):
        run(check, testing.FakeRos(age_s=9.0, topics={NAME: topic}))


def test_a_value_depends_on_its_topic_and_the_container_of_its_publisher() -> None:
    """The only one by default; units that are not configured do not count. It has the grace of ROS; a change of the graph wakes it."""
    check = build(min=0.0, grace=1)
    (unit,) = check.units
    assert (unit.needs, unit.target, unit.grace_s) == (("container/app", "topics/agent_1/battery"), "app", 8.0)
    assert check.wakes == {"ros", "container:app"}
