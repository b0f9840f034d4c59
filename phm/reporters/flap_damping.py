"""Flap damping: limits the lines about a unit that fails and recovers repeatedly. Pure.

A unit with MANY reported changes within WITHIN_S is reported once more, as flapping, and then suppressed until it has not
changed for CALM_S; then its state is reported again. Nothing is hidden meanwhile: the status word and the refresh show each
change, and the log has all of them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from phm.reporters.statustext import StatusTextLine
from phm.wire.status_line import Severity

MANY, WITHIN_S = 6, 60.0
"""Three failures and three recoveries within a minute."""
CALM_S = 30.0
MAX_UNITS = 1000


@dataclass(slots=True)
class _Unit:
    times: deque[float] = field(default_factory=lambda: deque(maxlen=MANY))
    held: StatusTextLine | None = None
    """The newest suppressed line; None if there is none."""
    holding: bool = False
    changed: float = 0.0


class FlapDamper:
    """Passes or suppresses lines by their key. Not thread-safe."""

    def __init__(self) -> None:
        self._units: dict[str, _Unit] = {}

    def filter(self, lines: Sequence[StatusTextLine], now: float, flapping: str) -> list[StatusTextLine]:
        """The lines to send now. flapping: the text of the line that is sent when suppression of a unit begins."""
        passed: list[StatusTextLine] = []
        for line in lines:
            unit = self._unit(line.key)
            unit.changed = now
            if unit.holding:
                unit.held = line
                continue
            unit.times.append(now)
            if len(unit.times) == MANY and now - unit.times[0] <= WITHIN_S:
                unit.holding, unit.held = True, line
                passed.append(StatusTextLine(line.key, Severity.WARNING, flapping))
            else:
                passed.append(line)
        return passed

    def settled(self, now: float) -> list[StatusTextLine]:
        """The lines to send about units that are stable again."""
        passed = []
        for unit in self._units.values():
            if unit.holding and now - unit.changed >= CALM_S:
                unit.holding = False
                unit.times.clear()
                if unit.held is not None:
                    passed.append(unit.held)
                unit.held = None
        return passed

    def _unit(self, key: str) -> _Unit:
        unit = self._units.pop(key, None) or _Unit()
        self._units[key] = unit
        if len(self._units) > MAX_UNITS:
            del self._units[next(iter(self._units))]
        return unit
