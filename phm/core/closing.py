"""Ends parts one after the other within one budget of time.

Docker kills what has not ended 10 s after SIGTERM. Whatever hangs, an engine, a disk, a plug-in, costs its own share of the budget;
the farewell of the others is still sent.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from phm.core import threads
from phm.core.clock import Clock

logger = logging.getLogger(__name__)

LEAST_S = 0.05
"""Each step has at least this long, also when the budget is used up."""


class Closing:
    """`hung` names the steps that did not come back; their threads are left to the end of the process."""

    def __init__(self, clock: Clock, budget_s: float) -> None:
        self._clock, self._end = clock, clock.mono() + budget_s
        self.hung: list[str] = []

    def step(self, name: str, call: Callable[[], object], limit_s: float) -> None:
        """Run `call` to its end, for at most `limit_s` and what is left of the budget. Never raises."""
        done = threading.Event()

        def run() -> None:
            try:
                call()
            except Exception:  # the others are still to be closed
                logger.exception("%s did not close", name)
            finally:
                done.set()

        if not threads.start_now(threading.Thread(target=run, name=f"phm-close-{name}", daemon=True)):
            run()
        left_s = self._end - self._clock.mono()
        if not self._clock.wait(done, max(LEAST_S, min(limit_s, left_s))):
            self.hung.append(name)
