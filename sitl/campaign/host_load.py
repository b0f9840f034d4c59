"""Whether the measured load of the machine confirms an alarm about it. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from phm.core.settings import HostSettings, PressureSettings
from sitl.campaign.trial import Alarm, Load

LATE_S = 1.0
"""PHM publishes an alarm at most so long after the window that it is about: it asks the Docker Engine first."""
READING_S = 1.0
"""Between two readings of PHM, and the window of a figure that it does not average."""
_HOST = HostSettings()
BEFORE_S = _HOST.cpu_window + LATE_S + READING_S
"""How long before an alarm samples matter."""
Reading = Callable[[Load], "float | None"]


@dataclass(frozen=True)
class Measure:
    """How PHM measures a unit: the limit for ERROR in the shipped configuration, as an alarm is one, and the windows of its mean."""

    reading: Reading
    limit: float
    windows_s: tuple[float, ...] = (READING_S,)


MEASURES = {
    "host/cpu": Measure(lambda load: load.cpu, _HOST.cpu.error, (_HOST.cpu_quick, _HOST.cpu_window)),
    "host/memory": Measure(lambda load: load.memory, _HOST.memory.error),
    "host/disk": Measure(lambda load: load.disk, _HOST.disk.error),
    "host/io": Measure(lambda load: load.io_stalled, PressureSettings().host_io.error),
}
"""What is not listed cannot be confirmed. The kernel averages `host/io` itself."""


def confirmed(alarm: Alarm, loads: Sequence[Load]) -> bool:
    """Whether the mean load was at its limit over PHM's own window before the alarm. Where samples do not cover the window, nothing is
    confirmed.

    The campaign samples at other moments than PHM reads, so the use within one sample counts as even.
    """
    measure = MEASURES.get(alarm.unit)
    if measure is None:
        return False
    last, first = alarm.mono, alarm.mono - LATE_S
    # The mean is largest where the window begins or ends with a sample, or at an end of the allowed time.
    for window_s in measure.windows_s:
        ends = {first, last, *(each.mono + shift for each in loads for shift in (0.0, window_s))}
        means = (_mean(measure.reading, loads, end - window_s, end) for end in ends if first <= end <= last)
        if any(mean is not None and mean >= measure.limit for mean in means):
            return True
    return False


def _mean(reading: Reading, loads: Sequence[Load], begin: float, end: float) -> float | None:
    """The mean between two times; None if samples do not cover it. A sample is about the time since the one before it."""
    total = covered_s = 0.0
    for before, load in pairwise(loads):
        inside_s = min(end, load.mono) - max(begin, before.mono)
        value = reading(load)
        if inside_s > 0 and value is not None:
            total, covered_s = total + inside_s * value, covered_s + inside_s
    return total / covered_s if covered_s > 0 and covered_s >= end - begin - _ROUNDING_S else None


_ROUNDING_S = 0.005
"""Times in a record have milliseconds."""
