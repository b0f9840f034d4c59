"""The daemon's heart: what it says of a pause, and that it rests while nothing waits."""

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
from phm.testing import settings
from tests.fakes.until import until

LIMIT_S = 20.0


class Told(DaemonWatchdog):
    """A guard that has let PHM go on when the test says so; counts the beats that it hears."""

    def __init__(self) -> None:
        super().__init__()
        self.let_go = threading.Event()
        self.beats = 0

    def beat(self) -> bool:
        self.beats += 1
        told = self.let_go.is_set()
        self.let_go.clear()
        return told


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[tuple[Daemon, Told]]:
    guard = Told()
    made = settings(
        state_dir=str(tmp_path / "state"),
        run_dir=str(tmp_path / "run"),
        log={"directory": str(tmp_path / "log")},
        checks={"host": {"enabled": False}},
        containers=[],
        ros={"nodes": [], "topics": []},
    )
    daemon = Daemon(made, watchdog=guard)
    daemon.start()
    yield daemon, guard
    daemon.stop()


def companion(daemon: Daemon) -> UnitState:
    (state,) = [state for state in daemon.pipeline.states() if state.unit == "companion"]
    return state


def test_that_it_was_let_go_on_is_told_however_short_it_stood_still(daemon: tuple[Daemon, Told]) -> None:
    """Its guard knows; a pause of the heart alone would have to last seconds to prove anything."""
    made, guard = daemon
    until(lambda: companion(made).level is Level.OK, "a companion that is well")
    guard.let_go.set()
    until(lambda: companion(made).level is Level.WARN, "the word that it was stopped")
    assert companion(made).result.condition == "phm_suspended"
    assert "SIGSTOP" in companion(made).result.summary


def test_the_heart_rests_while_nothing_waits_and_beats_when_called(daemon: tuple[Daemon, Told]) -> None:
    """Twice a second then; a call, as a change or a SIGCONT makes it, is a beat at once, without end if need be."""
    made, guard = daemon
    until(lambda: made.pipeline.complete and not made.pipeline.waiting, "nothing to wait for")
    began, before = time.monotonic(), guard.beats
    until(lambda: guard.beats >= before + 4, "four beats")
    assert time.monotonic() - began > 2 * IDLE_S, "more than ten times a second: it does not rest"
    before = guard.beats

    def called() -> bool:
        made.wake()
        return guard.beats >= before + 50

    until(called, "fifty beats, which its rests alone would make 25 s", limit_s=LIMIT_S)
    assert made.components.health.alive()
