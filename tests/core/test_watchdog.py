"""The guard over the daemon, with real processes and a short look; and what tells that PHM had not ended in good order."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.core import watchdog as guard_module
from phm.core.watchdog import GLANCES, SILENT_LOOKS, STOPPED_LOOKS, DaemonWatchdog, state_of, watch
from phm.runtime.shutdown_marker import ShutdownMarker
from tests.fakes.until import until

LOOK_S = 0.02
LIMIT_S = 20.0


class Watched:
    """A process that sleeps, and a guard over it; `kills` has what was sent. Nothing beats but what the test writes."""

    def __init__(self, look_s: float = LOOK_S) -> None:
        self.process = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(600)"])
        self.kills: list[int] = []
        far, self.pipe = os.pipe()
        self.thread = threading.Thread(target=watch, args=(far, self.process.pid, self._kill, look_s), daemon=True)
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


def test_a_stopped_daemon_is_let_go_on_and_not_ended(watched: Watched) -> None:
    """SIGSTOP: SIGCONT after a few looks, so that it loses nothing of what it knew."""
    assert STOPPED_LOOKS < SILENT_LOOKS
    os.kill(watched.process.pid, signal.SIGSTOP)
    until(lambda: watched.kills, "the guard's first step")
    os.write(watched.pipe, b".")
    assert watched.kills[0] == signal.SIGCONT
    until(lambda: state_of(watched.process.pid) != "T", "going on")


def test_a_daemon_that_does_not_beat_is_ended(watched: Watched) -> None:
    """It lives and nothing comes: Docker starts what has ended."""
    assert watched.process.wait(LIMIT_S) == -signal.SIGKILL
    assert watched.kills == [signal.SIGKILL]


def test_a_daemon_that_beats_is_left_alone() -> None:
    """As long as bytes come nothing is done, for longer than silence is borne."""
    look_s = 0.2
    watched = Watched(look_s)
    try:
        for _ in range(SILENT_LOOKS + 2):
            os.write(watched.pipe, b".")
            time.sleep(look_s)
        assert watched.kills == []
    finally:
        watched.close()


def played(
    monkeypatch: pytest.MonkeyPatch, states: str, *, beats: int = 0, left_alone: str = "t"
) -> list[tuple[int, str]]:
    """What a guard does, and at which glance, that finds the daemon in one of `states` at each; a beat every `beats` glances."""
    far, pipe = os.pipe()
    seen: list[str] = []
    done: list[tuple[int, str]] = []

    def look(stat: int) -> str:
        if len(seen) == len(states):
            os.close(pipe)
            return ""
        seen.append(states[len(seen)])
        if beats and len(seen) % beats == 0:
            os.write(pipe, b".")
        return seen[-1]

    monkeypatch.setattr(guard_module, "state_in", look)
    watch(
        far,
        os.getpid(),
        lambda pid, number: done.append((len(seen), signal.Signals(number).name)),
        0.0,
        on_resume=lambda: done.append((len(seen), "told")),
        left_alone=left_alone,
    )
    os.close(far)
    return done


def test_a_stop_is_seen_in_a_fraction_of_a_second_and_told_before_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within one look at the beat, so that no heartbeat of 2 s is missed; told first, so that the first beat after it knows."""
    assert STOPPED_LOOKS < GLANCES
    assert played(monkeypatch, "SS" + "T" * STOPPED_LOOKS + "SS", beats=GLANCES) == [(4, "told"), (4, "SIGCONT")]


def test_who_stops_it_and_lets_it_go_on_at_once_is_let_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Single glances that find it stopped, however many."""
    assert played(monkeypatch, "TS" * 5 * GLANCES, beats=GLANCES) == []


@pytest.mark.parametrize(("states", "left_alone"), [("t", "t"), ("T", "tT")], ids=["debugger", "terminal"])
def test_a_daemon_that_somebody_else_has_is_let_alone(
    monkeypatch: pytest.MonkeyPatch, states: str, left_alone: str
) -> None:
    """A debugger, or in a terminal the shell: neither let go on nor ended, however long."""
    assert played(monkeypatch, states * 3 * SILENT_LOOKS * GLANCES, left_alone=left_alone) == []


def test_a_starved_daemon_is_let_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """One beat in almost as long as silence is borne; with no beat at all it is ended, and not a glance earlier."""
    most = SILENT_LOOKS * GLANCES
    assert played(monkeypatch, "R" * 5 * most, beats=most - GLANCES) == []
    assert played(monkeypatch, "D" * 5 * most) == [(most, "SIGKILL")]


BEATING = """
import time
from phm.core.watchdog import DaemonWatchdog
guard = DaemonWatchdog()
guard.start()
print("beats", flush=True)
while not guard.beat():
    time.sleep(0.02)
print("was let go on", flush=True)
guard.close()
"""


def test_a_daemon_that_was_let_go_on_knows_it() -> None:
    """With the guard as it runs: stopped, continued by it, and told so."""
    with subprocess.Popen([sys.executable, "-c", BEATING], stdout=subprocess.PIPE, stdin=subprocess.DEVNULL) as daemon:
        limit = threading.Timer(LIMIT_S, daemon.kill)
        limit.start()
        try:
            assert daemon.stdout is not None
            assert daemon.stdout.readline() == b"beats\n"
            daemon.send_signal(signal.SIGSTOP)
            assert daemon.stdout.readline() == b"was let go on\n"
            assert daemon.wait() == 0
        finally:
            limit.cancel()
            daemon.kill()


def test_the_guard_goes_with_the_daemon() -> None:
    """Closed pipe, no process left."""
    guard = DaemonWatchdog()
    guard.start()
    process = guard._process
    assert process is not None
    guard.beat()
    guard.close()
    guard.close()
    assert process.wait(LIMIT_S) == 0
    assert guard.problem == ""


def test_a_guard_that_cannot_start_or_dies_is_a_problem_and_no_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM runs without it and says so; switched off it is no problem."""
    guard = DaemonWatchdog(("/nonexistent/python",))
    guard.start()
    guard.beat()
    assert "cannot be started" in guard.problem
    dead = DaemonWatchdog((sys.executable, "-S", "-c", ""))
    dead.start()

    def noticed() -> str:
        dead._wrote_at = float("-inf")
        dead.beat()
        return dead.problem

    until(noticed, "the problem")
    assert "has exited" in dead.problem
    monkeypatch.setenv("PHM_WATCHDOG", "off")
    off = DaemonWatchdog(("/nonexistent/python",))
    off.start()
    assert off.problem == ""


def test_an_end_without_a_word_is_known_at_the_next_start(tmp_path: Path) -> None:
    """Not at the first start, not after an orderly end, not after a power cut of the machine."""
    assert not ShutdownMarker(str(tmp_path), "boot-1").begin()
    assert ShutdownMarker(str(tmp_path), "boot-1").begin()
    assert not ShutdownMarker(str(tmp_path), "boot-2").begin()
    ShutdownMarker(str(tmp_path), "boot-2").end()
    assert not ShutdownMarker(str(tmp_path), "boot-2").begin()


def test_without_a_folder_to_write_to_nothing_is_said(tmp_path: Path) -> None:
    """Cannot tell: somebody else tells about the folder."""
    file = tmp_path / "file"
    file.touch()
    end = ShutdownMarker(str(file / "below"), "boot-1")
    assert not end.begin()
    end.end()
    assert not end.begin()
