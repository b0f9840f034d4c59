"""In flight on the real engine, with real MAVLink frames: flight-critical containers stay up until a recent disarmed."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import ActionEvent, Event, Phase
from phm.runtime.daemon import Daemon
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from phm.transport.dialect import mavlink
from phm.wire import control
from tests.fakes.mavlink import Sender, free_port, heartbeat
from tests.fakes.measured_clock import measured_clock
from tests.fakes.until import until
from tests.probes.docker.conftest import printed
from tests.proxy.haproxy import EngineAccess
from tests.recovery.test_recovery_real import TIMEOUT_S

pytestmark = pytest.mark.engine

NEEDED = "/needed"
RUN = "trap 'exit 0' TERM; while :; do sleep 0.1; done"


class Heartbeats:
    """Sends an autopilot's heartbeats to one UDP port, four a second, while `says` is not None: armed or not.

    runs_s: the reported time since boot; None: not reported.
    """

    def __init__(self, port: int) -> None:
        self.says: bool | None = None
        self.runs_s: float | None = None
        self._port, self._stop = port, threading.Event()
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def _loop(self) -> None:
        sender = Sender(7, 1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            while not self._stop.wait(0.25):
                if self.says is not None:
                    beat = heartbeat(5, kind=2, autopilot=3, base_mode=81 | (128 if self.says else 0))
                    sock.sendto(sender.frame(beat), ("127.0.0.1", self._port))
                    if self.runs_s is not None:
                        since_boot = mavlink.MAVLink_system_time_message(0, int(self.runs_s * 1000))
                        sock.sendto(sender.frame(since_boot), ("127.0.0.1", self._port))

    def close(self) -> None:
        self._stop.set()
        self._thread.join(60)


class Vehicle:
    """`owner` lacks a file, which a restart would restore; `pilot` shares its network and is flight-critical."""

    def __init__(self, real: Any, folder: Path, engine_access: EngineAccess) -> None:
        self.folder, self._engine_access, self._client = folder, engine_access, real.client
        owner = real.container(f"touch {NEEDED}; {RUN}")
        pilot = real.container(RUN, network_mode=f"container:{owner.id}")
        self.owner, self.pilot = owner, pilot
        self.ports = {name: free_port() for name in ("fc", "ground")}
        self.heartbeats = {name: Heartbeats(port) for name, port in self.ports.items()}
        self.events: list[Event] = []
        self.daemon: Daemon | None = None
        self._opened = False

    def start(self) -> None:
        containers = [
            {"name": self.owner.name, "alias": "owner", "recover": True, "files": [{"path": NEEDED}]},
            {"name": self.pilot.name, "alias": "pilot", "recover": True, "flight_critical": True},
        ]
        leads = {"fc": "autopilot", "ground": "ground"}
        endpoints = [
            {"url": f"udpin:127.0.0.1:{port}", "name": name, "leads_to": leads[name]}
            for name, port in self.ports.items()
        ]
        folder = self.folder
        made = settings(
            agent={"id": 7},
            interval=2,
            docker={"timeout": TIMEOUT_S, **self._engine_access.section},
            containers=containers,
            mavlink={"endpoints": endpoints},
            recovery={"ladders": {"file_missing": ["restart"]}, "stop_timeout": "2s", "verify": "60s"},
            state_dir=str(folder / "state"),
            run_dir=str(folder / "run"),
            log={"directory": str(folder / "log")},
            # A busy machine starves its containers, which is a fault and postpones actions.
            checks={"host": {"enabled": False}, "pressure": {"enabled": False}},
        )
        self.events = []
        if not self._opened:
            self._engine_access.open(made)
            self._opened = True
        self.daemon = build_daemon(made, measured_clock())
        self.daemon.components.bus.subscribe("test", self.events.append)
        self.daemon.start()

    def stop(self) -> None:
        if self.daemon is not None:
            self.daemon.stop()
            self.daemon = None

    def actions(self) -> list[tuple[Phase, str]]:
        return [(event.phase, event.detail) for event in list(self.events) if isinstance(event, ActionEvent)]

    def advised(self, words: str) -> bool:
        return any(phase is Phase.ADVISED and words in detail for phase, detail in self.actions())

    def started(self) -> list[str]:
        inspect = self._client.api.inspect_container
        return [str(inspect(made.id)["State"]["StartedAt"]) for made in (self.owner, self.pilot)]

    def gate(self) -> str:
        assert self.daemon is not None
        return self.daemon.components.armed.now().why

    def passes(self, number: int) -> None:
        """Wait until PHM has checked everything this many times, longer than any repeated decision takes."""
        assert self.daemon is not None
        daemon = self.daemon
        seen = daemon.pipeline._pass_number
        until(lambda: daemon.pipeline._pass_number >= seen + number, f"{number} passes")


@pytest.fixture
def vehicle(real: Any, tmp_path: Path, engine_access: EngineAccess) -> Iterator[Vehicle]:
    made = Vehicle(real, tmp_path, engine_access)
    yield made
    made.stop()
    for heartbeats in made.heartbeats.values():
        heartbeats.close()


def test_a_flight_critical_network_stays_up_from_arming_to_landing(vehicle: Vehicle) -> None:
    """Armed, silent, disarmed by a foreign ground station, PHM restarted: nothing; a recent disarmed: both are
    restarted.
    """

    before = vehicle.started()
    vehicle.heartbeats["fc"].says = True
    vehicle.start()
    until(lambda: vehicle.gate() == "the autopilot is armed", "the armed heartbeat")
    assert vehicle.owner.exec_run(["rm", NEEDED]).exit_code == 0
    until(lambda: vehicle.advised("would take down pilot, which is flight-critical"), "the advice")

    vehicle.heartbeats["fc"].says = None
    until(lambda: "silent" in vehicle.gate() and "was armed" in vehicle.gate(), "the silence")
    vehicle.heartbeats["ground"].says = False
    until(
        lambda: any("arrive by ground" in text for text in vehicle.daemon.components.probes.world.links.problems()),
        "the stranger",
    )  # type: ignore[union-attr]
    vehicle.passes(3)
    assert vehicle.started() == before

    vehicle.stop()
    vehicle.start()
    why = "no heartbeat of the autopilot was received since PHM started, and it was armed before"
    expected = {"containers": ["pilot"], "armed": "armed", "why": why}
    assert vehicle.daemon is not None
    assert vehicle.daemon.components.health.document()["flight_critical"] == expected
    vehicle.passes(3)
    assert vehicle.started() == before
    assert [phase for phase, _ in vehicle.actions() if phase is Phase.STARTED] == []

    vehicle.heartbeats["fc"].runs_s = 3.0
    vehicle.heartbeats["fc"].says = False
    until(lambda: "may have rebooted in the air" in vehicle.gate(), "the disarmed of an autopilot that has just booted")
    vehicle.passes(3)
    assert vehicle.started() == before
    vehicle.heartbeats["fc"].runs_s = 600.0
    until(lambda: any(phase is Phase.VERIFIED for phase, _ in vehicle.actions()), "the recovery on the ground")
    after = vehicle.started()
    assert before[0] < after[0] < after[1]
    share_network(vehicle)


def test_an_action_approved_in_flight_is_done_completely(vehicle: Vehicle) -> None:
    """By the control socket, as `phm approve` does: the flight-critical dependent named in the advice is restarted,
    too.
    """
    before = vehicle.started()
    vehicle.heartbeats["fc"].says = True
    vehicle.start()
    until(lambda: vehicle.gate() == "the autopilot is armed", "the armed heartbeat")
    assert vehicle.owner.exec_run(["rm", NEEDED]).exit_code == 0
    until(lambda: vehicle.advised("would take down pilot, which is flight-critical"), "the advice")
    assert vehicle.daemon is not None
    fault = next(fault for fault in vehicle.daemon.pipeline.open_faults() if fault.unit == "files/owner")
    said = control.ask(str(vehicle.folder / "run"), {"do": "approve", "fault": fault.id}, timeout_s=60.0)
    assert said == "approved: restart owner for files/owner"
    until(lambda: any(phase is Phase.VERIFIED for phase, _ in vehicle.actions()), "the repair")
    after = vehicle.started()
    assert before[0] < after[0] < after[1]
    share_network(vehicle)


def share_network(vehicle: Vehicle) -> None:
    spaces = {printed(made, "readlink", "/proc/1/ns/net") for made in (vehicle.owner, vehicle.pilot)}
    assert len(spaces) == 1
