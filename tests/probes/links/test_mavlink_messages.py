"""Values of MAVLink messages for own checks: recorded frames of a real ArduPilot, and a simulated autopilot on real links."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Level
from phm.facts import AutopilotFact, MessageValue
from phm.probes.mavlink_messages import AGAIN_S, MOST_INSTANCES, MavlinkMessages
from phm.probes.mavlink_values import INVALID, not_known
from phm.runtime.wiring import build_daemon
from phm.simulation.autopilot import SimulatedAutopilot
from phm.testing import FakeClock, settings
from phm.transport.dialect import mavlink, message_class
from phm.transport.mavlink import MavlinkHub
from tests.fakes.mavlink import Sender
from tests.fakes.measured_clock import measured_clock
from tests.fakes.recorded_flight import PHM, frames, source
from tests.fakes.until import until

LINKS = [
    {"url": "udpin:127.0.0.1:14550", "name": "fc", "leads_to": "autopilot"},
    {"url": "udpin:127.0.0.1:14551", "name": "radio", "leads_to": "ground"},
]


def check(name: str, message: str, field: str, **keys: Any) -> dict[str, Any]:
    return {"name": name, "type": "mavlink", "message": message, "field": field, "min": 0, **keys}


class Scene:
    """The probe of agent 1 on a hub with closed endpoints. Frames are decoded by PHM's own codec."""

    def __init__(self, *checks: dict[str, Any]) -> None:
        self.clock = FakeClock()
        chosen = settings(agent={"id": 1}, mavlink={"endpoints": LINKS}, custom=list(checks))
        self.hub = MavlinkHub(chosen.mavlink, 1, self.clock)
        self.sent: list[tuple[Any, str]] = []
        self.hub.send = lambda message, *_, link="", **__: self.sent.append((message, link))  # type: ignore[method-assign]
        self.pilot: AutopilotFact | None = AutopilotFact(0.5, False, link="fc")
        self.probe = MavlinkMessages(
            self.hub, chosen.agent.id, chosen.mavlink.endpoints, chosen.custom, self.clock, lambda: self.pilot
        )
        self._parser = self.hub._endpoints[0].codec.parser()

    def receive(self, frame: bytes, link: str = "fc") -> None:
        for message in self._parser.feed(frame):
            self.hub._deliver(message, link)

    def values(
        self, message: str, field: str, component: int = 1, instance: int | None = None
    ) -> tuple[MessageValue, ...]:
        return self.probe.values(message, field, component=component, instance=instance)

    def value(self, message: str, field: str) -> MessageValue:
        (found,) = self.values(message, field)
        return found

    def tick(self, seconds: float) -> int:
        """Let time pass as the hub's watcher sees it, twice a second; how many requests were sent."""
        before = len(self.sent)
        for _ in range(round(2 * seconds)):
            self.clock.advance(0.5)
            self.hub._changed()
        return len(self.sent) - before


FIELDS = {
    "BATTERY_STATUS": (
        "battery_remaining",
        "temperature",
        "voltages[0]",
        "voltages[1]",
        "time_remaining",
        "fault_bitmask",
    ),
    "EKF_STATUS_REPORT": ("compass_variance", "flags"),
    "GPS_RAW_INT": ("fix_type", "satellites_visible", "yaw"),
    "VIBRATION": ("vibration_x",),
    "STATUSTEXT": ("text",),
}


