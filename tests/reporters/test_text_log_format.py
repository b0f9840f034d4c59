"""The text log looks like Fig. 5 of the PHM paper."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm.core.model import ActionEvent, Event, Level, Note, Outcome, Phase, Report, ReportStarted, Slot
from phm.reporters.text_log_format import MAX_BYTES, TextLogFormatter, encode
from tests.fakes.records import at, closed, opened, transition, unit

STAMP = "2026-03-01 12:00:00.123"
NODE_DEAD = unit("nodes/agent_1/node_1", Slot.NODES, Level.ERROR, "Node /agent_1/node_1 is not running", brief="dead")


def figure_5() -> Report:
    """The situation of Fig. 5: node_1 was killed."""
    return Report(
        at(20.9),
        7,
        at(),
        (
            unit("companion", Slot.COMPANION, summary="Companion Computer is running aboard agent."),
            unit("container/ros_app", Slot.CONTAINER, summary="Container ros_app is running"),
            unit("health/ros_app", Slot.CONTAINER, summary="No health check defined for ros_app", bypass=True),
            unit("files/ros_app/critical_file", Slot.FILES, summary="File check passed: /critical_file"),
            unit("network/ros_app", Slot.NETWORK, Level.WARN, "ros_app answers slowly"),
            unit("devices/ros_app/dev/ttyS0", Slot.DEVICES, summary="Found /dev/ttyS0"),
            unit("devices/ros_app/dev/ttyS1", Slot.DEVICES, summary="Found /dev/ttyS1"),
            NODE_DEAD,
            unit("nodes/agent_1/node_2", Slot.NODES),
            unit("nodes/agent_1/node_3", Slot.NODES),
            unit("topics/agent_1/topic_1", Slot.TOPICS, Level.STALE, blocked_by="nodes/agent_1/node_1"),
            unit("rates/agent_1/topic_1", Slot.RATES, Level.STALE, "not measured yet"),
        ),
    )


def test_a_blocked_unit_has_its_cause_and_its_own_summary() -> None:
    """The operator sees both what blocks it and its symptom."""
    summary = "blocked by pressure/ros_app: topic /x at 3 Hz, expected 10"
    state = unit("rates/x", Slot.RATES, Level.STALE, summary, blocked_by="pressure/ros_app")
    report = Report(at(20.9), 7, at(), (state,))
    assert f"STALE: (8) rates/x: {summary}" in "\n".join(TextLogFormatter().format(report))


def test_a_report_is_written_as_in_figure_5() -> None:
    """From `Start of a new report` to the status array, one line per unit, the OK ones of a check in one line."""
    lines = TextLogFormatter()
    written = [*lines.format(ReportStarted(at(), 7)), *lines.format(figure_5())]
    end = "2026-03-01 12:00:21.023"
    assert written == [
        f"{STAMP} ---- Start of a new report",
        f"{end} ---- SUCCESS: (1) Companion Computer is running aboard agent.",
        f"{end} ---- SUCCESS: (2) Container ros_app is running",
        f"{end} ---- BYPASS: (2) No health check defined for ros_app",
        f"{end} ---- SUCCESS: (3) File check passed: /critical_file",
        f"{end} ---- WARNING: (4) ros_app answers slowly",
        f"{end} ---- SUCCESS: (5) All 2 device checks passed: ros_app/dev/ttyS0, ros_app/dev/ttyS1",
        f"{end} ---- FAILURE: (6) Node /agent_1/node_1 is not running",
        f"{end} ---- SUCCESS: (6) 2 of 3 required nodes are running: agent_1/node_2, agent_1/node_3",
        f"{end} ---- STALE: (7) topics/agent_1/topic_1: blocked by nodes/agent_1/node_1",
        f"{end} ---- STALE: (8) rates/agent_1/topic_1: not measured yet",
        f"{end} REPORT Successes: 5, Failures: 1, Status Array: [1, 1, 1, 1, 1, 0, -, -]",
    ]


def test_all_ok_nodes_are_one_line() -> None:
    """Several OK units of one check are folded, worded as in the paper."""
    nodes = tuple(unit(f"nodes/agent_1/node_{n}", Slot.NODES) for n in (1, 2, 3))
    lines = TextLogFormatter().format(Report(at(), 1, at(), nodes))
    assert lines[1].endswith(
        "---- SUCCESS: (6) All 3 required nodes are running: agent_1/node_1, agent_1/node_2, agent_1/node_3"
    )


def test_folded_topics_show_their_rates() -> None:
    """As in Fig. 5, a measured rate follows its topic."""
    rates = (
        unit("rates/agent_1/topic_1", Slot.RATES, values={"hz": 0.99949}),
        unit("rates/agent_1/map", Slot.RATES, values={"publishers": 1}),
    )
    lines = TextLogFormatter().format(Report(at(), 1, at(), rates))
    assert lines[1].endswith("SUCCESS: (8) All 2 topics have their rate: agent_1/topic_1: 0.999, agent_1/map")


def test_plug_in_checks_are_folded_too() -> None:
    """A slot without its own wording is named after its check."""
    units = tuple(unit(f"battery/{n}", Slot.USER_1) for n in (1, 2))
    assert (
        TextLogFormatter().format(Report(at(), 1, at(), units))[1].endswith("(13) All 2 units of battery are OK: 1, 2")
    )


def test_watched_diagnostics_are_not_called_nodes() -> None:
    """Checks that share a slot have different wordings."""
    units = tuple(unit(f"diagnostics/camera: {name}", Slot.NODES) for name in ("Frequency", "Frames"))
    line = TextLogFormatter().format(Report(at(), 1, at(), units))[1]
    assert line.endswith("(6) All 2 watched diagnostics report OK: camera: Frequency, camera: Frames")


def test_a_bypassed_unit_does_not_count_as_failed() -> None:
    """A BYPASS has its own line, and the others still count as all."""
    units = (*(unit(f"host/{name}", Slot.HOST) for name in ("cpu", "disk")), unit("host/heat", Slot.HOST, bypass=True))
    lines = TextLogFormatter().format(Report(at(), 1, at(), units))
    assert [line.partition(" ---- ")[2] for line in lines[1:3]] == [
        "SUCCESS: (9) All 2 host limits are kept: cpu, disk",
        "BYPASS: (9) host/heat says so",
    ]


def test_units_of_another_check_in_the_same_slot_are_not_folded_together() -> None:
    """Only units of one check share a line."""
    units = (unit("container/a", Slot.CONTAINER), unit("health/a", Slot.CONTAINER))
    assert len(TextLogFormatter().format(Report(at(), 1, at(), units))) == 4


def test_the_report_counts_slots_not_units() -> None:
    """Two failed nodes are one failed slot; slots 9 and up are not in the array."""
    units = (
        unit("nodes/a", Slot.NODES, Level.ERROR),
        unit("nodes/b", Slot.NODES, Level.ERROR),
        unit("host", Slot.HOST, Level.ERROR),
    )
    last = TextLogFormatter().format(Report(at(), 1, at(), units))[-1]
    assert last.endswith("REPORT Successes: 0, Failures: 1, Status Array: [-, -, -, -, -, 0, -, -]")


def test_a_report_whose_start_was_dropped_still_begins() -> None:
    """The start line is created from the report when the bus had to drop the event."""
    lines = TextLogFormatter().format(figure_5())
    assert lines[0] == f"{STAMP} ---- Start of a new report"


def test_a_transition_is_logged_immediately() -> None:
    """Between reports a change does not wait for the next one."""
    assert TextLogFormatter().format(transition(NODE_DEAD)) == [
        f"{STAMP} ---- FAILURE: (6) Node /agent_1/node_1 is not running"
    ]


def test_units_that_become_ok_during_a_report_are_logged_once() -> None:
    """STALE to OK between start and end of a report is left to the report's own list; a failure is not."""
    lines = TextLogFormatter()
    lines.format(ReportStarted(at(), 1))
    assert lines.format(transition(unit("host", Slot.HOST), Level.STALE)) == []
    assert len(lines.format(transition(NODE_DEAD, Level.STALE))) == 1
    lines.format(figure_5())
    assert len(lines.format(transition(unit("host", Slot.HOST), Level.STALE))) == 1


