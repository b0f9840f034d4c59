"""The wait of all tests: poll an observable condition, with a limit that only bounds a failing test."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

LIMIT_S = 120.0
POLL_S = 0.01


def until(
    condition: Callable[[], Any],
    what: str = "the condition",
    seen: Callable[[], object] | None = None,
    *,
    limit_s: float = LIMIT_S,
    poll_s: float = POLL_S,
    step: Callable[[], object] | None = None,
) -> Any:
    """Return the first true value of `condition`. After each false one call `step`, or without one wait for `poll_s`: longer where each
    look is expensive, e.g. a question to the Docker Engine.

    After `limit_s` seconds of real time, fail with what was waited for and what was `seen` instead.
    """
    end_s = time.monotonic() + limit_s
    while not (value := condition()):
        if time.monotonic() > end_s:
            instead = "" if seen is None else f"; seen: {seen()}"
            raise AssertionError(f"waited {limit_s:g} s for {what}{instead}")
        if step is None:
            time.sleep(poll_s)
        else:
            step()
    return value
