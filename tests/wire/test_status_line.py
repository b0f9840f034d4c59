"""The operator's lines: their wording is a contract, and they always fit one STATUSTEXT."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from phm.core.model import Layer, Level, Result, Slot, Stamp, UnitState
from phm.wire import status_line
from phm.wire.status_line import Severity
from tests.fakes import records

AGENTS = st.integers(1, 250)
SLOTS = st.sampled_from(Slot)
TEXTS = st.text(max_size=1500)


def unit(slot: Slot, level: Level, brief: str = "", name: str = "") -> UnitState:
    result = Result(level, "a sentence", brief)
    return UnitState(name or f"check/{slot}", "check", slot, Layer.ROS, level, result, Stamp(0.0, 0.0))


HEALTHY = [unit(slot, Level.OK) for slot in Slot if slot <= 8]


def fits(line: str) -> bool:
    return len(line) <= 50 and all(" " <= char <= "~" for char in line) and line == line.strip()


@given(AGENTS, st.sampled_from([Level.WARN, Level.ERROR]), SLOTS, TEXTS, TEXTS)
def test_every_line_fits_whatever_the_names_are(agent: int, level: Level, slot: Slot, first: str, second: str) -> None:
    """No name from outside makes a line longer than 50 characters or adds anything but printable ASCII."""
    lines = [
        status_line.failing(agent, level, slot, first),
        status_line.recovered(agent, slot, first, second),
        status_line.advise(agent, slot, first, second),
        status_line.advise(agent, slot, first, second, 123_456_789),
        status_line.gave_up(agent, slot, first, second),
        status_line.gave_up(agent, slot, first, second, 123_456_789),
        status_line.operator_request(agent, slot, first, "refused", second),
        status_line.refresh(agent, [*HEALTHY, unit(slot, level, first, second)]),
    ]
    assert all(fits(line) for line in lines), lines
    assert all(line.startswith(status_line.agent_name(agent) + " ") for line in lines)


@given(AGENTS, st.lists(st.tuples(SLOTS, st.sampled_from(Level), TEXTS), max_size=40))
def test_the_refresh_always_fits(agent: int, units: list[tuple[Slot, Level, str]]) -> None:
    """Any number of bad units still makes one line, which ends with the number of further ones."""
    states = [unit(*entry) for entry in units]
    line = status_line.refresh(agent, states)
    bad = sum(1 for state in states if state.level.bad)
    assert fits(line)
    assert bad <= 1 or line.endswith(f"+{bad - 1}")


def test_a_fault_names_agent_slot_and_cause() -> None:
    """The line of a fault is the one in the README."""
    assert status_line.failing(1, Level.ERROR, Slot.NODES, "node_1 dead") == "A01 FAIL 6 node_1 dead"
    assert status_line.failing(250, Level.WARN, Slot.HOST, "disk / 88%") == "A250 WARN 9 disk / 88%"


def test_a_recovery_line_names_its_cause() -> None:
    """The operator sees whether it recovered without an action or PHM recovered it."""
    node = "node_1 dead", "restart", "node_1"
    assert status_line.recovered(1, Slot.NODES, *node) == "A01 OK 6 node_1 restarted"
    assert status_line.recovered(1, Slot.NODES, "node_1 dead", "itself", "node_1") == "A01 OK 6 node_1 recovered"
    assert status_line.recovered(1, Slot.COMPANION, "GCS: lost", "reopen") == "A01 OK 1 reopened: GCS: lost"
    silent = "autopilot: no heartbeat 4 s"
    assert status_line.recovered(1, Slot.AUTOPILOT, silent, "reboot") == f"A01 OK 10 rebooted: {silent}"
    assert status_line.recovered(1, Slot.USER_1, "low", "my_action") == "A01 OK 13 fixed by my_action: low"
    assert status_line.recovered(1, Slot.HOST, "disk / 88%") == "A01 OK 9 cleared: disk / 88%"


def test_advice_and_giving_up_name_the_target() -> None:
    """A line that asks for an action names the container."""
    assert status_line.advise(1, Slot.CONTAINER, "restart", "ros_app") == "A01 ADVISE 2 restart ros_app"
    long = "a_container_with_a_very_long_name"
    assert (
        status_line.advise(250, Slot.CONTAINER, "restart", long, 17)
        == "A250 ADVISE 2 restart a_container..y_long_name #17"
    )
    assert (
        status_line.advise(1, Slot.CONTAINER, "restart", "ros_app", 17, 60.0) == "A01 ADVISE 2 restart ros_app #17 60s"
    )
    longest = status_line.advise(250, Slot.USER_3, "a" * 40, long, 999_999_999, 600.0)
    assert longest.endswith(" #999999999 600s")
    assert len(longest) <= status_line.MAX_CHARS
    assert (
        status_line.operator_request(1, Slot.CONTAINER, "restart", "done", "ros_app")
        == "A01 OK 2 restart done: ros_app"
    )
    assert (
        status_line.operator_request(1, Slot.CONTAINER, "restart", "failed", "ros_app")
        == "A01 WARN 2 restart failed: ros_app"
    )
    assert status_line.gave_up(1, Slot.CONTAINER, "ros_app", "ros_app exited") == "A01 GAVE UP 2 ros_app exited"
    assert status_line.gave_up(1, Slot.NODES, "ros_app", "node_1 dead") == "A01 GAVE UP 6 ros_app: node_1 dead"


def test_the_refresh_begins_with_the_worst_unit() -> None:
    """An ERROR comes before a WARN of an earlier slot; the array has 1 for WARN and 0 for ERROR."""
    node, disk = unit(Slot.NODES, Level.ERROR, "node_1 dead"), unit(Slot.COMPANION, Level.WARN, "radio closed")
    others = [state for state in HEALTHY if state.slot is not Slot.NODES]
    assert status_line.refresh(1, HEALTHY) == "A01 OK 11111111"
    assert status_line.refresh(1, [disk, *others, node]) == "A01 FAIL 11111011 6 node_1 dead +1"
    assert status_line.refresh(1, [disk, *HEALTHY]) == "A01 WARN 11111111 1 radio closed"


def test_an_unknown_state_is_never_ok() -> None:
    """An unknown unit is a dash, and the line does not say OK; nor does it without any unit."""
    others = [state for state in HEALTHY if state.slot is not Slot.RATES]
    assert status_line.refresh(1, [*others, unit(Slot.RATES, Level.STALE)]) == "A01 STALE 1111111- 8"
    assert status_line.refresh(1, []) == "A01 STALE --------"
    assert status_line.refresh(1, others) == "A01 OK 1111111-"


def test_a_long_name_keeps_its_beginning_and_the_failure() -> None:
    """The middle is cut: the name of the node and its failure both stay."""
    line = status_line.failing(1, Level.ERROR, Slot.NODES, "a_very_long_node_name_of_somebody_else_entirely_1 dead")
    assert line.startswith("A01 FAIL 6 a_very_long")
    assert line.endswith("_1 dead")
    assert len(line) == 50


@pytest.mark.parametrize("text", ["nod\x00e", "nod\x1b[31me", "nod\ne", "nodé", "nod\u202ee", "node\x7f"])
def test_control_characters_do_not_reach_the_ground(text: str) -> None:
    """A character that could control a terminal or hide text becomes a question mark."""
    assert "?" in status_line.failing(1, Level.ERROR, Slot.NODES, text)


def test_severities_are_those_of_the_contract() -> None:
    """Lost mission function, lost redundancy, warning, resolved, refresh: 2, 3, 4, 5, 6."""
    assert status_line.severity(Level.ERROR, Slot.RATES) is Severity.CRITICAL
    assert status_line.severity(Level.ERROR, Slot.HOST) is Severity.ERROR
    assert status_line.severity(Level.WARN, Slot.NODES) is Severity.WARNING
    assert status_line.severity(Level.OK, Slot.NODES) is Severity.NOTICE
    assert status_line.severity(Level.STALE, Slot.NODES) is Severity.INFO


@pytest.mark.parametrize(
    ("name", "brief", "subject"),
    [
        ("nodes/agent_1/node_1", "node_1 dead", "node_1"),
        ("nodes/agent_1/node_1", "agent_1/node_1 dead", "agent_1/node_1"),
        ("devices//dev/ttyS0", "/dev/ttyS0 gone", "/dev/ttyS0"),
        ("host", "disk / 88%", ""),
        ("gcs", "GCS: no heartbeat", ""),
        ("nodes/n\u00f6de", "n\u00f6de dead", ""),
        ("nodes/a_name_of_more_than_16", "a_name_of_more_than_16 dead", ""),
    ],
)
def test_the_subject_of_a_unit_is_the_name_with_which_its_brief_begins(name: str, brief: str, subject: str) -> None:
    """Only a short, printable name identifies the unit when it recovers."""
    assert status_line.subject_of(records.unit(name, Slot.NODES, Level.ERROR, brief=brief)) == subject
