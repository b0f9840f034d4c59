"""The daemon's main loop: begins passes, ends settle times, detects overdue checks, and shows the watchdog that PHM runs."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass

from phm.checking.pipeline import Pipeline
from phm.checking.scheduler import WATCH_S, CheckScheduler
from phm.core import threads
from phm.core.clock import Clock
from phm.core.watchdog import DaemonWatchdog

logger = logging.getLogger(__name__)

SUSPENDED_S = 2.5
"""A pause of the loop this much longer than planned is reported. One that the watchdog ended is reported however short it was."""
IDLE_S = 0.5
"""Wait between two iterations while no unit settles and no action runs. `wake` ends it early."""


@dataclass(frozen=True, slots=True)
class Suspension:
    """The last time that PHM did not run. at: monotonic seconds when it ran again; stopped: by SIGSTOP."""

    at: float
    duration_s: float
    stopped: bool


class MainLoop:
    """One thread. caught_up: whether all Docker events are applied. on_suspended: called after PHM was suspended."""

    def __init__(
        self,
        interval_s: float,
        clock: Clock,
        scheduler: CheckScheduler,
        pipeline: Pipeline,
        caught_up: Callable[[], bool],
        on_suspended: Callable[[], None],
        watchdog: DaemonWatchdog | None,
    ) -> None:
        self._interval_s, self._clock, self._scheduler, self._pipeline = interval_s, clock, scheduler, pipeline
        self._caught_up, self._on_suspended, self._watchdog = caught_up, on_suspended, watchdog
        self.last_iteration = clock.mono()
        """Monotonic seconds."""
        self.suspension: Suspension | None = None
        self._stop, self._wake = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-main-loop", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def wake(self) -> None:
        """Run an iteration now: a unit begins to settle, or PHM was stopped and continues."""
        self._wake.set()

    def stop(self) -> None:
        """Have the thread end; does not wait for it."""
        self._stop.set()
        self._wake.set()

    def join(self, timeout_s: float) -> None:
        threads.join(self._thread, timeout_s)

    def _loop(self) -> None:
        next_pass = self.last_iteration = self._clock.mono()  # the time that the start took is not a suspension
        wait_s = 0.0
        while not self._stop.is_set():
            idle_s = WATCH_S
            try:
                now = self._clock.mono()
                self._note_suspension(now, wait_s)
                if now >= next_pass:
                    self._pipeline.begin_pass()
                    next_pass = max(next_pass + self._interval_s, now)
                idle_s = min(IDLE_S, self._scheduler.report_overdue(), next_pass - now)
                if self._caught_up():
                    self._pipeline.tick()
            except Exception:  # passes and deadlines depend on this thread, so a defect must not end it
                logger.exception("main-loop iteration failed")
            wait_s = WATCH_S if self._pipeline.waiting else max(WATCH_S, idle_s)
            self._clock.wait(self._wake, wait_s)
            self._wake.clear()

    def _note_suspension(self, now: float, waited_s: float) -> None:
        stopped = self._watchdog is not None and self._watchdog.heartbeat()
        paused_s, self.last_iteration = now - self.last_iteration, now
        if stopped or paused_s - waited_s > SUSPENDED_S:
            self.suspension = Suspension(now, paused_s, stopped)
            self._on_suspended()