def test_values_of_a_recorded_flight_are_read() -> None:
    """Battery, EKF and GPS, as ArduCopter sent them; and which of them it says it does not know."""
    scene = Scene(*(check(f"c{place}", message, fields[0]) for place, (message, fields) in enumerate(FIELDS.items())))
    for _, frame in frames("streams_reboot_companion.tlog.gz"):
        if source(frame) != PHM:
            scene.receive(frame)
    seen = {
        f"{message}.{field}": scene.values(message, field) for message, fields in FIELDS.items() for field in fields
    }
    one = {name: found[0] for name, found in seen.items() if len(found) == 1}
    assert one.keys() == seen.keys()
    known = {name: value.number for name, value in one.items() if not value.unknown}
    assert known == {
        "BATTERY_STATUS.battery_remaining": 100.0,
        "BATTERY_STATUS.voltages[0]": 12600.0,
        "BATTERY_STATUS.fault_bitmask": 0.0,
        "EKF_STATUS_REPORT.compass_variance": pytest.approx(0.0383, abs=1e-4),
        "EKF_STATUS_REPORT.flags": 167.0,
        "GPS_RAW_INT.fix_type": 6.0,
        "GPS_RAW_INT.satellites_visible": 10.0,
        "VIBRATION.vibration_x": pytest.approx(0.0, abs=0.1),
        "STATUSTEXT.text": None,
    }
    unknown = {name: value.text for name, value in one.items() if value.unknown}
    assert unknown == {
        "BATTERY_STATUS.temperature": "32767",
        "BATTERY_STATUS.voltages[1]": "65535",
        "BATTERY_STATUS.time_remaining": "0",
        "GPS_RAW_INT.yaw": "0",
    }
    assert (one["BATTERY_STATUS.voltages[0]"].unit, one["BATTERY_STATUS.voltages[0]"].instance) == ("mV", 0)
    assert one["STATUSTEXT.text"].text.isprintable() and one["STATUSTEXT.text"].text


def battery(remaining: int, instance: int = 0) -> Any:
    return mavlink.MAVLink_battery_status_message(
        instance, 0, 1, 2500, [4000] + [65535] * 9, -1, -1, -1, remaining
    )  # fmt: skip


def test_minus_one_is_not_known_only_where_mavlink_says_so() -> None:
    """A current of -1 and a rest of -1 percent; NaN always; a speed of -1 is a speed, and 65535 bytes are memory."""
    scene = Scene(check("b", "BATTERY_STATUS", "battery_remaining"), check("g", "GLOBAL_POSITION_INT", "vx"))
    scene.receive(Sender(1, 1).frame(battery(-1)))
    scene.receive(Sender(1, 1).frame(mavlink.MAVLink_global_position_int_message(1, 2, 3, 4, 5, -1, 32767, 8, 65535)))
    assert [scene.value("BATTERY_STATUS", name).unknown for name in ("battery_remaining", "current_battery", "temperature")] == [
        True, True, False,
    ]  # fmt: skip
    assert scene.value("GLOBAL_POSITION_INT", "vx").number == -1.0
    assert scene.value("GLOBAL_POSITION_INT", "hdg").unknown
    assert not_known("VIBRATION", "vibration_x", float("nan")) and not not_known("MEMINFO", "freemem", 65535)
    kind = message_class("EKF_STATUS_REPORT")
    assert kind is not None
    scene = Scene(check("e", "EKF_STATUS_REPORT", "flags"))
    scene.receive(Sender(1, 1).frame(kind(65535, float("nan"), 0, 0, 0, 0)))
    assert scene.value("EKF_STATUS_REPORT", "velocity_variance").unknown
    assert scene.value("EKF_STATUS_REPORT", "flags").number == 65535.0


def test_the_table_names_fields_that_exist() -> None:
    """Of messages that PHM can decode."""
    for message, field in INVALID:
        kind = message_class(message)
        assert kind is not None and field in kind.fieldnames


def test_only_this_vehicle_on_a_link_to_its_autopilot_counts() -> None:
    """Not another vehicle, not another component, not the ground, which could send anything."""
    scene = Scene(check("b", "BATTERY_STATUS", "battery_remaining"), check("s", "BATTERY_STATUS", "id", component=180))
    scene.receive(Sender(2, 1).frame(battery(10)))
    scene.receive(Sender(1, 2).frame(battery(20)))
    scene.receive(Sender(1, 1).frame(battery(30)), link="radio")
    assert scene.values("BATTERY_STATUS", "battery_remaining") == ()
    scene.receive(Sender(1, 180).frame(battery(40)))
    assert scene.values("BATTERY_STATUS", "battery_remaining") == ()
    assert [value.number for value in scene.values("BATTERY_STATUS", "battery_remaining", component=180)] == [40.0]


