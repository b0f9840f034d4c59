"""Shut down components one after the other within a total time budget.

Docker kills what has not exited 10 s after SIGTERM. A component that hangs uses up only its own limit, so the others are still
closed.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from phm.core import threads
from phm.core.clock import Clock

logger = logging.getLogger(__name__)

MIN_STEP_S = 0.05
"""Minimum time for each step, even when the budget is used up."""


class ShutdownSequence:
    """`hung` names the steps that did not return; their threads end with the process."""

    def __init__(self, clock: Clock, budget_s: float) -> None:
        self._clock, self._end = clock, clock.mono() + budget_s
        self.hung: list[str] = []

    def step(self, name: str, call: Callable[[], object], limit_s: float) -> None:
        """Run `call`, waiting at most `limit_s` and the rest of the budget. Never raises."""
        done = threading.Event()

        def run() -> None:
            try:
                call()
            except Exception:  # the other components must still be closed
                logger.exception("closing %s failed", name)
            finally:
                done.set()

        if not threads.start_now(threading.Thread(target=run, name=f"phm-close-{name}", daemon=True)):
            run()
        left_s = self._end - self._clock.mono()
        if not self._clock.wait(done, max(MIN_STEP_S, min(limit_s, left_s))):
            self.hung.append(name)
