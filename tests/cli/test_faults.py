"""`phm faults`: faults of the log and of the running daemon, also without the daemon."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from phm.cli import group
from phm.core.clock import SystemClock
from phm.core.model import ActionEvent, Event, Level, Outcome, Phase, Slot, Transition
from phm.core.settings import Settings
from phm.reporters.log import LogReporter
from phm.reporters.status import StatusReporter
from phm.wire.fault_timeline import MAX_STEPS, build_timelines
from tests.fakes.records import at, closed, context, opened, unit

DEAD = unit("nodes/n1", Slot.NODES, Level.ERROR, "Node n1 is not running", brief="n1 dead", target="app")
BLOCKED = unit("topics/t1", Slot.TOPICS, Level.STALE, blocked_by=DEAD.unit)


def step(phase: Phase, fault: str, detail: str) -> ActionEvent:
    return ActionEvent(at(1.0), fault, DEAD.unit, "restart", "app", phase, detail)


RECOVERED: list[Event] = [
    opened(DEAD, "ab12-1"),
    Transition(at(0.5), Level.OK, BLOCKED),
    step(Phase.ADVISED, "ab12-1", "advised: restart app"),
    step(Phase.APPROVED, "ab12-1", "approved: restart app"),
    step(Phase.STARTED, "ab12-1", "restart app"),
    step(Phase.VERIFIED, "ab12-1", "nodes/n1 is OK again"),
    closed(DEAD, Outcome.RESOLVED, "restart", 4.5, "ab12-1"),
]
OPEN: list[Event] = [opened(DEAD, "ab12-2"), step(Phase.ADVISED, "ab12-2", "advised: restart app")]


def record(folder: Path, *events: Event) -> None:
    log = LogReporter.build(context(Settings.model_validate({"log": {"directory": str(folder / "log")}})))
    for event in events:
        log.handle(event)
    log.close()


def invoke(folder: Path, *words: str) -> Result:
    places = ["--log-dir", str(folder / "log"), "--run-dir", str(folder / "run")]
    return CliRunner().invoke(group, ["faults", *words, *places], env={"COLUMNS": "200"})


def as_json(folder: Path, *words: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(invoke(folder, "--json", *words).output)
    return document


def test_without_the_daemon_the_log_is_shown(tmp_path: Path) -> None:
    """Open faults with the recommended action, resolved ones with its cause, and a note that PHM is not running."""
    record(tmp_path, *RECOVERED, *OPEN)
    shown = invoke(tmp_path)
    assert shown.exit_code == 0
    for words in ("resolved by restart in 4.5 s", "blocks topics/t1", "advised: restart app", "PHM is not running"):
        assert words in shown.output
    assert shown.output.index("ab12-1") < shown.output.index("ab12-2")


def test_one_fault_is_shown_step_by_step(tmp_path: Path) -> None:
    """Opened, blocked units, each phase, closed: in that order."""
    record(tmp_path, *RECOVERED)
    lines = invoke(tmp_path, "ab12-1").output.splitlines()
    steps = ["opened", "blocks", "restart advised", "restart approved", "restart started", "restart verified"]
    found = [next(index for index, line in enumerate(lines) if f"Z  {word}" in line) for word in steps]
    assert found == sorted(found)
    assert "by restart after 4.5 s" in lines[found[-1] + 1]


def test_the_running_daemon_reports_open_faults(tmp_path: Path) -> None:
    """A fault that is open in the log only is `unknown`; one that only the daemon knows is listed."""
    record(tmp_path, *OPEN)
    parts = context(Settings(run_dir=str(tmp_path / "run")), clock=SystemClock(), states=lambda: (DEAD,))
    status = StatusReporter.build(parts)
    status.handle(opened(DEAD, "ab12-3"))
    status.tick()
    document = as_json(tmp_path)
    assert document["running"] is True
    assert {fault["fault"]: fault["outcome"] for fault in document["faults"]} == {"ab12-2": "unknown", "ab12-3": "open"}


def test_a_restored_fault_is_open_in_the_status(tmp_path: Path) -> None:
    """The daemon was restarted: the fault that it restored is among the open ones, without a new event."""
    parts = context(Settings(run_dir=str(tmp_path / "run")), clock=SystemClock(), states=lambda: (DEAD,))
    StatusReporter.build(replace(parts, restored=(opened(DEAD, "ab12-2").fault,))).tick()
    assert [entry["fault"] for entry in as_json(tmp_path)["faults"]] == ["ab12-2"]


def test_a_fault_without_recovery_is_listed_until_it_is_resolved(tmp_path: Path) -> None:
    """Given up at any time, in `phm faults` and `phm status`, also after a restart of PHM, and with its current condition."""
    record(tmp_path, opened(DEAD, "ab12-1"), closed(DEAD, Outcome.ESCALATED, "", 9.0, "ab12-1"))
    events: list[Event] = []
    for number in range(30):
        events += [opened(DEAD, f"f-{number}"), closed(DEAD, Outcome.RESOLVED, "itself", 1.0, f"f-{number}")]
    record(tmp_path, *events)
    now = replace(opened(DEAD, "ab12-1").fault, result=replace(DEAD.result, summary="Node n1 is hung"))
    parts = context(Settings(run_dir=str(tmp_path / "run")), clock=SystemClock(), states=lambda: (DEAD,))
    StatusReporter.build(replace(parts, given_up=lambda: (now,))).tick()
    [listed] = [fault for fault in as_json(tmp_path)["faults"] if fault["fault"] == "ab12-1"]
    assert (listed["outcome"], listed["current"], listed["summary"]) == ("escalated", True, "Node n1 is hung")
    assert "given up, not resolved" in invoke(tmp_path).output
    status = CliRunner().invoke(group, ["status", "--run-dir", str(tmp_path / "run")], env={"COLUMNS": "200"}).output
    assert "No faults." not in status
    assert "given up" in status and "Node n1 is hung" in status


def test_an_open_fault_has_its_current_condition(tmp_path: Path) -> None:
    """It has changed since the fault was opened."""
    parts = context(Settings(run_dir=str(tmp_path / "run")), clock=SystemClock(), states=lambda: (DEAD,))
    now = replace(opened(DEAD, "ab12-1").fault, result=replace(DEAD.result, summary="Node n1 is hung"))
    status = StatusReporter.build(replace(parts, open_faults=lambda: (now,)))
    status.handle(opened(DEAD, "ab12-1"))
    status.tick()
    assert [fault["summary"] for fault in as_json(tmp_path)["faults"]] == ["Node n1 is hung"]


def test_only_recent_faults_are_shown_unless_all_is_given(tmp_path: Path) -> None:
    """The last 20 closed faults; `--all` shows every one of the log."""
    events: list[Event] = []
    for number in range(30):
        events += [opened(DEAD, f"f-{number}"), closed(DEAD, Outcome.RESOLVED, "itself", 1.0, f"f-{number}")]
    record(tmp_path, *events)
    assert [fault["fault"] for fault in as_json(tmp_path)["faults"]] == [f"f-{number}" for number in range(10, 30)]
    assert len(as_json(tmp_path, "--all")["faults"]) == 30


@pytest.mark.parametrize(("words", "said"), [((), "no phm.jsonl"), (("zz",), "no phm.jsonl")])
def test_a_missing_log_is_reported(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    """One sentence, exit code 1."""
    result = invoke(tmp_path, *words)
    assert (result.exit_code, said in result.output) == (1, True)


def test_an_unknown_fault_is_reported(tmp_path: Path) -> None:
    """Exit code 1, with the command that lists faults."""
    record(tmp_path, *OPEN)
    result = invoke(tmp_path, "zz")
    assert (result.exit_code, f"`phm faults --all --log-dir {tmp_path}" in result.output) == (1, True)


def test_unexpected_events_are_harmless() -> None:
    """Events with missing parts or of another type, and an endless timeline: nothing raises, everything is limited."""
    malformed: list[dict[str, Any]] = [
        {},
        {"event": "action"},
        {"event": "action", "fault": "x"},
        {"event": "fault_closed", "fault": "y", "blocks": 3},
        {"event": "transition", "blocked_by": 7, "unit": None},
        {"event": "fault_opened", "fault": ["z"]},
    ]
    found = build_timelines([*malformed, *[{"event": "action", "fault": "x"}] * 1000], None)
    assert [episode["fault"] for episode in found] == ["x", "y"]
    assert len(found[0]["timeline"]) == MAX_STEPS
