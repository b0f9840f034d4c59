"""PHM between a simulated ground station, a pair of radios on a serial port, and an autopilot: each hop fails in turn."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.core.model import ActionEvent, Event, FaultClosed, FaultOpened, Level, Phase
from phm.runtime.wiring import build_daemon
from phm.simulation.autopilot import SimulatedAutopilot
from phm.testing import settings
from sitl.simulation.ground import Ground
from sitl.simulation.radio import Radio
from tests.fakes.mavlink import free_port
from tests.fakes.measured_clock import measured_clock
from tests.fakes.until import until

ALL_OK = "GCS ok -> radio ok -> port ground ok -> companion ok -> link fc ok -> autopilot ok"


class Flight:
    """Ground station - radio ~ radio - serial port - PHM - TCP - autopilot 7. Everything runs in this process."""

    def __init__(self, folder: Path) -> None:
        self.port, self.far, self.companion = str(folder / "ttyRADIO"), free_port(), free_port()
        self._spare = free_port()
        self.radio, self._radio_thread = self._switch_on()
        companion, ground = (f"tcpin:127.0.0.1:{port}" for port in (self.companion, self._spare))
        self.pilot = SimulatedAutopilot(7, companion, ground, stream_hz=4.0)
        self._pilot_thread = threading.Thread(target=self.pilot.run, daemon=True)
        self._pilot_thread.start()
        self.ground = self.new_ground()
        endpoints = [
            {"url": self.port, "name": "ground", "leads_to": "ground", "budget": 0},
            {"url": f"tcp:127.0.0.1:{self.companion}", "name": "fc", "leads_to": "autopilot"},
        ]
        made = settings(
            agent={"id": 7},
            interval=2,
            state_dir=str(folder / "state"),
            run_dir=str(folder / "run"),
            log={"directory": str(folder / "log")},
            checks={"host": {"enabled": False}, "peers": {"enabled": False}},
            mavlink={
                "endpoints": endpoints,
                "heartbeat": 0.5,
                "gcs_timeout": 5,
                "autopilot_timeout": 5,
                "radio_timeout": 8,
            },
        )
        self.events: list[Event] = []
        self.daemon = build_daemon(made, measured_clock())
        self.daemon.components.bus.subscribe("test", self.events.append)
        self.daemon.start()

    def new_ground(self) -> Ground:
        ground = Ground(f"tcp:127.0.0.1:{self.far}")
        ground.start()
        return ground

    def _switch_on(self) -> tuple[Radio, threading.Thread]:
        radio = Radio(f"pty:{self.port}", f"tcpin:127.0.0.1:{self.far}")
        thread = threading.Thread(target=radio.run, daemon=True)
        thread.start()
        return radio, thread

    def unplug(self) -> None:
        self.radio.stop()
        self._radio_thread.join(60)

    def plug_in(self) -> None:
        self.radio, self._radio_thread = self._switch_on()

    def close(self) -> None:
        self.daemon.stop()
        self.ground.stop()
        self.pilot.stop()
        self.unplug()
        self._pilot_thread.join(60)

    # ------------------------------------------------------------ what was published

    def path(self) -> str:
        return next(state.result.summary for state in self.daemon.pipeline.states() if state.unit == "path")

    def alarms(self) -> list[str]:
        faults = [event.fault for event in list(self.events) if isinstance(event, FaultOpened)]
        return [f"{fault.unit} {fault.result.brief}" for fault in faults]

    def over(self) -> list[str]:
        faults = [event.fault for event in list(self.events) if isinstance(event, FaultClosed)]
        return [f"{fault.unit} {fault.outcome.value}" for fault in faults]

    def lines(self) -> list[str]:
        return [line.text for line in list(self.ground.lines)]

    def settled(self) -> bool:
        """Whether all is OK, apart from what PHM says about itself: on a busy machine it has paused now and then."""
        states = [state for state in self.daemon.pipeline.states() if state.unit != "companion"]
        return all(state.level is Level.OK for state in states) and ALL_OK in self.path()


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[Flight]:
    made = Flight(tmp_path)
    try:
        until(made.settled, "all hops to be received")
        yield made
    finally:
        made.close()


def test_a_lost_ground_station_is_reported_once_and_cleared(flight: Flight) -> None:
    """It closes and returns: one alarm, for the ground station, and the new one receives it."""
    flight.ground.stop()
    until(flight.alarms, "the alarm")
    assert "is broken at GCS" in until(lambda: flight.path() if "is broken" in flight.path() else "")
    flight.ground = flight.new_ground()
    until(flight.settled, "all units to be OK")
    assert [alarm.partition(":")[0] for alarm in flight.alarms()] == ["gcs GCS"]
    assert until(flight.over, "the end of the fault") == ["gcs resolved"]


def test_a_radio_without_power_is_reported_once(flight: Flight) -> None:
    """The ground station behind it is silent without its own alarm; a report that cannot be sent is in the log."""
    flight.radio.near.off = True
    until(flight.alarms, "the alarm")
    until(lambda: "GCS unknown (behind radio)" in flight.path())
    flight.radio.near.off = False
    until(flight.settled, "all units to be OK")
    assert [alarm.partition(":")[0] for alarm in flight.alarms()] == ["radio/ground radio"]
    assert len(until(flight.over, "the end of the fault")) == 1


def test_radios_without_contact_lose_the_ground_station(flight: Flight) -> None:
    """The onboard radio still responds, so the alarm says where to look: on the ground."""
    flight.radio.air.cut = True
    until(flight.alarms, "the alarm")
    fault = next(event.fault for event in list(flight.events) if isinstance(event, FaultOpened))
    assert fault.unit == "gcs"
    assert "the onboard radio responds" in fault.result.summary
    until(lambda: any(state.result.brief == "radio: buffer full" for state in flight.daemon.pipeline.states()))
    flight.radio.air.cut = False
    until(flight.settled, "all units to be OK")
    assert len(flight.alarms()) == 1


def test_a_weak_signal_is_a_warning(flight: Flight) -> None:
    """Sent to the ground while the link still works."""
    flight.radio.air.rssi = flight.radio.air.noise + 6
    until(lambda: any(line.startswith("A07 WARN 11 radio: weak, margin") for line in flight.lines()), "the line")
    assert flight.alarms() == []


def test_an_unplugged_port_is_named(flight: Flight) -> None:
    """Units behind it are blocked; when it is plugged in, it is reopened, and everything is OK."""
    flight.unplug()
    until(flight.alarms, "the alarm")
    until(lambda: "GCS unknown (behind port ground) -> radio unknown (behind port ground)" in flight.path())
    flight.plug_in()
    until(flight.settled, "all units to be OK")
    assert flight.alarms() == ["link/ground port ground: ttyRADIO missing"]
    assert until(flight.over, "the end of the fault") == ["link/ground resolved"]


def test_a_silent_autopilot_is_reported_to_the_ground(flight: Flight) -> None:
    """PHM's own heartbeats continue, so no one else reports it; its link is reopened, which does not help a hung one."""
    flight.pilot.hung = True
    line = until(lambda: [line for line in flight.lines() if " 10 " in line], "the line")[0]
    assert line.startswith("A07 FAIL 10 autopilot: no heartbeat")
    until(lambda: any(isinstance(event, ActionEvent) and event.phase is Phase.DONE for event in list(flight.events)))
    flight.pilot.hung = False
    until(flight.settled, "all units to be OK")
    assert len(flight.alarms()) == 1
    assert until(lambda: [line for line in flight.lines() if line.startswith("A07 OK 10")])


@pytest.mark.parametrize(
    ("armed", "line"),
    [(False, "A07 WARN 10 autopilot rebooted"), (True, "A07 FAIL 10 autopilot rebooted while armed")],
    ids=["on the ground", "armed"],
)
def test_a_reboot_is_reported_to_the_ground(flight: Flight, armed: bool, line: str) -> None:
    """Faster than by its silence, and with a higher severity if it was armed."""
    flight.pilot.armed = armed
    fact = until(
        lambda: (fact := flight.daemon.components.probes.world.links.autopilot()) and fact.armed is armed and fact
    )
    # It booted half a second before it says so: by then it must have been received as armed.
    since_s = max(4.0, (fact.boot_s or 0) + 1.0)
    until(lambda: (flight.daemon.components.probes.world.links.autopilot().boot_s or 0) > since_s)
    flight.pilot.reboot(boot_s=0.5)
    until(lambda: line in flight.lines(), "the line")
    bad = {state.unit for state in flight.daemon.pipeline.states() if state.level.bad}
    assert bad - {"companion"} == {"autopilot"}  # on a busy machine PHM itself has paused now and then
