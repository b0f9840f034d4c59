"""A level from two limits, with hysteresis against flapping.

Not a check: files in this folder whose names start with an underscore are parts of checks.
"""

from __future__ import annotations

from phm.api import Level

MARGIN = 0.05
"""A level ends only once the value is below its limit by this share of the limit, so that a value at the limit does not flap."""


class Threshold:
    """A level from two limits, with state: it rises at the limit, and falls only below the limit minus the margin."""

    def __init__(self, warn: float, error: float) -> None:
        self._limits = ((Level.ERROR, error), (Level.WARN, warn))
        self._level = Level.OK

    def level(self, value: float) -> Level:
        for level, limit in self._limits:
            stays = self._level is Level.ERROR or self._level is level
            if value >= limit * (1 - MARGIN if stays else 1.0):
                self._level = level
                return level
        self._level = Level.OK
        return Level.OK
