"""What tests of the simulated swarm share."""

from __future__ import annotations

import time
from collections.abc import Callable

LIMIT_S = 20.0


def until(done: Callable[[], bool], limit_s: float = LIMIT_S) -> bool:
    """Ask again and again; the limit only bounds a failure."""
    end = time.monotonic() + limit_s
    while not done():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True
