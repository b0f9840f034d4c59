"""Checks of type `serial`."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.custom import Custom

PATH = "/dev/serial/by-id/gps"


def build(**entry: Any) -> api.Check:
    (check,) = Custom.build(testing.settings(custom=[{"name": "gps", "type": "serial", "device": PATH, **entry}]))
    return check


def evaluate(check: api.Check, fact: api.SerialFact | None = None, device: api.DeviceFact | None = None) -> api.Result:
    devices, serial = testing.FakeDevices(), testing.FakeSerial()
    if device is not None:
        devices.devices[PATH] = device
    if fact is not None:
        serial.ports[PATH] = fact
    result = check.run(testing.world(devices=devices, serial=serial))
    assert isinstance(result, api.Result)
    assert (serial.calls > 0) == (check.entry.max_age is not None)  # type: ignore[attr-defined]
    return result


PORT = api.DeviceFact("/dev/ttyUSB0", True, 188, 0, None, description="u-blox GNSS")
FILE = api.DeviceFact("/dev/ttyUSB0", False, 0, 0, None, reason="an ordinary file")


def test_the_port_exists() -> None:
    """Without `max_age` nothing opens it."""
    assert evaluate(build(), device=PORT).level is api.Level.OK
    assert "does not exist" in evaluate(build(), device=None).summary
    assert "is an ordinary file, expected a character device" in evaluate(build(), device=FILE).summary


@pytest.mark.parametrize(
    ("line", "fact", "level", "words"),
    [
        (None, api.SerialFact(60.0, 0.5), api.Level.OK, "data received 0.5 s ago"),
        (
            None,
            api.SerialFact(60.0, 3.0),
            api.Level.ERROR,
            "no data received for 3.0 s, expected every 2.0 s; check the device",
        ),
        (None, api.SerialFact(2.5), api.Level.ERROR, "no data received for 2.5 s"),
        ("$GP*", api.SerialFact(60.0, 0.5, 1.0), api.Level.OK, "line '$GP*' received 1.0 s ago"),
        ("$GP*", api.SerialFact(60.0, 0.5, 9.0), api.Level.ERROR, "other data arrive: check baud rate and device"),
        ("$GP*", api.SerialFact(60.0, 9.0, 9.0), api.Level.ERROR, "check the device and the baud rate"),
    ],
)
def test_data_must_arrive(line: str | None, fact: api.SerialFact, level: api.Level, words: str) -> None:
    """Any, or a line that matches."""
    check = build(max_age=2.0, **({} if line is None else {"line": line}))
    result = evaluate(check, fact, PORT)
    assert (result.level, words in result.summary) == (level, True), result.summary


@pytest.mark.parametrize(
    ("fact", "words"),
    [
        (api.SerialFact(problem="in use by gpsd (12)"), "is not read: in use by gpsd"),
        (api.SerialFact(1.0), "no data received on /dev/serial/by-id/gps yet"),
    ],
)
def test_a_port_that_phm_may_not_read_is_unknown(fact: api.SerialFact, words: str) -> None:
    """A port of another program is left alone."""
    with pytest.raises(api.CannotTell, match=words):
        evaluate(build(max_age=2.0), fact, PORT)
