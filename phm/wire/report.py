"""A report as JSON: the one shape that `phm once`, the status file and the log share.

Pure functions from the model's records to what `json.dumps` takes. `docs/reference/logs.md` and `docs/reference/cli.md`
state these keys as a contract.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta, timezone
from functools import lru_cache
from typing import Any

from phm.core.model import Fault, Level, Slot, UnitState, Value, worst_by_slot

NOT_APPLICABLE = "n/a"
"""Level of a unit whose check had nothing to evaluate."""
OK_LEVELS = (Level.OK.name, NOT_APPLICABLE)
"""Levels of units that need no attention."""
ARRAY_SLOTS = 8
"""The printed status array covers the slots of the paper's Fig. 5, 1 to 8."""

_RATE = re.compile(r": \d+\.\d{3}$")
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


@lru_cache(maxsize=512)  # most are the times since which units are unchanged, which every report contains
def iso(utc_s: float) -> str:
    """Seconds since the epoch as ``2026-03-01T12:00:00.123Z`` (UTC, milliseconds cut, not rounded)."""
    moment = _moment(utc_s)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{moment.microsecond // 1000:03d}Z"


def clock_text(utc_s: float) -> str:
    """Seconds since the epoch as ``2026-03-01 12:00:00.123``, the stamp of a line of the text log."""
    return iso(utc_s)[:-1].replace("T", " ")


def _moment(utc_s: float) -> datetime:
    # A companion computer without a battery clock may claim any year; a log line must come out all the same.
    try:
        return _EPOCH + timedelta(seconds=utc_s)
    except (OverflowError, ValueError):
        return _EPOCH


def status_array(units: Sequence[UnitState]) -> list[int | None]:
    """Slots 1 to 8 as in the paper: 1 is OK or WARN, 0 is ERROR, None is STALE or unused."""
    slots = worst_by_slot(tuple(units))
    digits = {Level.OK: 1, Level.WARN: 1, Level.ERROR: 0, Level.STALE: None}
    return [digits[slots.get(Slot(number), Level.STALE)] for number in range(1, ARRAY_SLOTS + 1)]


def array_text(array: Sequence[int | None]) -> str:
    """A status array as the log prints it: ``[1, 1, 0, -, 1, 1, 1, 1]``."""
    return "[" + ", ".join("-" if digit is None else str(digit) for digit in array) + "]"


def values_json(values: Mapping[str, Value]) -> dict[str, Value]:
    """Values that every JSON reader takes: numbers that are not finite become null."""
    return {
        str(key): None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in values.items()
    }


def level_name(state: UnitState) -> str:
    """``OK``, ``WARN``, ``ERROR``, ``STALE`` or ``n/a``."""
    return NOT_APPLICABLE if state.not_applicable else state.level.name


def unit_json(state: UnitState) -> dict[str, Any]:
    """One unit. `duration_ms` is how long the last run took; `since` when this level was first published (UTC)."""
    result = state.result
    return {
        "id": state.unit,
        "slot": int(state.slot),
        "layer": state.layer.value,
        "level": level_name(state),
        "summary": result.summary,
        "blocked_by": state.blocked_by,
        "duration_ms": round(state.duration_s * 1000, 1),
        "check": state.check,
        "brief": result.brief,
        "condition": result.condition,
        "target": result.target,
        "bypass": result.bypass,
        "fault": state.fault,
        "since": iso(state.since.utc),
        "values": values_json(result.values),
    }


def with_hertz(row: Mapping[str, Any], summary: str) -> str:
    """The summary of a unit (`unit_json`). A rate that is OK has no unit in the log, as in Fig. 5 of the paper; here it has."""
    rate = row.get("check") == "rates" and row.get("level") == "OK" and _RATE.search(summary)
    return f"{summary} Hz" if rate else summary


def fault_json(fault: Fault, *, blocks: Sequence[str] | None = None) -> dict[str, Any]:
    """One fault. `closed`, `duration_s` are null while it is open; `blocks` may be given newer than the record's."""
    return {
        "fault": fault.id,
        "unit": fault.unit,
        "slot": int(fault.slot),
        "layer": fault.layer.value,
        "condition": fault.result.condition,
        "summary": fault.result.summary,
        "brief": fault.result.brief,
        "target": fault.result.target,
        "opened": iso(fault.opened.utc),
        "closed": iso(fault.closed.utc) if fault.closed else None,
        "duration_s": round(fault.closed.mono - fault.opened.mono, 3) if fault.closed else None,
        "outcome": fault.outcome.value,
        "by": fault.by,
        "blocks": list(fault.blocks if blocks is None else blocks),
        "consequences": list(fault.consequences),
        "suspects": list(fault.suspects),
    }


def report_json(agent: str, units: Sequence[UnitState]) -> dict[str, Any]:
    """What `phm once --json` prints: ``{agent, status_array, slots, checks}``.

    `slots` maps the number of each used slot to the name of its level; JSON keys are text.
    """
    slots = worst_by_slot(tuple(units))
    return {
        "agent": agent,
        "status_array": status_array(units),
        "slots": {str(int(slot)): slots[slot].name for slot in sorted(slots)},
        "checks": [unit_json(state) for state in units],
    }
