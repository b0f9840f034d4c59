"""What a plug-in returned is STALE, with the reason, if a field of it has not the documented type."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import pytest

from phm.checking.result_check import checked
from phm.core.model import Evidence, HostReadings, Level, NodeVotes, Result

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


@pytest.mark.parametrize(
    "details",
    [
        {"readings": HostReadings()},
        {"readings": HostReadings(12.5, 40, -3.0, (0, 1200), ((32_000, 0), (64_000, 1.0)))},
        {"votes": (NodeVotes("/a/n", "alive", ("/a/m", "PHM")), NodeVotes("/a/m", "undecided"))},
    ],
)
def test_proper_readings_and_votes_are_passed_on(details: dict[str, Any]) -> None:
    """The result itself."""
    result = replace(BAD, **details)
    assert checked(result) is result


@pytest.mark.parametrize(
    "wrong",
    [
        {"cpu_percent": "12"},
        {"cpu_percent": True},
        {"memory_percent": math.nan},
        {"temperature_c": math.inf},
        {"fans_rpm": None},
        {"fans_rpm": [1200]},
        {"fans_rpm": (None,)},
        {"disks": None},
        {"disks": ((1, 2, 3),)},
        {"disks": ((math.inf, 2),)},
        {"disks": (1, 2)},
    ],
)
def test_readings_of_another_type_are_stale(wrong: dict[str, Any]) -> None:
    """The reporter that sends them expects numbers."""
    result = checked(replace(BAD, readings=replace(HostReadings(), **wrong)))
    assert result.level is Level.STALE and f"readings.{next(iter(wrong))}" in result.summary


@pytest.mark.parametrize(
    "wrong", [{"node": None}, {"verdict": 1}, {"alive": "/a/m"}, {"alive": ["/a/m"]}, {"dead": (None,)}]
)
def test_votes_of_another_type_are_stale(wrong: dict[str, Any]) -> None:
    """The reporter that publishes them expects texts."""
    votes = (NodeVotes("/a/m", "alive"), replace(NodeVotes("/a/n", "dead"), **wrong))
    result = checked(replace(BAD, votes=votes))
    assert result.level is Level.STALE and f"votes[1].{next(iter(wrong))}" in result.summary
