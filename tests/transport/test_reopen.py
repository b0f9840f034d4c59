"""A link that is open and silent is closed and reopened: by the hub, and by recovery, which verifies the result."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import socket
import termios
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.core.clock import SystemClock
from phm.core.model import ActionEvent, Event, FaultClosed, FaultOpened, Phase
from phm.facts import AutopilotFact
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm_checks import autopilot
from tests.fakes.mavlink import Sender, free_port, heartbeat
from tests.fakes.measured_clock import measured_clock
from tests.fakes.until import until

PILOT_FACT = AutopilotFact(0.0, False)
PILOT = heartbeat(5, kind=mavlink.MAV_TYPE_QUADROTOR, autopilot=3, base_mode=81)


def timesync(boot_s: float) -> mavlink.MAVLink_timesync_message:
    """A TIMESYNC request of an autopilot that has been running for `boot_s`."""
    return mavlink.MAVLink_timesync_message(0, int(boot_s * 1e9))


class Stale:
    """A TCP server whose connections stay half-open: each falls silent when `mute` is called, and only a later
    connection is served. `ignore_new`: later ones are not served either.
    """

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self.accepted = 0
        self.ignore_new = False
        self.booted: float | None = None
        """When it has begun to run, on the monotonic clock; None: it does not say."""
        self._speaks: list[socket.socket] = []
        self._all: list[socket.socket] = []
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def mute(self, *, ignore_new: bool = False) -> None:
        self.ignore_new = ignore_new
        self._speaks = []

    def speak(self) -> None:
        """On the newest connection."""
        self._speaks, self.ignore_new = self._all[-1:], False

    def _loop(self) -> None:
        sender = Sender(7, 1)
        while not self._stopping.wait(0.1):
            with contextlib.suppress(BlockingIOError):
                client, _ = self._listener.accept()
                self.accepted += 1
                self._all.append(client)
                if not self.ignore_new:
                    self._speaks = [*self._speaks, client]
            for client in self._speaks:
                frames = sender.frame(PILOT)
                if self.booted is not None:  # in one piece, and first: a reboot is known when the heartbeat arrives
                    frames = sender.frame(timesync(time.monotonic() - self.booted)) + frames
                with contextlib.suppress(OSError):
                    client.send(frames)

    def close(self) -> None:
        self._stopping.set()
        self._thread.join(60)
        for sock in (*self._all, self._listener):
            sock.close()


@pytest.fixture
def stale() -> Iterator[Stale]:
    made = Stale()
    yield made
    made.close()


@contextlib.contextmanager
def hub(url: str) -> Iterator[MavlinkHub]:
    made = MavlinkHub(settings(mavlink={"endpoints": [{"url": url, "name": "fc"}]}).mavlink, 7, SystemClock())
    made.start()
    try:
        yield made
    finally:
        made.close()


# ---------------------------------------------------------------- the hub


def test_a_connection_is_reopened(stale: Stale) -> None:
    """Closed and connected again, without being reported as closed; queued messages are sent by the new one."""
    with hub(f"tcp:127.0.0.1:{stale.port}") as made:
        seen: list[bool] = []
        made.watch(lambda: seen.extend(link.open for link in made.links()))
        until(lambda: stale.accepted == 1 and made.links())
        assert made.reopen("fc", 60.0)
        until(lambda: stale.accepted == 2)
        assert all(seen)


def test_only_the_named_endpoint_is_reopened(stale: Stale) -> None:
    """An unknown name opens nothing."""
    with hub(f"tcp:127.0.0.1:{stale.port}") as made:
        until(lambda: stale.accepted == 1)
        assert not made.reopen("ground", 0.2)
        assert stale.accepted == 1


def test_an_endpoint_that_cannot_be_reopened_is_reported() -> None:
    """Without a listener it is not open again in time."""
    with hub(f"tcp:127.0.0.1:{free_port()}") as made:
        until(made.links)
        assert not made.reopen("fc", 0.3)


def test_a_serial_port_is_reopened_without_a_reset() -> None:
    """DTR stays asserted when the port is closed, so that no device behind it takes the edge for a reset."""
    far, near = pty.openpty()
    tty.setraw(far)
    tty.setraw(near)
    attributes = termios.tcgetattr(near)
    attributes[2] |= termios.HUPCL
    termios.tcsetattr(near, termios.TCSANOW, attributes)
    with hub(os.ttyname(near)) as made:
        until(lambda: not termios.tcgetattr(near)[2] & termios.HUPCL, "DTR being kept")
        assert made.reopen("fc", 60.0)
        made.send(heartbeat(1))
        until(lambda: select.select([far], [], [], 0)[0])
        assert made.links()[0].open
    os.close(far)
    os.close(near)


# ---------------------------------------------------------------- recovery


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """An action is asked what else may have helped; a busy machine may delay its answer."""
    monkeypatch.setattr("phm.recovery.verification.OTHER_CAUSE_S", 60.0)


class Agent:
    """A daemon whose only link leads to the stale server, and its events."""

    def __init__(self, folder: Path, port: int, **recovery: object) -> None:
        self.events: list[Event] = []
        made = settings(
            agent={"id": 7},
            interval=2,
            state_dir=str(folder / "state"),
            run_dir=str(folder / "run"),
            log={"directory": str(folder / "log")},
            checks={"host": {"enabled": False}, "peers": {"enabled": False}},
            mavlink={
                "endpoints": [{"url": f"tcp:127.0.0.1:{port}", "name": "fc"}],
                "autopilot": True,
                "autopilot_timeout": 2,
            },
            recovery=recovery,
        )
        self.daemon = build_daemon(made, measured_clock())
        self.daemon.components.bus.subscribe("test", self.events.append)
        self.daemon.start()

    def link_active(self) -> bool:
        return self.daemon.components.probes.world.links.autopilot() is not None

    def phases(self) -> list[Phase]:
        return [event.phase for event in list(self.events) if isinstance(event, ActionEvent)]

    def opened(self) -> list[str]:
        return [event.fault.unit for event in list(self.events) if isinstance(event, FaultOpened)]

    def closed(self) -> list[tuple[str, str, str]]:
        faults = [event.fault for event in list(self.events) if isinstance(event, FaultClosed)]
        return [(fault.unit, fault.outcome.value, fault.by) for fault in faults]


@pytest.mark.parametrize("mode", ["act", "off"])
def test_an_open_and_silent_link_is_recovered(tmp_path: Path, stale: Stale, mode: str) -> None:
    """One alarm; reopened though the autopilot counts as armed and in any mode, since the link is PHM's own; verified
    by the check.
    """
    agent = Agent(tmp_path, stale.port, mode=mode)
    try:
        until(agent.link_active)
        stale.mute()
        until(lambda: agent.closed() and Phase.VERIFIED in agent.phases(), "the fault being over")
        assert agent.closed() == [("autopilot", "resolved", "reopen")]
        assert agent.opened() == ["autopilot"]
        assert agent.phases() == [Phase.STARTED, Phase.DONE, Phase.VERIFIED]
        assert stale.accepted == 2
    finally:
        agent.daemon.stop()


@pytest.mark.parametrize("what", ["rebooted", "ran on", "came back late"])
def test_a_spontaneous_recovery_is_not_credited_to_a_reopening(
    tmp_path: Path, stale: Stale, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """A reboot shows in TIMESYNC, and a link that answers late has recovered without it."""
    monkeypatch.setattr(autopilot, "REPORT_S", 1.0)  # how long the reboot is reported before the unit is OK
    stale.booted = time.monotonic() - 1000.0
    agent = Agent(tmp_path, stale.port)
    try:
        until(agent.link_active)
        until(lambda: (agent.daemon.components.probes.world.links.autopilot() or PILOT_FACT).boot_s)
        stale.mute(ignore_new=what == "came back late")
        if what == "rebooted":
            stale.booted = time.monotonic()
        if what == "came back late":
            until(lambda: Phase.DONE in agent.phases(), "the reopening")
            stale.speak()
        until(agent.closed, "the fault being over")
        ended_by = {"ran on": "reopen", "rebooted": "reboot"}.get(what, "itself")
        assert agent.closed() == [("autopilot", "resolved", ended_by)]
    finally:
        agent.daemon.stop()


def test_an_ineffective_reopening_is_given_up(tmp_path: Path, stale: Stale) -> None:
    """After the number of attempts of recovery.same_failure, then reported once, with the manual next step."""
    agent = Agent(tmp_path, stale.port, same_failure=1)
    try:
        until(agent.link_active)
        stale.mute(ignore_new=True)
        until(lambda: Phase.ESCALATED in agent.phases(), "giving up")
        assert agent.phases() == [Phase.STARTED, Phase.DONE, Phase.FAILED, Phase.ESCALATED]
        (said,) = [
            event.detail for event in agent.events if isinstance(event, ActionEvent) and event.phase is Phase.ESCALATED
        ]
        assert "check the device behind fc" in said
        assert "docker" not in said
        stale.ignore_new = False
        assert agent.daemon.components.probes.reopen("fc", 60.0)
        until(lambda: not agent.daemon.pipeline.given_up(), "recovery")
    finally:
        agent.daemon.stop()
