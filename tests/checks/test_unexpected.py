"""Slots 2 and 5: containers and devices that are not in the configuration, where the configuration asks for them."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.engine import Engine
from phm_checks.unexpected_devices import UnexpectedDevices
from phm_checks.unknown_containers import UnknownContainers


def containers(*others: tuple[str, str], **wanted: Any) -> api.Result:
    chosen = testing.settings(
        containers=[{"name": "ros_app"}], docker={"unknown_containers": {"level": "warn", **wanted}}
    )
    (check,) = UnknownContainers.build(chosen)
    docker = testing.FakeDocker()
    docker.unknown = [api.OtherContainer(*other) for other in others]
    result = check.run(testing.world(docker=docker))
    assert isinstance(result, api.Result)
    return result


def devices(host: testing.FakeDevices, **wanted: Any) -> api.Result:
    chosen = testing.settings(
        containers=[{"name": "ros_app", "devices": [{"path": "/dev/serial/by-id/pixhawk"}]}],
        mavlink={"endpoints": [{"url": "/dev/ttyUSB0"}]},
        custom=[{"name": "gps", "type": "serial", "device": "/dev/serial/by-id/gps"}],
        host={"unexpected_devices": {"level": "warn", **wanted}},
    )
    (check,) = UnexpectedDevices.build(chosen)
    result = check.run(testing.world(devices=host))
    assert isinstance(result, api.Result)
    return result


def host(*paths: str) -> testing.FakeDevices:
    made = testing.FakeDevices()
    for path in ("/dev/ttyACM0", "/dev/ttyACM1", "/dev/ttyUSB0", *paths):
        made.put(path)
    made.devices["/dev/serial/by-id/gps"] = made.devices["/dev/ttyACM1"]
    made.devices["/dev/serial/by-id/pixhawk"] = made.devices["/dev/ttyACM0"]
    return made


def test_both_are_off_by_default() -> None:
    """Nothing is built, so nothing is asked."""
    chosen = testing.settings(containers=[{"name": "ros_app"}])
    assert not list(UnknownContainers.build(chosen)) and not list(UnexpectedDevices.build(chosen))


def test_no_unknown_container_is_ok() -> None:
    """Ignored names count as known."""
    assert containers().level is api.Level.OK
    assert containers(("proxy", "haproxy"), ("build_1", "x"), ignore=["proxy", "build_*"]).level is api.Level.OK


def test_unknown_containers_are_named() -> None:
    """All in one result, with their images, a limited number of them; PHM does nothing about them."""
    result = containers(("cryptominer", "evil:latest"))
    assert (result.level, result.condition, result.target) == (api.Level.WARN, "container_unknown", "")
    assert result.brief == "cryptominer unexpected"
    assert "cryptominer (evil:latest)" in result.summary and result.values == {"unexpected": 1}
    many = containers(*((f"c{number}", "image") for number in range(9)), level="error")
    assert (many.level, many.brief) == (api.Level.ERROR, "9 containers unexpected")
    assert "c4 (image) and 4 more" in many.summary and "c5" not in many.summary


def test_hostile_names_stay_one_line() -> None:
    """The name of an image is foreign text."""
    result = containers(("x" * 300, "a\nb\u202e\x1b[31m" + "y" * 300))
    assert result.summary.isprintable() and len(result.summary) < 400 and len(result.brief) <= 38


def test_an_engine_that_does_not_answer_is_stale() -> None:
    """Unknown is not OK. The scheduler turns the exception into STALE."""
    (check,) = UnknownContainers.build(testing.settings(docker={"unknown_containers": {"level": "warn"}}))
    docker = testing.FakeDocker()
    docker.fail("no answer")
    with pytest.raises(api.CannotTell):
        check.run(testing.world(docker=docker))


def test_an_engine_that_is_down_is_an_alarm_without_configured_containers() -> None:
    """The check needs the engine, so something must report its loss."""
    wanted = testing.settings(docker={"unknown_containers": {"level": "warn"}})
    (engine,) = Engine.build(wanted)
    docker = testing.FakeDocker()
    docker.fail("no answer")
    result = engine.run(testing.world(docker=docker))
    assert isinstance(result, api.Result)
    assert (result.level, result.condition) == (api.Level.ERROR, "engine_down")
    assert not list(Engine.build(testing.settings()))


def test_configured_devices_are_expected() -> None:
    """Those of containers, also behind a link, and the serial ports of MAVLink and of custom checks."""
    assert devices(host()).level is api.Level.OK


def test_an_unexpected_device_is_named() -> None:
    """Of those in `watch`, unless it is in `ignore`; it is never opened."""
    made = host("/dev/video4", "/dev/ttyUSB1", "/dev/null")
    result = devices(made, ignore=["/dev/video?"])
    assert (result.level, result.condition, result.brief) == (
        api.Level.WARN,
        "device_unexpected",
        "/dev/ttyUSB1 unexpected",
    )
    assert "video4" not in result.summary and not made.opened
    assert devices(made, watch=["/dev/video*"]).brief == "/dev/video4 unexpected"


def test_an_ignored_device_may_be_named_by_its_link() -> None:
    """As in `watch`: the link is followed, and the device appears with its real path."""
    made = host("/dev/ttyUSB1", "/dev/ttyUSB2")
    made.devices["/dev/serial/by-id/usb-FTDI_1"] = made.devices["/dev/ttyUSB1"]
    result = devices(made, ignore=["/dev/video*", "/dev/serial/by-id/usb-FTDI*"])
    assert result.brief == "/dev/ttyUSB2 unexpected"


def test_devices_that_are_ignored_do_not_hide_another() -> None:
    """However many there are, and whatever its name is."""
    result = devices(
        host(*(f"/dev/video{number}" for number in range(150)), "/dev/videos"), ignore=["/dev/video*[0-9]"]
    )
    assert result.brief == "/dev/videos unexpected"


def test_more_unexpected_devices_than_phm_looks_for_are_not_counted() -> None:
    """The text says that there may be more."""
    result = devices(host(*(f"/dev/video{number}" for number in range(150))))
    assert result.brief == "100+ devices unexpected" and "and 95 more at least" in result.summary


def test_the_checks_are_woken_by_events_of_unconfigured_things() -> None:
    """Their period is only for events that were lost."""
    chosen = testing.settings(
        docker={"unknown_containers": {"level": "warn"}}, host={"unexpected_devices": {"level": "warn"}}
    )
    (first,), (second,) = UnknownContainers.build(chosen), UnexpectedDevices.build(chosen)
    assert first.wakes == {"engine", "other_container"} and second.wakes == {"other_device"}
    assert [unit.needs for check in (first, second) for unit in check.units] == [("engine",), ()]
