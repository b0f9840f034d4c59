"""A level from two limits over a window: it rises only while the newest part is also bad, and ends when the entire window is calm.

Not a check: files in this folder whose names start with an underscore are parts of checks.
"""

from __future__ import annotations

from phm.api import Level

STAYS = 0.7
"""A level ends only below this share of its limit."""


class WindowThreshold:
    def __init__(self, warn: float, error: float) -> None:
        self._warn, self._error = warn, error
        self._level = Level.OK

    def level(self, over_window: float | None, newest: float | None) -> Level:
        """over_window: mean over the window; newest: mean over its last part, about one second. None: not available."""
        self._level = Level.OK if over_window is None else self._judge(over_window, newest)
        return self._level

    def _judge(self, mean: float, newest: float | None) -> Level:
        calm = self._warn * STAYS
        if newest is not None and newest < calm:
            return self._level if self._level.bad and mean >= calm else Level.OK
        if mean >= self._error or (self._level is Level.ERROR and mean >= STAYS * self._error):
            return Level.ERROR
        return Level.WARN if mean >= self._warn or (self._level.bad and mean >= calm) else Level.OK
