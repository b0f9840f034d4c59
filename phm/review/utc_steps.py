"""Steps of the UTC of a run against its monotonic clock."""

from __future__ import annotations

STEP_S = 0.2
"""A change of the difference between the two clocks of this size is a step."""
MOST_STEPS = 1000


def note(clock: list[tuple[float, float]], mono: float, utc_s: float) -> None:
    """Keep the difference of UTC and monotonic time if it is the first or another one. clock: as in `Run.clock`."""
    difference = utc_s - mono
    if (not clock or abs(difference - clock[-1][1]) > STEP_S) and len(clock) < MOST_STEPS:
        clock.append((mono, difference))
