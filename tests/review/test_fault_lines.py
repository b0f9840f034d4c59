"""The lines around a fault are those around its opening and those around its end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.review import raw
from tests.review.records import T0, Flown, report


def fault(at: float, kind: str, **more: Any) -> dict[str, Any]:
    body = {"event": kind, "fault": "f1", "unit": "nodes/n1", "check": "nodes", "summary": "n1 is gone", "at": at}
    return {**body, **more}


def note(at: float, text: str) -> dict[str, Any]:
    return {"event": "note", "kind": "NOTE", "text": text, "at": at}


def lines_of(folder: Path, events: list[dict[str, Any]]) -> list[tuple[float, str]]:
    ordered = sorted([*events, note(0, "first"), note(500, "last")], key=lambda event: float(event["at"]))
    (row,) = report(raw.write(folder, ordered))["faults"]
    return [(round(line["t"] - T0, 1), line["text"]) for line in row["lines"]]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ({"outcome": "resolved", "by": "restart"}, "RESOLVED: nodes/n1: resolved by restart after 30.0 s"),
        ({"outcome": "resolved", "by": ""}, "RESOLVED: nodes/n1: resolved by itself after 30.0 s"),
        ({"outcome": "escalated"}, "ESCALATED: nodes/n1: PHM has given up after 30.0 s"),
        ({"outcome": "reattributed", "by": "f7"}, "STALE: nodes/n1: follows from f7 after 30.0 s"),
    ],
)
def test_a_fault_has_the_lines_of_its_opening_and_its_end(tmp_path: Path, body: dict[str, str], said: str) -> None:
    """Also without a transition; what is longer ago than 5 s or comes later than 5 s is not among them."""
    events = [fault(100, "fault_opened"), note(110, "between"), fault(130, "fault_closed", **body)]
    found = lines_of(tmp_path, [note(94, "before"), *events, note(136, "after")])
    assert found == [(100.0, "FAILURE: nodes/n1: n1 is gone"), (110.0, "NOTE: between"), (130.0, said)]


def test_the_transition_that_opened_a_fault_is_not_said_twice(tmp_path: Path) -> None:
    """As `phm logs` shows it; a record of the real log reporter."""
    made = Flown(tmp_path)
    made.until(20)
    made.fail("nodes/node_1")
    made.until(60)
    made.close()
    texts = [line["text"] for line in report(tmp_path)["faults"][0]["lines"]]
    assert sum(text.startswith("FAILURE: nodes/node_1") for text in texts) == 1
    assert texts[-1] == "RESOLVED: nodes/node_1: resolved by restart after 4.0 s"


def test_of_a_long_fault_both_ends_are_shown_and_the_lines_between_are_counted(tmp_path: Path) -> None:
    """20 around the opening, 20 around the end."""
    between = [note(101 + number, f"line {number}") for number in range(100)]
    events = [fault(100, "fault_opened"), *between, fault(210, "fault_closed", outcome="resolved", by="restart")]
    found = lines_of(tmp_path, [note(97, "before"), *events, note(213, "after")])
    assert found[:3] == [(97.0, "NOTE: before"), (100.0, "FAILURE: nodes/n1: n1 is gone"), (101.0, "NOTE: line 0")]
    assert found[20] == (119.0, "... 64 lines")
    assert found[-2:] == [(210.0, "RESOLVED: nodes/n1: resolved by restart after 110.0 s"), (213.0, "NOTE: after")]
    assert len(found) == 41


def test_many_lines_at_the_opening_and_at_the_end_hide_neither(tmp_path: Path) -> None:
    """A hundred lines within 5 s before the one and after the other."""
    before = [note(96 + number / 50, f"b{number}") for number in range(100)]
    after = [note(201 + number / 50, f"a{number}") for number in range(100)]
    between = [note(101 + number / 10, f"m{number}") for number in range(100)]
    closed = fault(200, "fault_closed", outcome="escalated")
    found = lines_of(tmp_path, [*before, fault(100, "fault_opened"), *between, closed, *after])
    texts = [text for _, text in found]
    assert texts[0] == "... 90 lines" and texts[-1] == "... 91 lines" and len(texts) == 43
    assert "FAILURE: nodes/n1: n1 is gone" in texts and "ESCALATED: nodes/n1: PHM has given up after 100.0 s" in texts
    shown = sum(not text.startswith("...") for text in texts)
    hidden = sum(int(text.split()[1]) for text in texts if text.startswith("..."))
    assert (shown, hidden) == (40, 302 - 40)
