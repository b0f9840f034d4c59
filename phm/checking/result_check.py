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
    if not isinstance(result.votes, tuple) or not all(isinstance(each, NodeVotes) for each in result.votes):
        return "a Result whose votes are not a tuple of NodeVotes"
    return ""


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


def _is_number(number: object, *, age: bool) -> bool:
    if number is None:
        return not age
    if isinstance(number, bool) or not isinstance(number, (int, float)):
        return False
    return math.isfinite(number) or (age and number == math.inf)


def _kind(thing: object) -> str:
    return "None" if thing is None else type(thing).__name__
