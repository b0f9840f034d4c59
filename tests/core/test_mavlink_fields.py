"""Messages and fields of MAVLink, read without executing pymavlink."""

from __future__ import annotations

import pytest

from phm.core import mavlink_fields
from phm.core.mavlink_fields import UnknownMavlinkField, demand_field
from phm.transport.dialect import mavlink, message_class


@pytest.mark.parametrize(
    ("message", "field", "instance"),
    [
        ("BATTERY_STATUS", "battery_remaining", True),
        ("BATTERY_STATUS", "voltages[9]", True),
        ("EKF_STATUS_REPORT", "velocity_variance", False),
        ("ESTIMATOR_STATUS", "vel_ratio", False),
        ("GPS_RAW_INT", "satellites_visible", False),
        ("SYS_STATUS", "voltage_battery", False),
    ],
)
def test_known_fields_pass(message: str, field: str, instance: bool) -> None:
    """Of MAVLink's common dialect, and of ArduPilot's; the transport has the same message."""
    demand_field(message, field, number=True, instance=instance)
    found = message_class(message)
    assert found is not None and found.msgname == message and mavlink.mavlink_map[found.id] is found


@pytest.mark.parametrize(
    ("message", "field", "number", "words"),
    [
        ("BATERY_STATUS", "id", True, "unknown message BATERY_STATUS; similar: BATTERY_STATUS"),
        ("QQQ", "id", True, "unknown message QQQ"),
        ("BATTERY_STATUS", "remaining", True, "BATTERY_STATUS has no field remaining; similar: time_remaining, battery_remaining"),
        ("VIBRATION", "qqq", True, "VIBRATION has no field qqq: it has time_usec, vibration_x, vibration_y"),
        ("BATTERY_STATUS", "voltages", True, "voltages of BATTERY_STATUS is an array: name one element, voltages[0] to voltages[9]"),
        ("BATTERY_STATUS", "voltages[10]", True, "has 10 elements: the highest index is 9"),
        ("BATTERY_STATUS", "id[0]", True, "id of BATTERY_STATUS is not an array: remove the index"),
        ("STATUSTEXT", "text", True, "text of STATUSTEXT is a text"),
        ("STATUSTEXT", "severity", False, "severity of STATUSTEXT is a number"),
    ],
)  # fmt: skip
def test_a_mistake_names_what_is_similar(message: str, field: str, number: bool, words: str) -> None:
    """The error suggests names that are similar."""
    with pytest.raises(UnknownMavlinkField) as caught:
        demand_field(message, field, number=number)
    assert words in str(caught.value)


def test_an_instance_needs_a_field_for_it() -> None:
    """`instance` is refused for a message that does not number its sources."""
    with pytest.raises(UnknownMavlinkField, match="GPS_RAW_INT has no field that numbers its sources"):
        demand_field("GPS_RAW_INT", "eph", number=True, instance=True)


def test_without_pymavlink_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Then the transport says so."""
    monkeypatch.setattr(mavlink_fields, "MODULES", ("absent.py",))
    mavlink_fields._messages.cache_clear()
    demand_field("ANY", "thing", number=True)
    mavlink_fields._messages.cache_clear()


def test_the_text_has_the_messages_of_the_classes() -> None:
    """Names, and the lengths of arrays, which pymavlink lists in another order than names and types."""
    texts = mavlink_fields._messages()
    for kind in mavlink.mavlink_map.values():
        if kind.msgname in texts:
            lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
            expected = {
                name: (form, lengths[name]) for name, form in zip(kind.fieldnames, kind.fieldtypes, strict=True)
            }
            assert mavlink_fields._fields(texts[kind.msgname]) == expected


def test_a_message_that_does_not_exist_has_no_class() -> None:
    """None, not an exception."""
    assert message_class("NO_SUCH_MESSAGE") is None
