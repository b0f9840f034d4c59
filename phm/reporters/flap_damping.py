"""Flap damping: limits the lines about a unit that fails and recovers repeatedly. Pure.

A unit with MANY failures and recoveries within WITHIN_S is reported once more, as flapping, and then suppressed until it has
neither failed nor recovered for CALM_S; then its state is reported again. A failure worse than those reported is sent even then.
Nothing is hidden meanwhile: the status word and the refresh show each change, and the log has all of them.

Changed texts of a failure that lasts do not count. After MANY of them the newest is sent every CALM_S, as a refresh: as changes,
the texts of one unit would use up the budget of an agent of a large swarm. A text after RARE_S without one is a change again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from phm.core.rate_limiter import TokenBucket
from phm.reporters.statustext import StatusTextLine
from phm.transport.priority import MessagePriority
from phm.wire.status_line import Severity

MANY, WITHIN_S = 6, 60.0
"""Three failures and three recoveries within a minute."""
CALM_S = 30.0
RARE_S = 600.0
MAX_UNITS = 1000


@dataclass(slots=True)
class _Unit:
    texts: TokenBucket
    """How many changed texts of the same state may be sent now."""
    texts_sent: int = 0
    """Changed texts since the last failure or recovery, or since there was none for RARE_S."""
    text_at: float = float("-inf")
    changes: deque[tuple[float, Severity]] = field(default_factory=lambda: deque(maxlen=MANY))
    severity: Severity | None = None
    """Of the newest line, also if that was suppressed."""
    begun: bool = False
    """The next line is of a new fault."""
    worst: Severity = Severity.INFO
    """Of the lines sent since it began to flap."""
    held: StatusTextLine | None = None
    """The newest suppressed line; None if there is none."""
    flaps: bool = False


class FlapDamper:
    """Passes or suppresses lines by their key. Not thread-safe."""

    def __init__(self, *, every_line: bool = False) -> None:
        """every_line: each line is a failure or a recovery, also one with the severity of the line before."""
        self._every_line = every_line
        self._units: dict[str, _Unit] = {}

    def filter(self, lines: Sequence[StatusTextLine], now: float, flapping: str) -> list[StatusTextLine]:
        """The lines to send now. flapping: the text of the line that is sent when suppression of a unit begins."""
        return [passed for line in lines if (passed := self._pass(line, now, flapping)) is not None]

    def begin_failure(self, key: str) -> None:
        """The next line about this unit is of a new fault, whatever its severity. The end of the one before may have had no line."""
        if (unit := self._units.get(key)) is not None:
            unit.begun = True

    def settled(
        self, now: float, still_true: Callable[[StatusTextLine], bool] = lambda line: True
    ) -> list[StatusTextLine]:
        """The lines to send about units that are stable again, and the texts that were held back for long enough.

        still_true: whether a line that was held back may be sent now. One that may not waits on, until a newer one replaces it.
        """
        passed = []
        for unit in self._units.values():
            stable = unit.flaps and now - unit.changes[-1][0] >= CALM_S
            if stable:
                unit.flaps = False
                unit.changes.clear()
            if unit.flaps or unit.held is None or not still_true(unit.held):
                continue
            if stable:
                passed.append(unit.held)
            elif _may_send_text(unit, now):
                passed.append(_text(unit, unit.held, now))
            else:
                continue
            unit.held = None
        return passed

    def _pass(self, line: StatusTextLine, now: float, flapping: str) -> StatusTextLine | None:
        unit = self._unit(line.key, now)
        before, unit.severity = unit.severity, line.severity
        begun, unit.begun = unit.begun and line.severity <= Severity.WARNING, False
        changed = self._every_line or begun or line.severity != before
        if changed:
            unit.changes.append((now, line.severity))
            unit.texts_sent = 0
        if _suppressed(unit, line, now, changed=changed):
            unit.held = line
            return None
        # A worsening is not replaced by a warning: suppression begins with the next line.
        worse = before is not None and line.severity < before
        if changed and not unit.flaps and not worse and _flaps(unit, now):
            unit.flaps, unit.held = True, line
            unit.worst = min(severity for _, severity in unit.changes)
            return StatusTextLine(line.key, Severity.WARNING, flapping)
        unit.held, unit.worst = None, line.severity
        return line if changed else _text(unit, line, now)

    def _unit(self, key: str, now: float) -> _Unit:
        unit = self._units.pop(key, None) or _Unit(TokenBucket(MANY, now))
        self._units[key] = unit
        if len(self._units) > MAX_UNITS:
            del self._units[next(iter(self._units))]
        return unit


def _suppressed(unit: _Unit, line: StatusTextLine, now: float, *, changed: bool) -> bool:
    if unit.flaps:
        return line.severity >= unit.worst
    return not changed and not _may_send_text(unit, now)


def _flaps(unit: _Unit, now: float) -> bool:
    return len(unit.changes) == MANY and now - unit.changes[0][0] <= WITHIN_S


def _text(unit: _Unit, line: StatusTextLine, now: float) -> StatusTextLine:
    """A changed text to send now."""
    unit.texts_sent = 1 if now - unit.text_at >= RARE_S else unit.texts_sent + 1
    unit.text_at = now
    return line if unit.texts_sent <= MANY else replace(line, kind=MessagePriority.REFRESH)


def _may_send_text(unit: _Unit, now: float) -> bool:
    unit.texts.refill(now, 1 / CALM_S, MANY)
    return unit.texts.take()
