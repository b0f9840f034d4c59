"""A level by two limits that does not flap. Not a check: files of this folder that begin with an underscore are parts of checks."""

from __future__ import annotations

from phm.api import Level

MARGIN = 0.05
"""A level is left only when the value is this share of the limit below it, so that a value at the limit does not flap."""


class Threshold:
    """A level by two limits, with memory: up at the limit, down only below limit minus margin."""

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
