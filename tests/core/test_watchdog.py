"""The watchdog of the daemon, with real processes and a short period; and the detection of an unclean shutdown."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from phm.core import watchdog as watchdog_module
from phm.core.watchdog import GLANCES, SILENT_POLLS, STOPPED_POLLS, DaemonWatchdog, state_in, watch
from phm.runtime.shutdown_marker import ShutdownMarker
from tests.fakes.until import until

POLL_S = 0.02
LIMIT_S = 60.0


class Watched:
    """A sleeping process with a watchdog; `kills` has the sent signals. Only the test writes heartbeats."""

    def __init__(self, poll_s: float = POLL_S) -> None:
        self.process = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(600)"])
        self.kills: list[int] = []
        far, self.pipe = os.pipe()
        self.thread = threading.Thread(target=watch, args=(far, self.process.pid, self._kill, poll_s), daemon=True)
        self.thread.start()

    def _kill(self, pid: int, number: int) -> None:
        self.kills.append(number)
        os.kill(pid, number)

    def close(self) -> None:
        os.close(self.pipe)
        self.thread.join(LIMIT_S)
        self.process.kill()
        self.process.wait()


@pytest.fixture
def watched() -> Iterator[Watched]:
    made = Watched()
    yield made
    made.close()


def test_a_stopped_daemon_is_resumed_and_not_killed() -> None:
    """SIGSTOP: SIGCONT after a few samples, so that it loses none of its state."""
    assert STOPPED_POLLS < SILENT_POLLS
    watched = Watched(2.0)  # this test sends no heartbeat for so long, and may have to wait for a CPU
    try:
        os.kill(watched.process.pid, signal.SIGSTOP)
        until(lambda: watched.kills, "the watchdog's first step")
        os.write(watched.pipe, b".")
        assert watched.kills[0] == signal.SIGCONT
        until(lambda: psutil.Process(watched.process.pid).status() != psutil.STATUS_STOPPED, "the daemon to resume")
    finally:
        watched.close()


def test_a_daemon_without_heartbeats_is_killed(watched: Watched) -> None:
    """It runs and sends nothing: Docker restarts a terminated container."""
    assert watched.process.wait(LIMIT_S) == -signal.SIGKILL
    assert watched.kills == [signal.SIGKILL]


def test_a_daemon_with_heartbeats_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as bytes arrive nothing is done, for more looks than the tolerated silence. The test sets the pace of the looks."""
    turns, looks = threading.Semaphore(0), 0

    def observe(stat: int) -> str:
        nonlocal looks
        turns.acquire()
        looks += 1
        return state_in(stat)

    monkeypatch.setattr(watchdog_module, "state_in", observe)
    watched = Watched()
    try:
        for number in range(1, SILENT_POLLS + 3):
            os.write(watched.pipe, b".")
            turns.release(GLANCES)
            until(lambda number=number: looks == number * GLANCES, "the looks", lambda: watched.kills)  # type: ignore[misc]
        assert watched.kills == []
    finally:
        turns.release(1000)
        watched.close()


def simulate(
    monkeypatch: pytest.MonkeyPatch, states: str, *, heartbeat_every: int = 0, left_alone: str = "t"
) -> list[tuple[int, str]]:
    """What a watchdog does, and at which sample, when the daemon is in one of `states` at each; `heartbeat_every`: their period."""
    far, pipe = os.pipe()
    seen: list[str] = []
    done: list[tuple[int, str]] = []

    def observe(stat: int) -> str:
        if len(seen) == len(states):
            os.close(pipe)
            return ""
        seen.append(states[len(seen)])
        if heartbeat_every and len(seen) % heartbeat_every == 0:
            os.write(pipe, b".")
        return seen[-1]

    monkeypatch.setattr(watchdog_module, "state_in", observe)
    watch(
        far,
        os.getpid(),
        lambda pid, number: done.append((len(seen), signal.Signals(number).name)),
        0.0,
        on_resume=lambda: done.append((len(seen), "reported")),
        left_alone=left_alone,
    )
    os.close(far)
    return done


