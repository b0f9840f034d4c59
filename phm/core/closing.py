"""Shut down components one after the other within a total time budget.

A component that hangs uses up only its own limit, so the others are still closed.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from phm.core import threads
from phm.core.clock import Clock

logger = logging.getLogger(__name__)

MIN_STEP_S = 0.05
"""Minimum time for each step while the reserve lasts."""
RESERVE_S = 1.5
"""Part of the budget that hanging components do not use up: MIN_STEP_S for each of 30 others."""


class ShutdownSequence:
    """All steps together wait at most `budget_s`. `hung` names those that did not return; their threads end with the process."""

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
        left_s = max(0.0, self._end - self._clock.mono())
        if not self._clock.wait(done, min(limit_s, max(left_s - RESERVE_S, min(MIN_STEP_S, left_s)))):
            self.hung.append(name)
