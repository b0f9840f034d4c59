"""Slot 5: rules of the devices check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.devices import SETTLE_S, Devices

PATH = "/dev/ttyACM0"
MAPPED = (api.DeviceMapping(PATH, PATH),)


def build(**wanted: Any) -> api.Check:
    (check,) = Devices.build(testing.settings(containers=[{"name": "ros_app", "devices": [{"path": PATH, **wanted}]}]))
    return check


def there(**fields: Any) -> testing.FakeDevices:
    devices = testing.FakeDevices()
    devices.put(PATH, **{"major": 166, **fields})
    return devices


def evaluate(check: api.Check, host: testing.FakeDevices, **container: Any) -> api.Result:
    container.setdefault("devices", MAPPED)
    docker = testing.FakeDocker(testing.container("ros_app", **container))
    result = check.run(testing.world(devices=host, docker=docker))
    assert isinstance(result, api.Result)
    return result


def test_a_mapped_device_is_ok() -> None:
    """It exists, is accessible and is mapped."""
    result = evaluate(build(), there(description="PX4 FMU"))
    assert result.level is api.Level.OK
    assert result.summary.startswith(f"Found 1 device in container ros_app: {PATH} ")
    assert "PX4 FMU" in result.summary


def test_a_missing_device_is_an_error_that_lists_the_existing_ports() -> None:
    """The message shows a flight controller that reappeared under another name."""
    devices = testing.FakeDevices()
    devices.ports = (api.DeviceFact("/dev/ttyACM1", True, 166, 1, None, description="PX4 FMU"),)
    result = evaluate(build(), devices)
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "device_missing", "ttyACM0 missing")
    assert "/dev/ttyACM1 (PX4 FMU)" in result.summary


def test_each_further_missing_device_changes_the_brief() -> None:
    """PHM reports a changed brief to the ground: also when one of them is back, or something else is wrong with it."""
    paths = (PATH, "/dev/ttyACM1", "/dev/video0", "/dev/video1")
    entry = {"name": "ros_app", "devices": [{"path": path, "mapped": False} for path in paths]}
    (check,) = Devices.build(testing.settings(containers=[entry]))

    def brief(*missing: str, refused: bool = False) -> str:
        devices = testing.FakeDevices()
        for path in set(paths).difference(missing):
            devices.put(path, major=166, openable=not refused)
        return evaluate(check, devices).brief

    assert [brief(*paths[:missing]) for missing in (1, 2, 1, 4)] == [
        "ttyACM0 missing",
        "ttyACM0 ttyACM1 missing",
        "ttyACM0 missing",
        "ttyACM0 missing (+3)",
    ]
    assert brief(*paths[:3], refused=True) == "ttyACM0 missing (+3)"


def test_a_missing_device_is_reported_even_without_its_container() -> None:
    """Docker does not start a container whose device is missing, so the device is the cause."""
    check = build()
    result = check.run(testing.world())
    assert isinstance(result, api.Result)
    assert result.condition == "device_missing"
    assert check.units == (api.Unit("devices/ros_app", target="ros_app", settle_s=SETTLE_S),)


def test_a_directory_in_place_of_a_device_is_the_wrong_type() -> None:
    """Docker creates a directory if the source of a bind mount is missing."""
    result = evaluate(build(), there(character=False, openable=None, reason="a directory"))
    assert result.condition == "device_wrong_type"
    assert "a directory" in result.summary


def test_a_device_that_cannot_be_opened_is_an_error() -> None:
    """The device file may outlive its device."""
    assert evaluate(build(), there(openable=False, reason="input/output error")).condition == "device_refused"


def test_missing_permissions_of_phm_are_not_a_fault() -> None:
    """They say nothing about the permissions of the application."""
    assert evaluate(build(), there(openable=None, reason="PHM itself may not open it")).level is api.Level.OK


@pytest.mark.parametrize(
    ("opening", "path", "major", "opened"),
    [
        ("auto", PATH, 166, False),
        ("auto", "/dev/radio", 188, False),
        ("auto", "/dev/ttyTHS1", 238, False),
        ("auto", "/dev/ttymxc2", 207, False),
        ("auto", "/dev/rfcomm0", 216, False),
        ("auto", "/dev/tty1", 4, True),
        ("auto", "/dev/gpiochip0", 254, True),
        ("always", PATH, 166, True),
        ("never", "/dev/gpiochip0", 254, False),
    ],
)
def test_serial_ports_are_opened_only_on_request(opening: str, path: str, major: int, opened: bool) -> None:
    """Opening a port raises DTR, which resets some autopilots and radios. The numbers of many ports depend on the board."""
    devices = testing.FakeDevices()
    devices.put(path, major=major, minor=1)
    evaluate(build(path=path, open=opening), devices, devices=(api.DeviceMapping(path, path),))
    assert bool(devices.opened) is opened


@pytest.mark.parametrize(
    "container",
    [
        {"devices": (api.DeviceMapping("/dev/serial/by-id/usb-PX4", "/dev/fmu"),)},
        {"devices": (api.DeviceMapping("/dev", "/dev"),)},
        {"devices": (), "privileged": True},
        {"devices": (), "mounts": (api.Mount("bind", "/dev", "/dev"),), "device_rules": ("c 166:* rmw",)},
        {"devices": (), "mounts": (api.Mount("bind", "/dev", "/dev"),), "device_rules": ("a *:* rwm",)},
    ],
)
def test_each_way_to_map_a_device_counts(container: dict[str, Any]) -> None:
    """By device, symlink, directory, privileged mode, or a bind mount with a cgroup rule."""
    devices = there()
    devices.put("/dev/serial/by-id/usb-PX4", major=166)
    assert evaluate(build(), devices, **container).level is api.Level.OK


@pytest.mark.parametrize(
    ("container", "words"),
    [
        ({"devices": ()}, "not among its devices"),
        ({"devices": (api.DeviceMapping("/dev/ttyACM1", PATH),)}, "not among its devices"),
        ({"devices": (), "mounts": (api.Mount("bind", "/dev", "/dev"),)}, "no device cgroup rule"),
        (
            {"devices": (), "mounts": (api.Mount("bind", "/dev", "/dev"),), "device_rules": ("c 188:* rmw",)},
            "device_cgroup_rules: ['c 166:* rmw']",
        ),
        (
            {"devices": (), "mounts": (api.Mount("bind", "/dev", "/dev"),), "device_rules": ("c 166:* m",)},
            "no device cgroup rule",
        ),
        ({"devices": (), "device_rules": ("c 166:* rmw",)}, "bind-mount /dev"),
        (
            {"devices": (), "mounts": (api.Mount("bind", "/dev", "/host/dev"),), "device_rules": ("c 166:* rmw",)},
            f"it appears there as /host{PATH}, expected {PATH}",
        ),
        (
            {"devices": (), "mounts": (api.Mount("bind", PATH, "/dev/fmu"),), "device_rules": ("c 166:* rmw",)},
            f"it appears there as /dev/fmu, expected {PATH}",
        ),
        (
            {"devices": (), "mounts": (api.Mount("bind", "/dev", "/host/dev"),)},
            f"expected {PATH}; change the mount or `in_container`, and add device_cgroup_rules: ['c 166:* rmw']",
        ),
    ],
)
def test_a_device_that_the_container_cannot_use_is_unmapped(container: dict[str, Any], words: str) -> None:
    """The text names the missing part in Compose terms."""
    result = evaluate(build(), there(), **container)
    assert result.condition == "device_unmapped"
    assert words in result.summary


def test_the_device_name_inside_the_container_must_be_the_configured_one() -> None:
    """An application that opens /dev/fmu does not find /dev/ttyACM0."""
    assert evaluate(build(in_container="/dev/fmu"), there()).condition == "device_unmapped"
    mapped = (api.DeviceMapping(PATH, "/dev/fmu"),)
    assert evaluate(build(in_container="/dev/fmu"), there(), devices=mapped).level is api.Level.OK
    mounted: dict[str, Any] = {"devices": (), "device_rules": ("c 166:* rmw",)}
    linked = there()
    linked.put("/dev/fmu", major=166)
    for host, mount, condition in (
        (there(), api.Mount("bind", PATH, "/dev/fmu"), ""),
        (there(), api.Mount("bind", "/dev", "/dev"), "device_unmapped"),
        (linked, api.Mount("bind", "/dev", "/dev"), ""),
    ):
        result = evaluate(build(in_container="/dev/fmu"), host, mounts=(mount,), **mounted)
        assert result.condition == condition


@pytest.mark.parametrize(
    ("gone", "container"),
    [
        (False, {}),
        (True, {}),
        (True, {"mounts": (api.Mount("bind", "/", "/host"),)}),
        (True, {"mounts": (api.Mount("bind", "/dev", "/host/dev"),)}),
        (
            True,
            {
                "mounts": (api.Mount("bind", "/dev", "/dev"),),
                "devices": (api.DeviceMapping(PATH, "/run/fmu"),),
            },
        ),
    ],
)
def test_a_device_that_is_back_with_other_numbers_is_lost_for_the_container(
    gone: bool, container: dict[str, Any]
) -> None:
    """Docker copies device files when it starts a container: one with other numbers exists on the host only, until a restart.
    A bind mount that shows it at another path does not help a program that uses the copy."""
    check, devices = build(), there()
    assert evaluate(check, devices, **container).level is api.Level.OK
    if gone:
        del devices.devices[PATH]
        assert evaluate(check, devices, **container).condition == "device_missing"
    devices.put(PATH, major=166, minor=1)
    result = evaluate(check, devices, **container)
    assert (result.condition, result.target) == ("device_replugged", "ros_app")
    assert "restart ros_app" in result.summary
    assert evaluate(check, devices, **container, started_at="later").level is api.Level.OK
    devices.put(PATH, major=166)
    assert evaluate(check, devices, **container, started_at="later").condition == "device_replugged"


@pytest.mark.parametrize("gone", [True, False])
@pytest.mark.parametrize("wrong", [{}, {"minor": 1}, {"character": False}])
def test_a_device_that_is_back_with_the_same_numbers_works_in_the_container(gone: bool, wrong: dict[str, Any]) -> None:
    """A device file is its numbers, and those of the container's copy and cgroup rule are the same. A program that has not opened
    it again has an error, though, which its topics show: PHM does not restart it for that."""
    check, devices = build(), there(inode=7)
    assert "disconnected" not in evaluate(check, devices).summary
    if gone:
        del devices.devices[PATH]
        evaluate(check, devices)
    if wrong:
        devices.put(PATH, **{"major": 166, **wrong})
        assert evaluate(check, devices).level is api.Level.ERROR
    devices.put(PATH, major=166, inode=8)
    for _ in range(2):
        result = evaluate(check, devices)
        assert result.level is api.Level.OK
        assert "a program that has not reopened it needs a restart" in result.summary
    assert "disconnected" not in evaluate(check, devices, started_at="later").summary


def test_a_device_that_was_missing_when_first_observed_is_lost_for_the_container() -> None:
    """The container cannot have been started with the numbers that the device has now, as far as PHM knows."""
    check, devices = build(), testing.FakeDevices()
    assert evaluate(check, devices).condition == "device_missing"
    devices.put(PATH, major=166)
    assert evaluate(check, devices).condition == "device_replugged"


@pytest.mark.parametrize(
    "container",
    [
        {"mounts": (api.Mount("bind", "/dev", "/dev"),), "device_rules": ("c 166:* rmw",), "devices": ()},
        {"mounts": (api.Mount("bind", "/dev", "/dev"),), "privileged": True},
        {"status": "exited"},
    ],
)
def test_a_replugged_device_is_available_where_dev_is_bind_mounted(container: dict[str, Any]) -> None:
    """A bind mount of /dev shows the current devices, and a stopped container gets new device files when it starts."""
    check, devices = build(), there()
    assert evaluate(check, devices, **container).level is api.Level.OK
    del devices.devices[PATH]
    evaluate(check, devices, **container)
    devices.put(PATH, major=166, minor=1)
    assert evaluate(check, devices, **container).level is api.Level.OK


def test_after_a_restart_of_phm_a_replugged_device_may_still_be_lost() -> None:
    """Only a new run of the container, or its view of the host's /dev, shows that it is not."""
    check, devices = build(), there()
    evaluate(check, devices)
    devices.put(PATH, major=166, minor=1)
    lost = evaluate(check, devices).evidence.subjects
    assert lost == (f"{PATH} in the run since 2026-01-01T00:00:00.000000001Z",)
    check = build()
    assert evaluate(check, devices).evidence.unobserved_of == lost
    shared = {"mounts": (api.Mount("bind", "/dev", "/dev"),), "privileged": True}
    assert evaluate(check, devices, **shared).evidence.unobserved_of == ()
    assert evaluate(check, devices, started_at="later").evidence.unobserved_of == ()
    other = evaluate(build(), devices, started_at="later").evidence.unobserved_of
    assert other and other != lost, "PHM was not running when the container was restarted"


def test_a_device_that_need_not_be_mapped_is_checked_on_the_host_only() -> None:
    """`mapped: false` ignores the container."""
    assert evaluate(build(mapped=False), there(), devices=()).level is api.Level.OK


def test_without_its_container_the_mapping_is_unknown() -> None:
    """The device exists; the check has no evidence about the mapping."""
    result = build().run(testing.world(devices=there()))
    assert isinstance(result, api.Result)
    assert result.level is api.Level.STALE


def test_a_probe_without_evidence_makes_the_unit_stale() -> None:
    """A /dev that is not mounted is not a missing device."""
    devices = testing.FakeDevices()
    devices.fail("the host's /dev is not mounted")
    result = evaluate(build(), devices)
    assert result.level is api.Level.STALE
    assert "not mounted" in result.summary
