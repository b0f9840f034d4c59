"""A reload or a restart of PHM does not end the fault of an autopilot that is lost."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.api import Level
from phm.core.model import FaultClosed, UnitState
from phm.core.settings import Settings
from phm.runtime.daemon import Daemon
from phm.runtime.wiring import build_daemon, build_successor
from phm.testing import settings
from tests.fakes.mavlink import Sender, free_port, heartbeat
from tests.fakes.until import until

UNIT = "autopilot"


class Pilot:
    """An autopilot that sends a heartbeat several times a second until it is lost."""

    def __init__(self, port: int) -> None:
        self._address = ("127.0.0.1", port)
        self._lost = threading.Event()
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self) -> None:
        sender = Sender(1, 1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
            while not self._lost.wait(0.2):
                port.sendto(sender.frame(heartbeat(kind=2, autopilot=3, base_mode=128)), self._address)

    def lose(self) -> None:
        self._lost.set()
        self._thread.join()


class Lives:
    """Daemons that follow each other, with the events of all."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, free_port(socket.SOCK_DGRAM)
        self.ended: list[str] = []
        self.now = self._begin(build_daemon(self.settings()))

    def settings(self, **more: Any) -> Settings:
        folder = self.folder
        return settings(
            agent={"id": 1},
            checks={"host": {"enabled": False}},
            docker={"socket": f"unix://{folder}/none"},
            log={"directory": str(folder / "log")},
            state_dir=str(folder / "state"),
            run_dir=str(folder / "run"),
            recovery={"mode": "off"},
            mavlink={"endpoints": [{"url": f"udpin:127.0.0.1:{self.port}", "leads_to": "autopilot"}]},
            **more,
        )

    def _begin(self, daemon: Daemon) -> Daemon:
        daemon.components.bus.subscribe("test", self._take, kinds=(FaultClosed,))
        daemon.start()
        return daemon

    def _take(self, event: object) -> None:
        assert isinstance(event, FaultClosed)
        self.ended.append(event.fault.unit)

    def reload(self) -> None:
        self.now = self._begin(build_successor(self.now, self.settings(interval="7s")))

    def restart(self) -> None:
        self.now.stop()
        self.now = self._begin(build_daemon(self.settings()))

    @property
    def faults(self) -> list[str]:
        return [fault.id for fault in self.now.pipeline.open_faults() if fault.unit == UNIT]

    @property
    def state(self) -> UnitState:
        return next(state for state in self.now.pipeline.states() if state.unit == UNIT)

    def found(self) -> Level | None:
        """The level of its newest result since the daemon began."""
        newest = self.now.pipeline.newest(UNIT)
        return None if newest is None else newest.level


@pytest.fixture
def lives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lives]:
    monkeypatch.setenv("PHM_WATCHDOG", "off")
    made = Lives(tmp_path)
    pilot = Pilot(made.port)
    until(lambda: made.state.result.values, "the autopilot")
    pilot.lose()
    until(lambda: made.faults, "the fault")
    yield made
    made.now.stop()


def test_a_reload_keeps_the_state_of_the_links(lives: Lives) -> None:
    """What the predecessor received counts: the autopilot is lost, not absent."""
    (fault,) = lives.faults
    lives.reload()
    until(lambda: lives.found() is not None, "its first result")
    assert lives.found() is Level.ERROR
    assert (lives.faults, lives.ended) == ([fault], [])


def test_after_a_restart_the_fault_stays_open_and_the_unit_is_unknown(lives: Lives) -> None:
    """Until it is received: then the fault ends."""
    (fault,) = lives.faults
    lives.restart()
    until(lambda: lives.found() is not None, "its first result")
    until(lambda: lives.state.level is Level.STALE, "the published result")
    assert "not observed since PHM was restarted" in lives.state.result.summary
    assert (lives.faults, lives.ended) == ([fault], [])
    pilot = Pilot(lives.port)
    until(lambda: UNIT in lives.ended, "the end of the fault")
    pilot.lose()
