"""What a check returned, before anything relies on it: a plug-in may return anything, and one odd field would otherwise raise later,
in the tracker or in a reporter, and take the events of other units with it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from phm.api import stale
from phm.core.model import Evidence, HostReadings, Level, NodeVotes, Result

_TEXTS = ("summary", "brief", "condition", "target")
_SECONDS = ("settle_s", "decides_s", "age_s", "rate_hz")
_AGE = "age_s"
"""Always a number; infinity: the evidence may be from any time before PHM's first observation."""
_READINGS = ("cpu_percent", "memory_percent", "temperature_c")
_EVIDENCE_TEXTS = ("generation", "file", "broken_hop", "ended_by")
_EVIDENCE_FLAGS = (
    "certain",
    "conclusive",
    "in_time",
    "patient",
    "rising",
    "falling",
    "forecast",
    "recovered",
    "unobserved",
)
_VALUES = (str, int, float, bool, type(None))


def checked(answer: Any) -> Result:
    """`answer` itself, or STALE with the reason if it is not a Result whose fields have the types of `phm.api`."""
    reason = _wrong(answer)
    return stale(f"the check returned {reason}") if reason else answer


def _wrong(answer: Any) -> str:
    """What is wrong with it; empty: nothing."""
    if not isinstance(answer, Result):
        return f"{type(answer).__name__}, not a Result"
    if not isinstance(answer.level, Level):
        return f"a Result whose level is {_kind(answer.level)}, not a Level"
    for name in _TEXTS:
        if not isinstance(getattr(answer, name), str):
            return f"a Result whose {name} is {_kind(getattr(answer, name))}, not a text"
    for name in _SECONDS:
        if not _is_number(getattr(answer, name), age=name == _AGE):
            return f"a Result whose {name} is not a finite number"
    return _wrong_values(answer.values) or _wrong_details(answer)


def _wrong_values(values: object) -> str:
    if not isinstance(values, Mapping):
        return f"a Result whose values are {_kind(values)}, not a mapping"
    for key, value in values.items():
        if not isinstance(key, str):
            return "a Result with a value whose name is not a text"
        if not isinstance(value, _VALUES):
            return f"a Result whose value {key} is {_kind(value)}, not a text, number, true, false or None"
    return ""


def _wrong_details(result: Result) -> str:
    if not isinstance(result.evidence, Evidence):
        return f"a Result whose evidence is {_kind(result.evidence)}, not Evidence"
    if field := _wrong_evidence(result.evidence):
        return f"a Result whose evidence.{field} is {_kind(getattr(result.evidence, field))}, which it must not be"
    if not isinstance(result.readings, (HostReadings, type(None))):
        return f"a Result whose readings are {_kind(result.readings)}, not HostReadings"
    if result.readings is not None and (field := _wrong_readings(result.readings)):
        return f"a Result whose readings.{field} is not of its type"
    if not isinstance(result.votes, tuple) or not all(isinstance(each, NodeVotes) for each in result.votes):
        return "a Result whose votes are not a tuple of NodeVotes"
    for number, votes in enumerate(result.votes):
        if field := _wrong_votes(votes):
            return f"a Result whose votes[{number}].{field} is not of its type"
    return ""


def _wrong_readings(readings: HostReadings) -> str:
    """A field whose value is not of the documented type; empty: none."""
    for name in _READINGS:
        if not _is_number(getattr(readings, name), age=False):
            return name
    if not _are_numbers(readings.fans_rpm):
        return "fans_rpm"
    disks = readings.disks
    return "" if isinstance(disks, tuple) and all(_are_numbers(disk) and len(disk) == 2 for disk in disks) else "disks"


def _wrong_votes(votes: NodeVotes) -> str:
    """The same for the votes about one node."""
    for name in ("node", "verdict"):
        if not isinstance(getattr(votes, name), str):
            return name
    return next((name for name in ("alive", "dead") if not _are_names(getattr(votes, name))), "")


def _wrong_evidence(evidence: Evidence) -> str:
    """A field whose value is not of the documented type; empty: none."""
    for name in _EVIDENCE_TEXTS:
        if not isinstance(getattr(evidence, name), str):
            return name
    for name in _EVIDENCE_FLAGS:
        if not isinstance(getattr(evidence, name), bool):
            return name
    if not _is_number(evidence.observed, age=True) and evidence.observed != -math.inf:
        return "observed"
    if not isinstance(evidence.never_ok, (bool, type(None))):
        return "never_ok"
    if not isinstance(evidence.listed, (int, type(None))) or isinstance(evidence.listed, bool):
        return "listed"
    if evidence.subjects is not None and not _are_names(evidence.subjects):
        return "subjects"
    return "" if _are_names(evidence.unobserved_of) else "unobserved_of"


def _are_names(names: object) -> bool:
    return isinstance(names, tuple) and all(isinstance(name, str) for name in names)


def _are_numbers(numbers: object) -> bool:
    return isinstance(numbers, tuple) and all(_is_number(number, age=True) and number != math.inf for number in numbers)


def _is_number(number: object, *, age: bool) -> bool:
    if number is None:
        return not age
    if isinstance(number, bool) or not isinstance(number, (int, float)):
        return False
    return math.isfinite(number) or (age and number == math.inf)


def _kind(thing: object) -> str:
    return "None" if thing is None else type(thing).__name__