def test_instances_are_kept_apart_and_limited() -> None:
    """One sender can claim 256 batteries."""
    scene = Scene(check("b", "BATTERY_STATUS", "battery_remaining"))
    for instance in range(256):
        scene.receive(Sender(1, 1).frame(battery(instance % 100, instance)))
    scene.clock.advance(3.0)
    scene.receive(Sender(1, 1).frame(battery(99, 1)))
    found = scene.values("BATTERY_STATUS", "battery_remaining")
    assert [value.instance for value in found] == list(range(MOST_INSTANCES))
    assert [(value.age_s, value.number) for value in found[:2]] == [(3.0, 0.0), (0.0, 99.0)]
    assert [value.number for value in scene.values("BATTERY_STATUS", "battery_remaining", instance=7)] == [7.0]


def test_a_message_is_requested_only_if_asked_for_and_missing() -> None:
    """Opt-in, by the link of the autopilot; again after a while; not while it arrives, nor without an autopilot."""
    assert Scene(check("b", "BATTERY_STATUS", "id")).tick(60.0) == 0
    scene = Scene(check("b", "BATTERY_STATUS", "id", request=0.5), check("c", "BATTERY_STATUS", "id", request=2.0))
    assert scene.tick(1.0) == 1
    request, link = scene.sent[0]
    assert (request.target_system, request.target_component, link) == (1, 1, "fc")
    assert (request.command, request.param1, request.param2) == (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 147, 0.5e6)
    assert scene.tick(AGAIN_S - 1.0) == 0 and scene.tick(1.0) == 1
    for _ in range(20):
        scene.receive(Sender(1, 1).frame(battery(50)))
        assert scene.tick(1.0) == 0
    assert scene.tick(5.0) == 1
    scene.pilot = None
    assert scene.tick(30.0) == 0


class Vehicle:
    """PHM on the serial port of a simulated autopilot that sends nothing unrequested, with own checks."""

    def __init__(self, folder: Path) -> None:
        port = str(folder / "ttyAMA0")
        self.pilot = SimulatedAutopilot(7, f"pty:{port}", "udpin:127.0.0.1:0")
        self._thread = threading.Thread(target=self.pilot.run, daemon=True)
        self._thread.start()
        position = {"period": 0.5, "failures": 1, "max_age": 3, "message": "GLOBAL_POSITION_INT", "type": "mavlink"}
        self.daemon = build_daemon(
            settings(
                agent={"id": 7},
                interval=2,
                state_dir=str(folder / "state"),
                run_dir=str(folder / "run"),
                log={"directory": str(folder / "log")},
                checks={"host": {"enabled": False}, "peers": {"enabled": False}},
                mavlink={"endpoints": [{"url": port, "name": "fc", "budget": 0}], "heartbeat": 0.5},
                custom=[
                    {"name": "latitude", **position, "field": "lat", "min": 0, "request": 4},
                    {"name": "height", **position, "field": "relative_alt", "max": -1, "grace": 0},
                    {
                        "name": "battery",
                        **position,
                        "message": "BATTERY_STATUS",
                        "field": "battery_remaining",
                        "min": 20,
                        "grace": 0,
                    },
                ],
            ),
            measured_clock(),
        )
        self.daemon.start()

    def until(self, unit: str, level: Level, words: str) -> None:
        def found() -> bool:
            states = {state.unit: state for state in self.daemon.pipeline.states()}
            return states[unit].level is level and words in states[unit].result.summary

        until(
            found,
            f"{unit} {level} {words!r}",
            lambda: [(s.unit, s.result.summary) for s in self.daemon.pipeline.states()],
        )

    def close(self) -> None:
        self.daemon.stop()
        self.pilot.stop()
        self._thread.join(60)


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[Vehicle]:
    made = Vehicle(tmp_path)
    yield made
    made.close()


def test_own_checks_of_a_simulated_autopilot(vehicle: Vehicle) -> None:
    """A requested message arrives and is compared; one that never comes fails; a lost autopilot is the fault of all."""
    vehicle.until("custom/latitude", Level.OK, "lat of GLOBAL_POSITION_INT is 47397")
    vehicle.until("custom/height", Level.ERROR, "allowed is -1 or less")
    vehicle.until("custom/battery", Level.ERROR, "BATTERY_STATUS was never received from component 1")
    vehicle.pilot.hung = True
    vehicle.until("autopilot", Level.ERROR, "no autopilot heartbeat")
    vehicle.until("custom/latitude", Level.STALE, "blocked by autopilot")
