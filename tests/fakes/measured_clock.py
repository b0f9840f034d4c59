"""The clock of a daemon within the process of the tests: it knows how late this process is, as that of `phm run` does.

On a busy machine the process of the tests, with the senders that PHM listens to, may find no CPU for seconds.
"""

from __future__ import annotations

from functools import cache

from phm.core.clock import SystemClock
from phm.core.scheduling_delay import SchedulingDelay


@cache
def _lateness() -> SchedulingDelay:
    """Of this process, measured by one thread from the first call on."""
    clock = SystemClock()
    clock.measure()
    return clock.lateness


def measured_clock() -> SystemClock:
    """A new clock with the measurement that all of them share."""
    made = SystemClock()
    made.lateness = _lateness()
    return made
