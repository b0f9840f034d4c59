"""What a plug-in returned is STALE, with the reason, if a field of it has not the documented type."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import pytest

from phm.checking.result_check import checked
from phm.core.model import Evidence, Level, Result

BAD = Result(Level.ERROR, "it is broken", "broken", "custom_failed")
EVERYTHING = Evidence(
    "id@start",
    True,
    1,
    True,
    True,
    False,
    2,
    "/a",
    "hop",
    True,
    True,
    "reboot",
    True,
    True,
    True,
    ("one",),
    ("two",),
    True,
)


@pytest.mark.parametrize(
    "evidence", [Evidence(), EVERYTHING, Evidence(observed=1.5, subjects=()), Evidence(observed=-math.inf)]
)
def test_proper_evidence_is_passed_on(evidence: Evidence) -> None:
    """The result itself, without a copy."""
    result = replace(BAD, evidence=evidence)
    assert checked(result) is result


@pytest.mark.parametrize("name", [field.name for field in fields(Evidence)])
def test_evidence_of_another_type_is_stale(name: str) -> None:
    """Where None has a meaning, a byte string has none."""
    wrong: Any = b"" if getattr(Evidence(), name) is None else None
    result = checked(replace(BAD, evidence=replace(Evidence(), **{name: wrong})))
    assert result.level is Level.STALE and name in result.summary


@pytest.mark.parametrize(
    "wrong", [{"observed": math.nan}, {"listed": 1.5}, {"listed": True}, {"subjects": (1,)}, {"unobserved_of": (1,)}]
)
def test_evidence_with_impossible_contents_is_stale(wrong: dict[str, Any]) -> None:
    """Neither a comparison nor the state file expects it."""
    assert checked(replace(BAD, evidence=replace(Evidence(), **wrong))).level is Level.STALE
