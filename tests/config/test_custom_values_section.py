"""The section `custom`: mistakes in checks of topics, services, nodes, MAVLink messages and serial ports."""

from __future__ import annotations

import pytest

from phm.config import ConfigError, loads

HEAD = """containers: [{name: app, ready: {call: /ask}}]
mavlink: {endpoints: [{url: /dev/ttyAMA0, name: fc, leads_to: WHERE}]}
custom:
"""
TOPIC = "name: a, type: topic, topic: /t"
MAVLINK = "name: a, type: mavlink, message: BATTERY_STATUS"
SERIAL = "name: a, type: serial, device: /dev/ttyUSB0"
SERVICE = "name: a, type: service, service: /ask"


def problems(*entries: str, where: str = "autopilot") -> list[str]:
    lines = "".join(f"  - {{{entry}}}\n" for entry in entries)
    try:
        loads(HEAD.replace("WHERE", where) + lines, "phm.yaml", environ={}, known_checks=("container", "custom"))
    except ConfigError as error:
        return [str(problem) for problem in error.problems]
    return []


@pytest.mark.parametrize(
    "entry",
    [
        TOPIC,
        f"{TOPIC}, field: 'cells[0].voltage', min: 3, warn_min: 3.3, max: 4.3, max_age: 2s",
        f"{TOPIC}, field: name, equals: ready",
        f"{TOPIC}, field: flag, equals: false",
        f"{TOPIC}, field: value, not_nan: true",
        f"{TOPIC}, message: std_msgs/msg/Float64, field: data, min: 0",
        f"{TOPIC}, message: absent_msgs/msg/X, field: data, min: 0",
        SERVICE,
        f"{SERVICE}, call: std_srvs/srv/Trigger",
        "name: a, type: lifecycle, node: /planner, state: inactive",
        f"{MAVLINK}, field: battery_remaining, min: 20, instance: 0, component: 180, request: 1Hz",
        f"{MAVLINK}, field: 'voltages[0]', min: 10500",
        SERIAL,
        f"{SERIAL}, max_age: 2s, line: '$GPGGA,*', baud: 9600",
    ],
)
def test_entries_are_accepted(entry: str) -> None:
    """Each entry is valid as written."""
    assert problems(entry) == []


@pytest.mark.parametrize(
    ("entry", "problem"),
    [
        (f"{TOPIC}, min: 1", "custom[0]: has min, but no field to compare with it: add 'field'"),
        (f"{TOPIC}, field: x", "custom[0]: has a field, but no limit for it: add one of min, max"),
        (f"{TOPIC}, field: x, min: 2, max: 1", "custom[0]: min is 2 and max is 1: min must not be above max"),
        (f"{TOPIC}, field: x, min: 2, warn_min: 1", "custom[0]: min is 2 and warn_min is 1"),
        (f"{TOPIC}, field: 'x[-1]', min: 2", "custom[0].field: is 'x[-1]', allowed is the name of a field, e.g. pose"),
        (f"{TOPIC}, field: x, min: .nan", "custom[0].min: is nan, expected a finite number"),
        ("name: a, type: topic, topic: /diagnostics", "custom[0].topic: is '/diagnostics', on which PHM publishes itself"),
        (f"{SERVICE}, call: Trigger", "custom[0].call: is 'Trigger', allowed is package/srv/Type"),
        (f"{SERVICE}, call: std_srvs/srv/Empty", "custom[0].call: is 'std_srvs/srv/Empty', but the same service is std_srvs/srv/Trigger in line 1"),
        ("name: a, type: lifecycle, node: /n, state: on", "custom[0].state: is 'on', allowed are unconfigured, inactive, active, finalized"),
        (f"{MAVLINK}, field: battery_remaining", "custom[0]: has no limit for its field: add one of min, max"),
        (f"{MAVLINK}, field: remaining, min: 1", "custom[0].field: BATTERY_STATUS has no field remaining; similar: time_remaining, battery_remaining"),
        ("name: a, type: mavlink, message: BATERY_STATUS, field: id, min: 1", "custom[0].message: unknown message BATERY_STATUS; similar: BATTERY_STATUS"),
        ("name: a, type: mavlink, message: battery, field: id, min: 1", "custom[0].message: is 'battery', allowed is the name of a MAVLink message in capital"),
        ("name: a, type: mavlink, message: STATUSTEXT, field: text, min: 1", "custom[0].field: text of STATUSTEXT is a text"),
        ("name: a, type: serial, device: ttyUSB0", "custom[0].device: is 'ttyUSB0', allowed is a path below /dev"),
        (f"{SERIAL}, line: x", "custom[0]: has line, which is used only while the port is read: add 'max_age'"),
        ("name: a, type: serial, device: /dev/ttyAMA0, max_age: 2", "custom[0].device: is '/dev/ttyAMA0', which mavlink.endpoints (line 2) reads already"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_line(entry: str, problem: str) -> None:
    """At the key, or at the entry if a key is missing."""
    (found,) = problems(entry)
    assert found.startswith(f"phm.yaml:4: {problem}")


@pytest.mark.ros
@pytest.mark.parametrize(
    ("message", "field", "problem"),
    [
        ("Float64", "datum", "std_msgs/msg/Float64 has no field 'datum'; it has data"),
        ("String", "data", "data of std_msgs/msg/String is of type string, not a number"),
    ],
)
def test_a_field_must_be_a_number_of_its_message(message: str, field: str, problem: str) -> None:
    """Where the message is installed."""
    (found,) = problems(f"{TOPIC}, message: std_msgs/msg/{message}, field: {field}, min: 0")
    assert found.startswith(f"phm.yaml:4: custom[0].field: {problem}")


def test_mavlink_needs_a_link_to_the_autopilot() -> None:
    """Messages of others do not count."""
    (found,) = problems(f"{MAVLINK}, field: id, min: 1", where="ground")
    assert found.startswith(
        "phm.yaml:4: custom[0].type: is 'mavlink', but no endpoint of mavlink.endpoints leads to the autopilot"
    )


def test_a_port_is_read_by_one_check() -> None:
    """Another one may require that it exists."""
    reads = f"{SERIAL}, max_age: 2"
    (found,) = problems(reads, reads.replace("name: a", "name: b"), SERIAL.replace("name: a", "name: c"))
    assert found.startswith(
        "phm.yaml:5: custom[1].device: is '/dev/ttyUSB0', which another check (line 4) reads already"
    )


def test_the_calls_of_one_service_have_one_type() -> None:
    """The second one is refused, with the line of the first."""
    call = "type: service, service: /s, call: "
    (found,) = problems(f"name: a, {call}std_srvs/srv/Empty", f"name: b, {call}std_srvs/srv/Trigger")
    assert found.startswith(
        "phm.yaml:5: custom[1].call: is 'std_srvs/srv/Trigger', but the same service is std_srvs/srv/Empty in line 4"
    )
