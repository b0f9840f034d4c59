"""Levels over time: what the ground received of an agent over a link gap, lost lines, and why a unit was unknown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Level, Transition
from phm.review import table_rows
from tests.review import raw
from tests.review.records import T0, Flown, Ground, report

UNIT = "rates/topic_1"


def received(path: Path) -> Ground:
    """A record in which agent 7 is in ERROR from 0 s, and is lost at 112 s, 12 s after its last heartbeat."""
    made = Ground(path)
    made.event(0, "agent", agent=7, name="A07", system=7, component=193, link="gcs")
    made.event(0, "slots", agent=7, name="A07", slots={"6": "ERROR"})
    made.event(60, "snapshot")
    made.event(112, "presence", agent=7, name="A07", presence="lost", was="alive", silent_s=12.0)
    return made


def spent(path: Path) -> list[list[object]]:
    found = report(path)["agents"][0]["levels"]
    return [[round(begin - T0), round(end - T0), level] for begin, end, level in found]


def test_an_agent_that_is_received_again_has_the_level_it_had(tmp_path: Path) -> None:
    """The ground records no level that did not change; in the gap, from the last heartbeat, it is not known."""
    made = received(tmp_path / "ground.jsonl")
    made.event(130, "presence", agent=7, name="A07", presence="alive", was="lost", silent_s=0.0)
    for seconds in (190, 250):
        made.event(seconds, "snapshot")
    path = made.close()
    assert spent(path) == [[0, 100, "ERROR"], [130, 250, "ERROR"]]
    assert report(path)["agents"][0]["error_s"] == 220.0


def test_an_agent_that_is_received_again_with_another_level_has_that_one(tmp_path: Path) -> None:
    """Both lines are of one heartbeat."""
    made = received(tmp_path / "ground.jsonl")
    made.event(130, "presence", agent=7, name="A07", presence="alive", was="lost", silent_s=0.0)
    made.event(130, "slots", agent=7, name="A07", slots={"6": "OK"})
    made.event(190, "snapshot")
    assert spent(made.close()) == [[0, 100, "ERROR"], [130, 190, "OK"]]


def test_an_agent_that_left_has_no_level_after_its_last_heartbeat(tmp_path: Path) -> None:
    """That heartbeat has another state, so there is a line about its levels as well."""
    made = Ground(tmp_path / "ground.jsonl")
    made.event(0, "slots", agent=7, name="A07", slots={"6": "OK"})
    made.event(60, "presence", agent=7, name="A07", presence="left", was="alive", silent_s=0.0)
    made.event(60, "slots", agent=7, name="A07", slots={"6": "OK"})
    made.event(120, "snapshot")
    assert spent(made.close()) == [[0, 60, "OK"]]


def without(path: Path, *words: bytes) -> None:
    """The log loses the first line after its beginning that has all these words."""
    lines = path.read_bytes().splitlines(keepends=True)
    lost = next(place for place, line in enumerate(lines) if all(word in line for word in words))
    path.write_bytes(b"".join(lines[:lost] + lines[lost + 1 :]))


RECOVERED = (b'"event":"transition"', b'"old":"ERROR"')


def test_a_unit_whose_recovery_has_no_line_is_ok_from_the_next_report_on(tmp_path: Path) -> None:
    """Else one lost line would leave it in ERROR until the end of the record. What is lost is named."""
    made = Flown(tmp_path)
    made.until(30)
    made.fail(UNIT)
    made.until(300)
    without(made.close(), *RECOVERED)
    document = report(tmp_path)
    (agent,) = document["agents"]
    assert [[round(begin - T0), round(end - T0), level] for begin, end, level in agent["units"][UNIT]] == [
        [0, 30, "OK"],
        [30, 54, "ERROR"],
        [54, 294, "OK"],
    ]
    assert (agent["error_s"], agent["missing_lines"]) == (24.0, 1)
    assert ("agent_1", "lines that are missing in the logs", "1") in table_rows.cut(document)


def test_a_failure_without_a_line_counts_from_the_next_report_on(tmp_path: Path) -> None:
    made = Flown(tmp_path)
    made.until(30)
    made.fail(UNIT, lasts=None)
    made.until(300)
    without(made.close(), b'"event":"transition"', b'"level":"ERROR"')
    assert report(tmp_path)["agents"][0]["error_s"] == 240.0


def test_reports_that_say_what_the_changes_said_change_nothing(tmp_path: Path) -> None:
    """Rotated files begin with a report, in which each level is new to the reader."""
    made = Flown(tmp_path / "whole")
    made.until(30)
    made.fail(UNIT)
    made.until(300)
    path = made.close()
    whole = report(path)["agents"]
    lines = path.read_bytes().splitlines(keepends=True)
    for half, some in enumerate((lines[: len(lines) // 2], lines[len(lines) // 2 :])):
        (tmp_path / f"half{half}.jsonl").write_bytes(b"".join(some))
    assert report(tmp_path / "half1.jsonl", tmp_path / "half0.jsonl")["agents"] == whole


@pytest.mark.parametrize("lost", [[b'"fault_closed"'], [b'"fault_closed"', RECOVERED]], ids=["end", "both"])
def test_a_fault_whose_end_has_no_line_ends_when_its_unit_is_ok(tmp_path: Path, lost: list[Any]) -> None:
    made = Flown(tmp_path)
    made.until(30)
    made.fail(UNIT)
    made.until(60)
    made.fail("nodes/node_1", lasts=None)
    made.until(300)
    path = made.close()
    for words in lost:
        without(path, *([words] if isinstance(words, bytes) else words))
    ended, still = report(tmp_path)["faults"]
    assert (ended["outcome"], ended["lasted_s"]) == ("unknown", 4.0 if len(lost) == 1 else 24.0)
    assert (still["outcome"], still["closed"]) == ("open", None)


def unknown(*paths: Path) -> list[tuple[float, float]]:
    return [(row["blocked_s"], row["unknown_s"]) for row in report(*paths)["unknown"] if row["unit"] == UNIT]


def blocked(made: Flown, by: str, *, line: bool) -> None:
    """From now on the unit is STALE because of `by`; line: with a line about a change."""
    old = made.states[UNIT]
    made.states[UNIT] = replace(made._state(UNIT, Level.STALE, "unknown"), blocked_by=by)
    if line:
        made.log.handle(Transition(made.at, old.level, made.states[UNIT], changed_text=old.level is Level.STALE))


@pytest.mark.parametrize("line", [True, False], ids=["change", "report"])
def test_a_cause_that_ends_or_begins_while_a_unit_is_unknown_counts_from_then(tmp_path: Path, line: bool) -> None:
    """Without a line about the change, the next report has it."""
    made = Flown(tmp_path)
    made.until(100)
    blocked(made, "nodes/node_1", line=True)
    made.until(200)
    blocked(made, "", line=line)
    made.until(260)
    blocked(made, "nodes/node_1", line=line)
    made.until(300)
    made.close()
    assert unknown(tmp_path) == [(140.0, 60.0)]


def test_a_log_that_begins_while_a_unit_is_blocked_has_its_cause(tmp_path: Path) -> None:
    """The line about the change was rotated away."""
    made = Flown(tmp_path)
    made.until(100)
    blocked(made, "nodes/node_1", line=True)
    made.until(200)
    path = made.close()
    lines = path.read_bytes().splitlines(keepends=True)
    change = next(place for place, line in enumerate(lines) if b'"blocked_by":"nodes/node_1"' in line)
    path.write_bytes(b"".join(lines[change + 1 :]))
    assert unknown(tmp_path) == [(80.0, 0.0)]


def test_a_unit_that_is_never_known_does_not_hide_that_others_were_ok(tmp_path: Path) -> None:
    """The availability of an agent and a layer is that of the units that are known."""
    reports = [raw.unit(at, *one) for at in range(0, 1001, 20) for one in (("nodes/n1",), (UNIT, "STALE"))]
    failure = [raw.change(105, "nodes/n1", "OK", "ERROR"), raw.change(109, "nodes/n1", "ERROR", "OK")]
    events = sorted([*reports, *failure], key=lambda event: float(event["at"]))
    rows = {row["kind"]: row for row in report(raw.write(tmp_path, events))["availability"]}
    for kind in ("agent", "layer", "node"):
        assert (rows[kind]["availability"], rows[kind]["error_s"], rows[kind]["unknown_s"]) == (0.996, 4.0, 0.0), kind
    assert (rows["topic"]["availability"], rows["topic"]["unknown_s"]) == (None, 1000.0)
