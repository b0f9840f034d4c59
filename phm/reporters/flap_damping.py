"""Holds down what flaps: a unit that fails and recovers again and again would speak for ever and say nothing new. Pure.

A unit of which MANY changes were told within WITHIN_S is told once more, as flapping, and then not until it has not
changed for CALM_S; then its state is told if it is not what was told last. Nothing is hidden meanwhile: the status
word and the refresh show each change, and the log has all of them.
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
    """The newest line that was not sent; None while nothing is held down."""
    holding: bool = False
    changed: float = 0.0


class FlapDamper:
    """Between what there is to say and what is said. Lines are told apart by their key."""

    def __init__(self) -> None:
        self._units: dict[str, _Unit] = {}

    def filter(self, lines: Sequence[StatusTextLine], now: float, flapping: str) -> list[StatusTextLine]:
        """What of these changes is told now. flapping: the text to tell when a unit begins to be held down."""
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
        """The state of units that have come to rest, to be told now."""
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
