"""The row made from the record of a starved agent, and the table of several measurements."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sitl.acceptance.plan import STARVING
from sitl.bench import starvation
from sitl.bench.starvation_rows import BEGIN, END, Row, as_json, cells, count, from_json, levels, markdown, not_ok
from sitl.faults._overload import LASTS_S
from sitl.harness.compose_stack import ROOT

CAUSE = "pressure/ros_app"


def event(kind: str, mono: float, unit: str = CAUSE, **more: Any) -> dict[str, Any]:
    return {"event": kind, "mono": mono, "unit": unit, "fault": f"f-{unit}", **more}


def opened(mono: float, unit: str = CAUSE, condition: str = "cpu_throttled") -> dict[str, Any]:
    return event("fault_opened", mono, unit, condition=condition)


def action(mono: float, phase: str, unit: str = CAUSE, name: str = "restart") -> dict[str, Any]:
    return event("action", mono, unit, phase=phase, action=name)


def row(events: list[dict[str, Any]], *, healable: bool = False, expected: tuple[str, ...] = (CAUSE,)) -> Row:
    made = Row("cpu_limited", "a title", list(expected), healable)
    made.read(events, 100.0)
    made.judge()
    return made


def test_one_alarm_at_the_cause_holds() -> None:
    """STALE consequences, and the machine's reports about itself, are not alarms."""
    stale = event("transition", 102.0, "rates/a", level="STALE", blocked_by=CAUSE)
    made = row(
        [opened(101.5), stale, opened(103.0, "host/cpu", "cpu_high"), action(104.0, "started", name="join_network")]
    )
    assert made.good
    assert (made.detected_s, made.blocked, made.beside, made.actions) == (1.5, ["rates/a"], ["host/cpu cpu_high"], [])


@pytest.mark.parametrize(
    ("events", "words"),
    [
        ([], "alarms at nothing"),
        ([opened(101.0), opened(102.0, "rates/a")], "rates/a"),
        ([opened(101.0), opened(105.0)], "pressure/ros_app x2"),
        ([opened(101.0), action(102.0, "started")], "1 actions, of which 0 can help"),
    ],
)
def test_a_row_with_a_wrong_alarm_or_action_does_not_hold(events: list[dict[str, Any]], words: str) -> None:
    """No alarm, one elsewhere, one twice, and an action that cannot help."""
    assert any(words in problem for problem in row(events).problems)


def test_a_real_fault_under_load_needs_one_verified_action() -> None:
    """Both causes have an alarm; a second action, or an unverified one, is a problem."""
    node, host = "nodes/a/node_1", "host/cpu"
    alarms = [opened(101.0, host), opened(102.0, node)]
    done = [action(103.0, "started", node), action(110.0, "verified", node)]
    made = row([*alarms, *done], healable=True, expected=(node, host))
    assert made.good
    assert made.recovered_s == 10.0
    assert not row(alarms, healable=True, expected=(node, host)).good
    twice = row([*alarms, done[0], *done], healable=True, expected=(node, host))
    assert twice.problems == ["2 actions, of which 1 can help"]


def test_an_alarm_that_was_open_before_counts() -> None:
    """On a machine that was already busy, its alarm is not raised again for the overload; unexpected earlier alarms are
    ignored.
    """
    made = Row("host_overload", "a title", ["host/cpu"])
    made.read([], 100.0, ["host/cpu", "rates/a"])
    made.judge()
    assert made.good
    assert made.alarms == ["host/cpu (open before)"]


def test_remaining_levels_and_faults_are_found() -> None:
    """The last level of each unit and open faults, except the machine's; a start of PHM resets them."""
    events = [
        event("unit", 1.0, "a", level="ERROR"),
        event("start", 2.0, ""),
        event("unit", 3.0, "b", level="OK"),
        event("transition", 4.0, "b", level="STALE"),
        event("unit", 4.0, "host/cpu", level="ERROR"),
        opened(5.0, "c"),
        opened(5.0, "d"),
        event("fault_closed", 6.0, "d"),
    ]
    assert levels(events) == {"b": "STALE", "host/cpu": "ERROR"}
    assert not_ok(events) == ["b STALE", "fault at c"]


def test_equal_entries_are_counted() -> None:
    """The most frequent first."""
    assert count(["a", "b", "b"]) == "b x2, a"


def test_the_table_has_a_line_for_each_measurement(tmp_path: Path) -> None:
    """Read from the JSON of earlier runs; a failed row is marked."""
    file = tmp_path / "before.json"
    file.write_text(as_json([row([opened(101.0), action(102.0, "started")])], "2 cores", "before"))
    words, rows = from_json(file)
    assert words == "before (2 cores)"
    lines = markdown([("before", rows), ("after", [row([opened(101.0)])])]).splitlines()
    assert lines[2:] == [
        "| a title | before | 1: pressure/ros_app after 1.0 s | restart | all OK; **does not hold** |",
        "| a title | after | 1: pressure/ros_app after 1.0 s | none | all OK |",
    ]
    assert cells(row([])) == ("none", "none", "all OK")


def test_the_page_has_the_marks_of_the_table() -> None:
    """docs/reference/recovery.md has each mark once, in order."""
    page = (ROOT / "docs" / "reference" / "recovery.md").read_text("utf-8")
    assert page.count(BEGIN) == page.count(END) == 1
    assert page.index(BEGIN) < page.index(END)


def test_each_fault_is_starved_for_longer_than_an_overload_lasts() -> None:
    """An overload ends by itself before it is scored, and every fault of the plan is injected by default."""
    assert starvation.OVERLOADED_S > LASTS_S
    assert set(STARVING) < set(starvation.ROWS)
