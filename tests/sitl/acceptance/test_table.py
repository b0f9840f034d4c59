"""When a row of the proof passes, and how rows are written."""

from __future__ import annotations

import json

import pytest

from sitl.acceptance.table import BEGIN, END, Row, as_json, between_marks, grouped, markdown, set_outcome
from sitl.harness.compose_stack import ROOT
from sitl.harness.log_queries import relapses


def row(**changes: object) -> Row:
    made = Row("act", "node_killed", "node killed", "nodes/a/n", alarms=["nodes/a/n"], actions=["restart"])
    made.detected_s, made.recovered_s = 1.25, 4.5
    for name, value in changes.items():
        setattr(made, name, value)
    return made


@pytest.mark.parametrize(
    ("changes", "healable", "good", "outcome"),
    [
        ({}, True, True, "recovered"),
        ({"alarms": []}, True, False, "recovered"),
        ({"alarms": ["nodes/a/n", "nodes/a/n"]}, True, False, "recovered"),
        ({"alarms": ["topics/a/t"]}, True, False, "recovered"),
        ({"recovered_s": None}, True, False, "not recovered"),
        ({"recovered_s": None, "actions": []}, False, True, "reported, left to the operator"),
        ({"recovered_s": None, "given_up_s": 31.4}, False, True, "given up and reported after 31 s"),
        ({"recovered_s": None}, False, False, "reported, left to the operator"),
        ({}, False, False, "recovered"),
    ],
)
def test_a_row_holds_with_one_alarm_and_the_expected_recovery(
    changes: dict[str, object], healable: bool, good: bool, outcome: str
) -> None:
    """One alarm at the right unit, recovered exactly if it can be; otherwise left alone, or given up with a report."""
    made = row(**changes)
    set_outcome(made, healable=healable)
    assert (made.good, made.outcome) == (good, outcome)


def test_two_faults_are_two_alarms() -> None:
    """Simultaneous faults each raise an alarm; one alarm for both, or two for one of them, fails the row."""
    for alarms, good in ((["nodes/a/n", "files/a"], True), (["nodes/a/n"], False), (["files/a", "files/a"], False)):
        made = row(also=["files/a"], alarms=alarms)
        set_outcome(made, healable=True)
        assert made.good is good


def test_a_repair_that_was_verified_too_early_is_found() -> None:
    """After `verified` the unit stays OK; its earlier levels and those of other units do not count."""

    def transition(level: str, mono: float, unit: str = "nodes/a/n") -> dict[str, object]:
        return {"event": "transition", "unit": unit, "level": level, "mono": mono, "summary": "it is not known"}

    recovered = {"event": "action", "phase": "verified", "unit": "nodes/a/n", "mono": 5.0}
    before = [transition("ERROR", 1.0), transition("OK", 4.9), recovered, transition("STALE", 5.5, "topics/a/t")]
    assert relapses(["nodes/a/n"], before) == []
    assert relapses(["nodes/a/n"], before[:2]) == []
    (words,) = relapses(["nodes/a/n"], [*before, transition("STALE", 6.0)])
    assert words == "nodes/a/n was STALE 1.0 s after it was verified: it is not known"


def test_an_alarm_about_host_load_is_listed_and_not_counted() -> None:
    """An alarm about the machine's own CPU is true and not a consequence of an injected fault: it is listed separately."""
    made = row()
    made.alarm("host/cpu")
    set_outcome(made, healable=True)
    assert made.good
    assert "beside it host/cpu" in made.cells()[-1]


def test_repeated_actions_are_counted() -> None:
    """The same action several times in a row is one entry with its count."""
    assert grouped(["start", "restart", "restart"]) == "start, restart x2"
    assert grouped([]) == ""


def test_the_markdown_table_shows_failed_rows() -> None:
    """A failed row is not hidden, and a bar in a title does not break the table."""
    made = row(title="a|b", problems=["was not recovered"])
    text = markdown([made], "x86_64", "2026-01-01")
    assert "2026-01-01 (x86_64)" in text
    assert "does not hold: was not recovered" in text
    assert "a/b" in text


def test_the_table_replaces_the_previous_one() -> None:
    """Only the text between the marks changes; a page without marks is rejected."""
    page = f"head\n{BEGIN}\nold\n{END}\ntail\n"
    assert between_marks(page, "new") == f"head\n{BEGIN}\nnew\n{END}\ntail\n"
    with pytest.raises(ValueError, match="no marks"):
        between_marks("head\n", "new")


def test_the_page_has_the_marks_of_the_table() -> None:
    """docs/reference/recovery.md has each mark once, in order."""
    page = (ROOT / "docs" / "reference" / "recovery.md").read_text("utf-8")
    assert page.count(BEGIN) == page.count(END) == 1
    assert "a row" in between_marks(page, "a row")


def test_rows_are_written_as_json() -> None:
    """The JSON has every row with its verdict."""
    assert [entry["good"] for entry in json.loads(as_json([row()]))["rows"]] == [True]
