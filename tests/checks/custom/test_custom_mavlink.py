"""Checks of type `mavlink`."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest

from phm import api, testing
from phm_checks.custom import Custom

MESSAGE, FIELD = "BATTERY_STATUS", "battery_remaining"
LINK = {"url": "/dev/ttyAMA0", "name": "fc"}


def build(**entry: Any) -> api.Check:
    entry = {
        "name": "battery",
        "type": "mavlink",
        "message": MESSAGE,
        "field": FIELD,
        "min": 20,
        "warn_min": 30,
        **entry,
    }
    (check,) = Custom.build(testing.settings(mavlink={"endpoints": [LINK]}, custom=[entry]))
    return check


def evaluate(
    check: api.Check, *values: api.MessageValue, autopilot: bool = True, watched_s: float = 60.0, is_open: bool = True
) -> api.Result:
    """The result after the first run was `watched_s` ago."""
    messages = testing.FakeMessages()
    messages.fields[MESSAGE, FIELD] = values
    pilot = api.AutopilotFact(0.5, False) if autopilot else None
    links = testing.FakeLinks(autopilot=pilot, links=(api.LinkFact("fc", is_open),))
    clock = testing.FakeClock()
    world = testing.world(clock=clock, messages=messages, links=links)
    with contextlib.suppress(api.CannotTell):
        check.run(world)
    clock.advance(watched_s)
    result = check.run(world)
    assert isinstance(result, api.Result)
    return result


def value(number: float, age_s: float = 0.5, **more: Any) -> api.MessageValue:
    return api.MessageValue(age_s, number, unit="%", **more)


@pytest.mark.parametrize(
    ("number", "level", "words"),
    [
        (80, api.Level.OK, "battery_remaining of BATTERY_STATUS is 80 %"),
        (29, api.Level.WARN, "is 29 %, allowed is 30 or more"),
        (19, api.Level.ERROR, "is 19 %, allowed is 20 or more"),
    ],
)
def test_a_value_is_compared_with_its_limits(number: float, level: api.Level, words: str) -> None:
    """In the unit of the message."""
    result = evaluate(build(), value(number))
    assert (result.level, words in result.summary) == (level, True), result.summary


def test_the_worst_instance_counts() -> None:
    """One of two batteries is low; the text names it."""
    result = evaluate(build(), value(90, instance=0), value(10, instance=1), value(25, instance=2))
    assert result.level is api.Level.ERROR and "BATTERY_STATUS 1 is 10 %" in result.summary
    assert evaluate(build(instance=0), value(90, instance=0), value(10, instance=1)).level is api.Level.OK


def test_a_value_that_the_sender_does_not_know_is_not_known() -> None:
    """-1 percent does not mean an empty battery. Another battery that is low is reported all the same."""
    unknown = api.MessageValue(0.5, None, "-1", unknown=True, instance=1)
    with pytest.raises(api.CannotTell, match="reports -1, which means that it does not know the value"):
        evaluate(build(), unknown)
    with pytest.raises(api.CannotTell):
        evaluate(build(), value(90, instance=0), unknown)
    assert evaluate(build(), value(10, instance=0), unknown).level is api.Level.ERROR


def test_a_message_that_stops_is_a_failure() -> None:
    """Time in which PHM did not read does not count."""
    late = evaluate(build(max_age=5), value(80, 5.1))
    assert (late.level, late.brief) == (api.Level.ERROR, "battery not received")
    assert evaluate(build(max_age=5), value(80, 9.0, not_counted_s=5.0)).level is api.Level.OK


def test_a_message_that_never_came_is_a_failure_with_a_remedy() -> None:
    """Once there was time for it, also after a reload of the configuration: the newest message of before is not known."""
    assert "let the autopilot send it, or request it with 'request'" in evaluate(build()).summary
    assert "request it" not in evaluate(build(request=1.0)).summary
    with pytest.raises(api.CannotTell, match="no BATTERY_STATUS received yet"):
        evaluate(build(), watched_s=5.0)


def test_without_autopilot_or_link_it_is_not_known() -> None:
    """Their own checks report that; this one needs them."""
    with pytest.raises(api.CannotTell, match="no autopilot has been received"):
        evaluate(build(), autopilot=False)
    with pytest.raises(api.CannotTell, match="every link to the autopilot is closed"):
        evaluate(build(), value(80), is_open=False)
    (unit,) = build().units
    assert unit.needs == ("link/fc", "autopilot")
