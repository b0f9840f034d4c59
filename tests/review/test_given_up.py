"""A fault that PHM has given up on still fails until its unit is OK, also in a flight that began later or a log that lacks it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm.review import table_rows
from tests.review import raw
from tests.review.records import T0, Ground, report

UNIT, SAID = "nodes/n1", "n1 is gone, expected running: restart it"
NEXT = f"Before the next flight, on agent_1 ({UNIT}): restart it."


def recorded(folder: Path, ok_from: float = 1e9) -> Path:
    """Fails at 10 s, is given up at 100 s, and is OK from `ok_from` on; flights from 400 to 445 s and from 600 to 645 s."""
    fault = {"fault": "f1", "unit": UNIT, "check": "nodes", "summary": SAID, "brief": "n1 gone"}
    events = [
        raw.change(10, UNIT, "OK", "ERROR", summary=SAID),
        {"event": "fault_opened", **fault, "at": 10},
        {"event": "fault_closed", **fault, "outcome": "escalated", "duration_s": 90.0, "at": 100},
        *([raw.change(ok_from, UNIT, "ERROR", "OK")] if ok_from < 900 else []),
    ]
    for at in range(0, 901, 20):
        level = "OK" if at < 10 or at > ok_from else "ERROR"
        events += [raw.unit(at, UNIT, level), raw.unit(at, "host/cpu"), {"event": "report", "at": at}]
    for number, at in ((1, 400), (2, 600)):
        events.append({"event": "flight", "number": number, "began": True, "at": at})
        events.append({"event": "flight", "number": number, "began": False, "duration_s": 45.0, "at": at + 45})
    return raw.write(folder, sorted(events, key=lambda event: float(event["at"])))


def test_what_was_given_up_before_take_off_is_in_the_report_of_the_flight(tmp_path: Path) -> None:
    """The record has no further line about it."""
    made = report(recorded(tmp_path), flight=1)
    (row,) = made["faults"]
    assert (row["fault"], row["outcome"], row["closed"], row["ok_again"]) == ("f1", "escalated", T0 + 100, None)
    assert made["sentences"][1:3] == ["No fault opened.", "0 faults were open at the end, and PHM gave up on 1."]
    assert made["sentences"][4] == NEXT
    assert (made["agents"][0]["faults"], made["checks"][0]["faults"]) == (0, 0)


@pytest.mark.parametrize("flight", [None, 1])
def test_what_was_given_up_and_repaired_by_hand_has_nothing_left_to_do(tmp_path: Path, flight: int | None) -> None:
    made = report(recorded(tmp_path, ok_from=420), flight=flight)
    assert made["faults"][0]["ok_again"] == T0 + 420
    assert made["sentences"][2] == "0 faults were open at the end, and PHM gave up on 1."
    assert made["sentences"][4] == "Nothing in the record has to be done before the next flight."


def test_what_is_ok_again_only_after_the_flight_has_to_be_done_before_it(tmp_path: Path) -> None:
    """And it is not in the flight that began after its recovery."""
    folder = recorded(tmp_path, ok_from=500)
    first, second = report(folder, flight=1), report(folder, flight=2)
    assert (first["faults"][0]["ok_again"], first["sentences"][4]) == (None, NEXT)
    assert (second["faults"], second["sentences"][1]) == ([], "There was no fault.")


def failing(*paths: Path) -> tuple[list[dict[str, Any]], str]:
    made = report(*paths)
    assert made["faults"] == []
    return made["agents"][0]["failing"], made["sentences"][4]


def test_a_unit_in_error_at_the_end_is_named_though_no_line_says_why(tmp_path: Path) -> None:
    """The log begins after PHM gave up: its older part was rotated away."""
    events = [raw.unit(at, UNIT, "ERROR") | {"summary": SAID} for at in range(0, 201, 20)]
    assert failing(raw.write(tmp_path / "a", events)) == ([{"unit": UNIT, "summary": SAID, "brief": ""}], NEXT)
    assert report(tmp_path / "a")["sentences"][2].endswith("gave up on none; 1 unit without one was in ERROR.")
    later = [*events, raw.change(210, UNIT, "ERROR", "OK"), raw.unit(220, UNIT)]
    assert failing(raw.write(tmp_path / "b", later)) == (
        [],
        "Nothing in the record has to be done before the next flight.",
    )


def test_an_agent_whose_last_level_on_the_ground_was_error_is_named(tmp_path: Path) -> None:
    """It has no log, so its units are not known."""
    ground = Ground(tmp_path / "ground.jsonl")
    ground.event(0, "slots", agent=7, name="A07", slots={"6": "OK"})
    ground.event(40, "slots", agent=7, name="A07", slots={"6": "ERROR"})
    ground.event(60, "snapshot")
    made = report(ground.close())
    assert made["sentences"][4] == "Before the next flight, look at A07: it was in ERROR when it was last received."
    assert table_rows.cut(made) == []