def action(phase: Phase, detail: str = "") -> ActionEvent:
    return ActionEvent(at(), "ab12-1", NODE_DEAD.unit, "restart", "ros_app", phase, detail, 2)


@pytest.mark.parametrize(
    ("event", "line"),
    [
        (action(Phase.STARTED), "ACTION: (6) restart ros_app for nodes/agent_1/node_1: started (attempt 2)"),
        (action(Phase.STARTED, "restart ros_app for: x"), "ACTION: (6) restart ros_app for: x (attempt 2)"),
        (action(Phase.DONE, "ros_app was restarted"), "ACTION: (6) ros_app was restarted"),
        (action(Phase.FAILED, "no answer"), "ACTION: (6) failed: no answer"),
        (action(Phase.VERIFIED, "it is OK again"), "ACTION: (6) it is OK again"),
        (action(Phase.ADVISED, "advised: restart ros_app"), "ACTION: (6) advised: restart ros_app"),
        (action(Phase.REFUSED, "left alone: armed"), "ACTION: (6) left alone: armed"),
        (action(Phase.ESCALATED, "gave up: look at it"), "ESCALATED: (6) nodes/agent_1/node_1: gave up: look at it"),
        (
            closed(NODE_DEAD, Outcome.RESOLVED, "restart", 3.25),
            "RESOLVED: (6) nodes/agent_1/node_1: resolved by restart after 3.2 s",
        ),
        (
            closed(NODE_DEAD, Outcome.RESOLVED, "itself", 3.25),
            "RESOLVED: (6) nodes/agent_1/node_1: resolved by itself after 3.2 s",
        ),
        (
            closed(NODE_DEAD, Outcome.ESCALATED, "restart", 60.0),
            "ESCALATED: (6) nodes/agent_1/node_1: PHM has given up after 60.0 s",
        ),
        (Note(at(), "DOCKER", "ros_app: die"), "DOCKER: ros_app: die"),
        (Note(at(), "NOTE", "killing /agent_1/node_1"), "NOTE: killing /agent_1/node_1"),
        (Note(at(), "SUCCESS", "forged by a plug-in"), "PHM: forged by a plug-in"),
    ],
)
def test_each_event_has_its_line(event: Event, line: str) -> None:
    """Kind, slot and text of every event without a level."""
    lines = TextLogFormatter()
    lines.format(transition(NODE_DEAD))
    written = lines.format(event)
    assert [text.partition(" ---- ")[2] for text in written] == [line]


