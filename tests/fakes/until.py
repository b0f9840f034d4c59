"""The wait of all tests: poll an observable condition, with a limit that only bounds a failing test."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

LIMIT_S = 120.0
POLL_S, POLL_MOST_S = 0.01, 0.05


def until(
    condition: Callable[[], Any],
    what: str = "the condition",
    seen: Callable[[], object] | None = None,
    *,
    limit_s: float = LIMIT_S,
    poll_s: float | None = None,
    step: Callable[[], object] | None = None,
) -> Any:
    """Return the first true value of `condition`. After each false one call `step`, or without one wait for `poll_s`: longer where each
    look is expensive, e.g. a question to the Docker Engine. Without `poll_s` the waits grow from POLL_S to POLL_MOST_S: on a busy machine
    the looks of a long wait would take the CPU from what is waited for.

    After `limit_s` seconds of real time, fail with what was waited for and what was `seen` instead.
    """
    end_s, pause_s = time.monotonic() + limit_s, POLL_S if poll_s is None else poll_s
    while not (value := condition()):
        if time.monotonic() > end_s:
            instead = "" if seen is None else f"; seen: {seen()}"
            raise AssertionError(f"waited {limit_s:g} s for {what}{instead}")
        if step is None:
            time.sleep(pause_s)
            if poll_s is None:
                pause_s = min(POLL_MOST_S, 1.2 * pause_s)
        else:
            step()
    return value
