"""The daemon's main loop: what it reports about a pause, and that it sleeps while nothing waits."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest

from phm.api import Level
from phm.core.model import UnitState
from phm.core.watchdog import DaemonWatchdog
from phm.runtime.daemon import Daemon
from phm.runtime.main_loop import IDLE_S
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from tests.fakes.measured_clock import measured_clock
from tests.fakes.until import until


class FakeWatchdog(DaemonWatchdog):
    """A watchdog that reports a resume when the test sets it, and counts iterations of the main loop."""

    def __init__(self) -> None:
        super().__init__()
        self.resumed = threading.Event()
        self.iterations = 0
        self.waiting: Callable[[], bool] = lambda: False
        self.idle: list[float] = []
        """When the newest iterations in a row began, before all of which nothing waited (monotonic seconds)."""

    def heartbeat(self) -> bool:
        self.iterations += 1
        self.idle = [] if self.waiting() else [*self.idle, time.monotonic()]
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
    daemon = build_daemon(made, measured_clock(), watchdog=guard)
    guard.waiting = lambda: daemon.pipeline.waiting
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

    def reported() -> UnitState | None:
        """On a busy machine PHM may report another pause, too, which was long."""
        state = companion(made)
        return state if state.level is Level.WARN and "SIGSTOP" in state.result.summary else None

    state = until(reported, "the report of the suspension", lambda: companion(made))
    assert state.result.condition == "phm_suspended"


def test_the_main_loop_sleeps_while_idle_and_runs_when_woken(daemon: tuple[Daemon, FakeWatchdog]) -> None:
    """Twice a second when idle; each wake-up, as by a change or a SIGCONT, is an immediate iteration, without limit."""
    made, guard = daemon
    until(lambda: made.pipeline.complete and not made.pipeline.waiting, "nothing to wait for")

    def sleeps() -> bool:
        """By the median: a busy machine delays some iterations, and what it changes causes others."""
        idle = guard.idle[-7:]
        return len(idle) == 7 and median(after - before for before, after in pairwise(idle)) > 0.6 * IDLE_S

    until(sleeps, "iterations twice a second instead of ten times", lambda: guard.idle[-7:])
    before = guard.iterations

    def called() -> bool:
        made.wake()
        return guard.iterations >= before + 300

    until(called, "three hundred iterations, which would take 150 s without wake-ups", poll_s=0.01)
    until(made.components.health.alive, "a main loop that runs")
