"""Levels over time: what the ground received of an agent over a link gap, and why a unit was unknown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from phm.core.model import Level, Transition
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