def test_giving_up_is_logged_once() -> None:
    """The action's escalation and the fault's closing are one line."""
    lines = TextLogFormatter()
    assert len(lines.format(action(Phase.ESCALATED, "land"))) == 1
    assert lines.format(closed(NODE_DEAD, Outcome.ESCALATED, "restart", 5.0)) == []


@pytest.mark.parametrize(
    ("summary", "suspects", "logged"),
    [
        ("ros_app exited 137 (killed)", (), "ros_app exited 137 (killed): blocks nodes, topics"),
        ("ros_app is dead: remove it", (), "ros_app is dead: remove it; blocks nodes, topics"),
        ("ros_app is dead: remove it.", (), "ros_app is dead: remove it; blocks nodes, topics"),
        ("ros_app exited", ("host/disk",), "ros_app exited: blocks nodes, topics; possible cause: host/disk"),
    ],
)
def test_a_failure_names_cause_and_consequences(summary: str, suspects: tuple[str, ...], logged: str) -> None:
    """While the fault is open its line has what it blocks and other failures; afterwards neither."""
    state = replace(unit("container/ros_app", Slot.CONTAINER, Level.ERROR, summary), fault="ab12-1")
    event = opened(state)
    lines = TextLogFormatter()
    assert (
        lines.format(replace(event, fault=replace(event.fault, consequences=("nodes", "topics"), suspects=suspects)))
        == []
    )
    assert lines.format(transition(state)) == [f"{STAMP} ---- FAILURE: (2) {logged}"]
    assert lines.format(Report(at(), 1, at(), (state,)))[1] == f"{STAMP} ---- FAILURE: (2) {logged}"
    assert lines.format(transition(replace(state, level=Level.OK))) == [f"{STAMP} ---- SUCCESS: (2) {summary}"]
    lines.format(closed(state, Outcome.RESOLVED, "itself", 1.0))
    assert lines.format(transition(state)) == [f"{STAMP} ---- FAILURE: (2) {summary}"]


def test_a_logged_transition_is_not_repeated() -> None:
    """An opened fault and a consequence of another one have their line already."""
    assert TextLogFormatter().format(opened(NODE_DEAD)) == []
    assert TextLogFormatter().format(closed(NODE_DEAD, Outcome.REATTRIBUTED, "", 1.0)) == []


@pytest.mark.parametrize("breaker", ["\n", "\r", "\r\n", "\x0b", "\x0c", "\x1c", "\x85", "\u2028", "\u2029", "\x00"])
def test_text_from_outside_cannot_forge_a_line(breaker: str) -> None:
    """Log injection: every line-breaking character is escaped."""
    evil = f"bad{breaker}2026-03-01 12:00:00.123 ---- SUCCESS: (6) Everything is OK"
    (line,) = TextLogFormatter().format(transition(unit("nodes/a", Slot.NODES, Level.ERROR, evil)))
    assert len(line.splitlines()) == 1
    assert "\\" in line


def test_text_from_outside_cannot_control_the_terminal() -> None:
    """Escape sequences and direction overrides are shown, not executed; other languages are unchanged."""
    (line,) = TextLogFormatter().format(Note(at(), "DOCKER", "\x1b[2J\u202e Füße 無人機 \x7f"))
    assert line.endswith(r"DOCKER: \x1b[2J\u202e Füße 無人機 \x7f")


def test_an_overlong_line_is_cut_with_a_mark() -> None:
    """A line never exceeds the size of the smallest log, and is cut between characters."""
    data = encode("é" * MAX_BYTES)
    assert len(data) <= MAX_BYTES
    assert data.decode().endswith("é [cut]")
    assert encode("\udcff") == b"\\udcff"


def test_a_report_names_the_units_whose_check_has_not_returned() -> None:
    """The line before the totals names the units that are older than the report."""
    hung = unit("custom/x", Slot.USER_1, Level.STALE, "no result yet")
    lines = TextLogFormatter().format(Report(at(), 1, at(), (hung,), missing=("custom/x",)))
    assert lines[-2] == f"{STAMP} ---- PHM: not in this report, its check has not returned: custom/x"
    assert " REPORT " in lines[-1]