def test_a_stop_is_detected_in_a_fraction_of_a_second_and_reported_before_the_resume(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Before the next heartbeat check, so that no heartbeat of 2 s is missed; reported first, so that the daemon knows."""
    assert STOPPED_POLLS < GLANCES
    assert simulate(monkeypatch, "SS" + "T" * STOPPED_POLLS + "SS", heartbeat_every=GLANCES) == [
        (4, "reported"),
        (4, "SIGCONT"),
    ]


def test_a_daemon_that_is_stopped_and_resumed_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any number of single samples find it stopped."""
    assert simulate(monkeypatch, "TS" * 5 * GLANCES, heartbeat_every=GLANCES) == []


@pytest.mark.parametrize(("states", "left_alone"), [("t", "t"), ("T", "tT")], ids=["debugger", "terminal"])
def test_a_daemon_under_other_control_is_left_alone(
    monkeypatch: pytest.MonkeyPatch, states: str, left_alone: str
) -> None:
    """A debugger, or the shell in a terminal: neither resumed nor killed, at any time."""
    assert simulate(monkeypatch, states * 3 * SILENT_POLLS * GLANCES, left_alone=left_alone) == []


def test_a_starved_daemon_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """One heartbeat in almost the tolerated silence; without any it is killed, and not a sample earlier."""
    most = SILENT_POLLS * GLANCES
    assert simulate(monkeypatch, "R" * 5 * most, heartbeat_every=most - GLANCES) == []
    assert simulate(monkeypatch, "D" * 5 * most) == [(most, "SIGKILL")]


BEATING = """
import time
from phm.core.watchdog import DaemonWatchdog
watchdog = DaemonWatchdog()
watchdog.start()
print("running", flush=True)
while not watchdog.heartbeat():
    time.sleep(0.02)
print("resumed", flush=True)
watchdog.close()
"""


def test_a_resumed_daemon_knows_it() -> None:
    """With the complete watchdog: stopped, then resumed with a report by it."""
    with subprocess.Popen([sys.executable, "-c", BEATING], stdout=subprocess.PIPE, stdin=subprocess.DEVNULL) as daemon:
        limit = threading.Timer(LIMIT_S, daemon.kill)
        limit.start()
        try:
            assert daemon.stdout is not None
            assert daemon.stdout.readline() == b"running\n"
            daemon.send_signal(signal.SIGSTOP)
            assert daemon.stdout.readline() == b"resumed\n"
            assert daemon.wait() == 0
        finally:
            limit.cancel()
            daemon.kill()


def test_the_watchdog_ends_with_the_daemon() -> None:
    """Closed pipe, no process left."""
    watchdog = DaemonWatchdog()
    watchdog.start()
    process = watchdog._process
    assert process is not None
    watchdog.heartbeat()
    watchdog.close()
    watchdog.close()
    assert process.wait(LIMIT_S) == 0
    assert watchdog.problem == ""


def test_a_watchdog_that_cannot_start_or_dies_is_a_reported_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM runs without it and reports it; a disabled one is not reported."""
    watchdog = DaemonWatchdog(("/nonexistent/python",))
    watchdog.start()
    watchdog.heartbeat()
    assert "cannot be started" in watchdog.problem
    dead = DaemonWatchdog((sys.executable, "-S", "-c", ""))
    dead.start()

    def noticed() -> str:
        dead._wrote_at = float("-inf")
        dead.heartbeat()
        return dead.problem

    until(noticed, "the problem")
    assert "has exited" in dead.problem
    monkeypatch.setenv("PHM_WATCHDOG", "off")
    off = DaemonWatchdog(("/nonexistent/python",))
    off.start()
    assert off.problem == ""


def test_an_unclean_shutdown_is_known_at_the_next_start(tmp_path: Path) -> None:
    """Not at the first start, not after a clean shutdown, not after a power failure of the machine."""
    assert not ShutdownMarker(str(tmp_path), "boot-1").begin()
    assert ShutdownMarker(str(tmp_path), "boot-1").begin()
    assert not ShutdownMarker(str(tmp_path), "boot-2").begin()
    ShutdownMarker(str(tmp_path), "boot-2").end()
    assert not ShutdownMarker(str(tmp_path), "boot-2").begin()


def test_without_a_writable_directory_nothing_is_claimed(tmp_path: Path) -> None:
    """There is no evidence; another unit reports the directory."""
    file = tmp_path / "file"
    file.touch()
    end = ShutdownMarker(str(file / "below"), "boot-1")
    assert not end.begin()
    end.end()
    assert not end.begin()
