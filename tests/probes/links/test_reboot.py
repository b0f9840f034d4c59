"""PHM on the serial port of an autopilot that reboots as a real one: six silent seconds, default parameters, no streams."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.core.model import ActionEvent, Event, FaultClosed, Level, Phase, Transition
from phm.runtime.wiring import build_daemon
from phm.simulation.autopilot import SimulatedAutopilot
from phm.simulation.mavlink_port import mavlink
from phm.testing import settings
from sitl.simulation.ground import Ground
from tests.fakes.mavlink import free_port
from tests.fakes.measured_clock import measured_clock
from tests.fakes.until import until


class Vehicle:
    """Ground station - TCP - autopilot 7 - serial port - PHM."""

    def __init__(self, folder: Path) -> None:
        port, ground = str(folder / "ttyAMA0"), free_port()
        self.pilot = SimulatedAutopilot(7, f"pty:{port}", f"tcpin:127.0.0.1:{ground}")
        self._thread = threading.Thread(target=self.pilot.run, daemon=True)
        self._thread.start()
        self.ground = Ground(f"tcp:127.0.0.1:{ground}")
        self.ground.start()
        self.events: list[Event] = []
        self.daemon = build_daemon(
            settings(
                agent={"id": 7},
                interval=2,
                state_dir=str(folder / "state"),
                run_dir=str(folder / "run"),
                log={"directory": str(folder / "log")},
                checks={"host": {"enabled": False}, "peers": {"enabled": False}},
                mavlink={"endpoints": [{"url": port, "name": "fc", "budget": 0}], "heartbeat": 0.5},
            ),
            measured_clock(),
        )
        self.daemon.components.bus.subscribe("test", self.events.append)
        self.daemon.start()

    def close(self) -> None:
        self.daemon.stop()
        self.ground.stop()
        self.pilot.stop()
        self._thread.join(60)

    def level(self) -> Level:
        return next(state.level for state in self.daemon.pipeline.states() if state.unit == "autopilot")

    def standby(self) -> bool:
        fact = self.daemon.components.probes.world.links.autopilot()
        return fact is not None and fact.system_status == mavlink.MAV_STATE_STANDBY

    def lines(self) -> list[str]:
        return [line.text for line in list(self.ground.lines) if line.component == 193 and " 10 " in line.text]


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[Vehicle]:
    made = Vehicle(tmp_path)
    yield made
    made.close()


def test_a_reboot_is_reported_as_one_and_no_action_is_credited(vehicle: Vehicle) -> None:
    """It returns just after PHM has reopened the port, and the ground reads what it was."""
    until(lambda: vehicle.level() is Level.OK and (7, 193) in vehicle.ground.heartbeats, "the autopilot and PHM")
    until(vehicle.standby, "the end of its start")
    before = len(vehicle.events)
    vehicle.pilot.reboot()
    closed = until(
        lambda: [event.fault for event in vehicle.events[before:] if isinstance(event, FaultClosed)], "its end"
    )
    assert [(fault.unit, fault.by) for fault in closed] == [("autopilot", "reboot")]
    until(lambda: "A07 WARN 10 autopilot rebooted" in vehicle.lines(), "the line")
    states = [event.state for event in vehicle.events[before:] if isinstance(event, Transition)]
    levels = [state.level for state in states if state.unit == "autopilot"]
    lost = levels.index(Level.ERROR)
    assert levels[lost : lost + 2] == [Level.ERROR, Level.WARN]
    acts = [event for event in list(vehicle.events) if isinstance(event, ActionEvent)]
    assert all("not credited to reopen" in act.detail for act in acts if act.phase is Phase.VERIFIED)
    assert not [line for line in vehicle.lines() if "reopen" in line]
