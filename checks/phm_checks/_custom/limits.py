"""Compares a value with the limits of an entry: types `topic` and `mavlink`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from phm import api
from phm.api import Level
from phm_checks._custom.base import Finding
from phm_checks._text import clean

MAX_TEXT = 60
WHOLE = 1e12


@dataclass(frozen=True)
class Reading:
    """low, high: lowest and highest of all values; None: none is a number. nan: whether one of them is NaN. text: of a text
    field. unit: as written behind a number."""

    low: float | None = None
    high: float | None = None
    nan: bool = False
    text: str = ""
    unit: str = ""

    def shown(self, number: float) -> str:
        return f"{plain(number)}{f' {self.unit}' if self.unit else ''}"


def judge(entry: Any, what: str, reading: Reading, **values: api.Value) -> Finding:
    """The finding about one field. what: its name in sentences. Raises CannotTell if there is no value to compare."""
    low, high = reading.low, reading.high
    if reading.nan and entry.needs_number:
        return Finding(Level.ERROR, f"{what} is NaN, expected a number", "NaN", values)
    if low is None or high is None:
        return _text(entry, what, reading, values)
    values = {"value": low, **({"highest": high} if high != low else {}), **values}
    if isinstance(entry.equals, str):
        raise api.CannotTell(
            f"{what} is a number, and custom.equals is the text {entry.equals!r}: compare it with a number"
        )
    wrong = _wrong(entry, low, high)
    if wrong is not None:
        level, number, allowed = wrong
        text = f"{what} is {reading.shown(number)}, allowed is {allowed}"
        return Finding(level, text, f"is {reading.shown(number)}", values)
    shown = reading.shown(low) if low == high else f"{plain(low)} to {reading.shown(high)}"
    return Finding(Level.OK, f"{what} is {shown}", values=values)


def _text(entry: Any, what: str, reading: Reading, values: dict[str, api.Value]) -> Finding:
    text = clean(reading.text, MAX_TEXT)
    if entry.needs_number:
        raise api.CannotTell(f"{what} has no number to compare with the limits")
    values = {"value": text, **values}
    if entry.equals is not None and reading.text != entry.equals:
        wanted = f"{what} is {text!r}, expected {entry.equals!r}"
        return Finding(Level.ERROR, wanted, f"is {clean(text, 15)}" if text else "empty", values)
    return Finding(Level.OK, f"{what} is {text!r}", values=values)


def _wrong(entry: Any, low: float, high: float) -> tuple[Level, float, str] | None:
    """The level, the value that exceeds a limit, and what is allowed; None: all limits hold."""
    if entry.equals is not None:
        wanted = float(entry.equals)
        other = next((number for number in (low, high) if not math.isclose(number, wanted, rel_tol=1e-6)), None)
        if other is not None:
            return Level.ERROR, other, f"exactly {plain(wanted)}"
    for level, least, most in ((Level.ERROR, entry.min, entry.max), (Level.WARN, entry.warn_min, entry.warn_max)):
        if least is not None and low < least:
            return level, low, _allowed(least, most)
        if most is not None and high > most:
            return level, high, _allowed(least, most)
    return None


def _allowed(least: float | None, most: float | None) -> str:
    if most is None:
        return f"{plain(least or 0.0)} or more"
    return f"{plain(most)} or less" if least is None else f"{plain(least)} to {plain(most)}"


def plain(number: float) -> str:
    """Whole numbers in full, others with six digits."""
    return f"{number:.0f}" if float(number).is_integer() and abs(number) < WHOLE else f"{number:.6g}"
