"""The daemon's main loop: what it reports about a pause, and that it sleeps while nothing waits."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.api import Level
from phm.core.model import UnitState
from phm.core.watchdog import DaemonWatchdog
from phm.runtime.daemon import Daemon
from phm.runtime.main_loop import IDLE_S
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from tests.fakes.until import until

LIMIT_S = 20.0


class FakeWatchdog(DaemonWatchdog):
    """A watchdog that reports a resume when the test sets it, and counts iterations of the main loop."""

    def __init__(self) -> None:
        super().__init__()
        self.resumed = threading.Event()
        self.iterations = 0

    def beat(self) -> bool:
        self.iterations += 1
        reported = self.resumed.is_set()
        self.resumed.clear()
        return reported


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[tuple[Daemon, FakeWatchdog]]:
    guard = FakeWatchdog()
    made = settings(
        state_dir=str(tmp_path / "state"),
        run_dir=str(tmp_path / "run"),
        log={"directory": str(tmp_path / "log")},
        checks={"host": {"enabled": False}},
        containers=[],
        ros={"nodes": [], "topics": []},
    )
    daemon = build_daemon(made, watchdog=guard)
    daemon.start()
    yield daemon, guard
    daemon.stop()


def companion(daemon: Daemon) -> UnitState:
    (state,) = [state for state in daemon.pipeline.states() if state.unit == "companion"]
    return state


def test_a_resume_is_reported_however_short_the_suspension(daemon: tuple[Daemon, FakeWatchdog]) -> None:
    """The watchdog knows it; without it only a pause of several seconds would be evidence."""
    made, guard = daemon
    until(lambda: companion(made).level is Level.OK, "an OK companion")
    guard.resumed.set()
    until(lambda: companion(made).level is Level.WARN, "the report of the suspension")
    assert companion(made).result.condition == "phm_suspended"
    assert "SIGSTOP" in companion(made).result.summary


def test_the_main_loop_sleeps_while_idle_and_runs_when_woken(daemon: tuple[Daemon, FakeWatchdog]) -> None:
    """Twice a second when idle; each wake-up, as by a change or a SIGCONT, is an immediate iteration, without limit."""
    made, guard = daemon
    until(lambda: made.pipeline.complete and not made.pipeline.waiting, "nothing to wait for")
    began, before = time.monotonic(), guard.iterations
    until(lambda: guard.iterations >= before + 4, "four iterations")
    assert time.monotonic() - began > 2 * IDLE_S, "more than ten times a second: it does not sleep"
    before = guard.iterations

    def called() -> bool:
        made.wake()
        return guard.iterations >= before + 50

    until(called, "fifty iterations, which would take 25 s without wake-ups", limit_s=LIMIT_S)
    assert made.components.health.alive()
