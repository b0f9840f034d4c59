"""Whether the measured load of the machine confirms an alarm about it. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sitl.campaign.trial import Alarm, Load

BEFORE_S, AFTER_S = 12.0, 1.5
"""PHM's longest window for a `host` unit is 10 s; the campaign samples once a second."""
Reading = Callable[[Load], "float | None"]
LIMITS: dict[str, tuple[Reading, float]] = {
    "host/cpu": (lambda load: load.cpu, 98.0),
    "host/memory": (lambda load: load.memory, 95.0),
    "host/disk": (lambda load: load.disk, 95.0),
    "host/io": (lambda load: load.io_stalled, 95.0),
}
"""The limit for ERROR in the shipped configuration: an alarm is an ERROR. What is not listed cannot be confirmed."""
SAMPLES = 2
"""Samples in a row that must be at the limit: a single one may be the campaign's own work."""


def confirmed(alarm: Alarm, loads: Sequence[Load]) -> bool:
    """Whether the load was at its limit shortly before the alarm. Without samples nothing is confirmed."""
    reading, limit = LIMITS.get(alarm.unit, (None, 0.0))
    if reading is None:
        return False
    near = [load for load in loads if -BEFORE_S <= load.mono - alarm.mono <= AFTER_S]
    high = [value is not None and value >= limit for value in map(reading, near)]
    return any(all(high[start : start + SAMPLES]) for start in range(len(high) - SAMPLES + 1))
