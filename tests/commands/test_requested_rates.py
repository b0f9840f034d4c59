"""The rates of topics on request, as NAMED_VALUE_FLOAT."""

from __future__ import annotations

from phm.commands import responses
from phm.core.model import Layer, Level, Result, Slot, Stamp, UnitState
from phm.wire.command import CommandResult
from tests.commands.test_mavlink_commands import Scene, long


def rate(topic: str, hz: float | None) -> UnitState:
    found = Result(Level.OK, "as expected", rate_hz=hz)
    return UnitState(f"rates/{topic}", "rates", Slot.RATES, Layer.ROS, Level.OK, found, Stamp(0, 0))


def test_the_rates_of_topics_are_named_values() -> None:
    """One message for each topic whose rate is known, 0 for a silent one, in the order of the configuration."""
    scene = Scene("status")
    scene.states += [rate("agent_7/scan", 9.98), rate("agent_7/odom", None), rate("agent_7/image", 0.0)]
    *values, ack = scene.ask(long(512, 251))
    assert [(value.name, round(value.value, 2)) for value in values] == [("scan", 9.98), ("image", 0.0)]
    assert ack.result == CommandResult.ACCEPTED
    assert len({value.time_boot_ms for value in values}) == 1


def test_a_request_for_rates_fails_while_none_is_measured() -> None:
    """It must not be accepted in silence."""
    scene = Scene("status")
    assert scene.result(long(512, 251)) is CommandResult.FAILED


def test_rates_are_repeated_and_stopped() -> None:
    """As the other messages, and no more than MOST_RATES in each turn."""
    scene = Scene("status")
    scene.states += [rate(f"t/topic_{number}", 1.0) for number in range(40)]
    assert scene.result(long(511, 251, 5e6)) is CommandResult.ACCEPTED
    scene.sent.clear()
    scene.clock.advance(5.0)
    scene.handler.tick()
    assert len(scene.sent) == responses.MOST_RATES
    assert scene.result(long(511, 251, -1)) is CommandResult.ACCEPTED
    scene.sent.clear()
    scene.clock.advance(10.0)
    scene.handler.tick()
    assert scene.sent == []


def test_names_of_values_fit_are_printable_and_differ() -> None:
    """Ten ASCII characters; a ground station keeps one value for each name."""
    units = [
        "rates/a/front_camera_image",
        "rates/b/front_camera_image",
        "rates/scan",
        "rates/b/scan",
        "rates/h\u00f6he\n",
    ]
    assert responses.short_names(units) == ["fron..mage", "fron..ma~2", "scan", "scan~2", "h?he?"]
    many = responses.short_names([f"rates/{number}/same" for number in range(120)])
    assert len(set(many)) == 120 and max(map(len, many)) <= responses.NAME_BYTES
