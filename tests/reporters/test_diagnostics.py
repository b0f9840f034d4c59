"""PHM's own state as ROS diagnostics: the contract of docs/reference/ros.md."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import phm
from phm.core.model import ActionEvent, Layer, Level, Outcome, Phase, Slot, UnitState
from phm.core.settings import Settings
from phm.facts.ros import DIAGNOSTICS, DiagnosticFact
from phm.reporters.diagnostics import ALONG_S, MAX_MESSAGE, MAX_UNITS, MAX_VALUES, DiagnosticsReporter
from phm.testing import FakeClock
from tests.fakes.records import at, closed, context, fault, opened, transition, unit

DOCUMENT = Path(phm.__file__).parents[1] / "docs" / "reference" / "ros.md"
DEAD = unit(
    "nodes/agent_1/node_1",
    Slot.NODES,
    Level.ERROR,
    "Node is dead",
    brief="node_1 dead",
    condition="node_missing",
    target="ros_app",
    values={"listed": 0},
    fault="ab12-1",
)
BLOCKED = unit("topics/agent_1/topic_1", Slot.TOPICS, Level.STALE, "blocked by it", blocked_by=DEAD.unit)
HEALTHY = unit("container/ros_app", Slot.CONTAINER, summary="ros_app is running")
NODE, TOPIC, CONTAINER = (f"phm/agent_1/ros: {state.unit}" for state in (DEAD, BLOCKED, HEALTHY))
SUMMARY = "phm/agent_1: summary"
ROS: dict[str, Any] = {"nodes": [{"name": "/agent_1/node_1"}]}


class Port:
    """Keeps what is published; refuses it on request."""

    def __init__(self) -> None:
        self.sent: list[Mapping[str, DiagnosticFact]] = []
        self.not_taken = 0
        self.without_subscriber = False

    def idle(self, topic: str = DIAGNOSTICS) -> bool:
        return self.without_subscriber

    def publish(self, statuses: Mapping[str, DiagnosticFact], topic: str = DIAGNOSTICS) -> int:
        self.sent.append(statuses)
        return self.not_taken


PORT = Port()


def make(states: tuple[UnitState, ...] = (), ros: Any = ROS, **parts: Any) -> tuple[DiagnosticsReporter, Port]:
    port = Port()
    settings = Settings.model_validate({"ros": ros})
    made = DiagnosticsReporter.build(replace(context(settings, states=lambda: states, **parts), ros=port))
    assert made is not None
    return made, port


def test_each_unit_and_the_summary_are_a_status() -> None:
    """Name, level, message and hardware id follow the conventions of diagnostic_updater."""
    reporter, port = make((HEALTHY, DEAD, BLOCKED))
    reporter.handle(opened(DEAD))
    (sent,) = port.sent
    assert [(name, fact.level, fact.message) for name, fact in sent.items()] == [
        (SUMMARY, 2, "1 open fault: node_1 dead"),
        (CONTAINER, 0, "ros_app is running"),
        (NODE, 2, "Node is dead"),
        (TOPIC, 3, "blocked by it"),
    ]
    assert {fact.hardware_id for fact in sent.values()} == {"agent_1"}


def test_a_unit_has_the_contract_keys_and_its_values() -> None:
    """All contract keys, then the measured values; an action is reported while its fault is open."""
    reporter, port = make((DEAD,))
    reporter.handle(opened(DEAD))
    reporter.handle(ActionEvent(at(), "ab12-1", DEAD.unit, "restart", "ros_app", Phase.STARTED))
    reporter.tick()
    assert dict(port.sent[-1][NODE].values) == {
        "unit": DEAD.unit,
        "check": "nodes",
        "slot": "6",
        "since": "2026-03-01T12:00:00.123Z",
        "condition": "node_missing",
        "blocked_by": "",
        "fault": "ab12-1",
        "action": "restart started",
        "target": "ros_app",
        "listed": "0",
    }
    reporter.handle(closed(DEAD, Outcome.RESOLVED, "restart", 2.0))
    reporter.tick()
    assert port.sent[-1][NODE].values["action"] == ""
    assert port.sent[-1][SUMMARY].message == "0 of 1 units are OK"


def test_the_summary_has_array_word_and_counts() -> None:
    """Array and word as sent to the ground, and the number of units of each level."""
    reporter, port = make((HEALTHY, DEAD, BLOCKED))
    reporter.tick()
    values = port.sent[-1][SUMMARY].values
    assert (values["status_array"], values["agent_id"]) == ("[-, 1, -, -, -, 0, -, -]", "1")
    assert [values[key] for key in ("ok", "warn", "error", "stale", "open_faults")] == ["1", "0", "1", "1", "0"]


def test_the_contract_is_documented() -> None:
    """docs/reference/ros.md names exactly the keys that are published."""
    reporter, port = make((HEALTHY,))
    reporter.tick()
    text = DOCUMENT.read_text().partition("### Published by PHM")[2].partition("\n### ")[0]
    tables = text.partition("\nEach unit")[2].split("\nThe summary")
    documented = [set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) for table in tables]
    assert documented == [set(port.sent[-1][CONTAINER].values), set(port.sent[-1][SUMMARY].values)]


def test_layers_are_part_of_the_name() -> None:
    """An aggregator groups by prefix."""
    reporter, port = make((replace(HEALTHY, layer=Layer.DOCKER),))
    reporter.tick()
    assert "phm/agent_1/docker: container/ros_app" in port.sent[-1]


def test_a_change_is_published_immediately_and_a_burst_once() -> None:
    """The first event publishes; events within the next tenth of a second wait for the tick."""
    clock = FakeClock()
    reporter, port = make((DEAD,), clock=clock)
    reporter.handle(transition(DEAD))
    clock.advance(ALONG_S / 2)
    reporter.handle(transition(DEAD))
    assert len(port.sent) == 1
    reporter.tick()
    assert len(port.sent) == 2


def test_only_what_has_changed_is_made_again() -> None:
    """Most units are the same in the next array. A new result, level, cause or action is shown; a new duration is not a change."""
    states = [DEAD, BLOCKED]
    port = Port()
    chosen = Settings.model_validate({"ros": ROS})
    made = DiagnosticsReporter.build(replace(context(chosen, states=lambda: tuple(states)), ros=port))
    assert made is not None
    made.handle(opened(DEAD))
    made.tick()
    first = port.sent[-1]
    states[0] = replace(DEAD, result=replace(DEAD.result), duration_s=9.0)
    made.tick()
    assert port.sent[-1][NODE] is first[NODE] and port.sent[-1][TOPIC] is first[TOPIC]
    states[:] = [
        replace(DEAD, result=replace(DEAD.result, values={"listed": 1})),
        replace(BLOCKED, blocked_by="network"),
    ]
    made.tick()
    assert port.sent[-1][NODE].values["listed"] == "1" and port.sent[-1][TOPIC].values["blocked_by"] == "network"
    made.handle(ActionEvent(at(), "ab12-1", DEAD.unit, "restart", "ros_app", Phase.STARTED))
    made.tick()
    assert port.sent[-1][NODE].values["action"] == "restart started"


def test_without_a_subscriber_nothing_is_made() -> None:
    """Neither each second nor on a change; the next tick after one has come publishes."""
    reporter, port = make((HEALTHY,))
    port.without_subscriber = True
    reporter.tick()
    reporter.handle(transition(HEALTHY))
    assert port.sent == []
    port.without_subscriber = False
    reporter.tick()
    assert len(port.sent) == 1


def test_a_stalled_scheduler_publishes_nothing() -> None:
    """A dead man's switch: outdated states must not look current."""
    reporter, port = make((HEALTHY,), alive=lambda: False)
    reporter.tick()
    reporter.handle(transition(HEALTHY))
    assert port.sent == []


def test_close_publishes_the_end() -> None:
    """The last array states for each status that it is no longer known."""
    reporter, port = make((HEALTHY, DEAD))
    reporter.close()
    assert {(fact.level, fact.message) for fact in port.sent[-1].values()} == {(3, "PHM has stopped")}
    assert set(port.sent[-1]) == {SUMMARY, CONTAINER, NODE}


def test_the_size_of_an_array_is_limited(caplog: pytest.LogCaptureFixture) -> None:
    """Units, texts and values: an array must fit through the pipe. What is left out is logged once."""
    long = unit("x/y", Slot.HOST, Level.WARN, "a\n" * 500, values={f"v{n}": "b" * 999 for n in range(99)})
    states = (long, *(unit(f"x/{n}", Slot.HOST) for n in range(2 * MAX_UNITS)))
    reporter, port = make(states)
    reporter.tick()
    reporter.tick()
    assert caplog.messages == [
        f"{MAX_UNITS + 1} of {2 * MAX_UNITS + 1} units are not on /diagnostics: it has at most 500"
    ]
    fact = port.sent[-1]["phm/agent_1/ros: x/y"]
    assert len(port.sent[-1]) == MAX_UNITS + 1
    assert len(fact.message) == MAX_MESSAGE and fact.message.isprintable()
    assert len(fact.values) == 9 + MAX_VALUES and max(map(len, fact.values.values())) == 120


def test_a_contract_key_is_not_replaced_by_a_measured_one() -> None:
    """A check's own value `fault` or `slot` does not hide PHM's."""
    reporter, port = make((unit("x", Slot.HOST, values={"slot": 99, "flag": True, "none": None}),))
    reporter.tick()
    values = port.sent[-1]["phm/agent_1/ros: x"].values
    assert (values["slot"], values["flag"], values["none"]) == ("9", "true", "")


def test_a_child_that_accepts_nothing_is_a_problem() -> None:
    """One array that had to wait is not a problem; five consecutive ones are."""
    reporter, port = make()
    port.not_taken = 4
    reporter.tick()
    assert reporter.problem() == ""
    port.not_taken = 5
    reporter.tick()
    assert "last 5 arrays" in reporter.problem()


def test_faults_from_before_a_restart_of_phm_are_published() -> None:
    """They were reported then, and are still open."""
    settings = Settings.model_validate({"ros": ROS})
    port = Port()
    made = DiagnosticsReporter.build(replace(context(settings), ros=port, restored=(fault(DEAD),)))
    assert made is not None
    made.tick()
    assert port.sent[-1][SUMMARY].message == "1 open fault: node_1 dead"


def test_the_reporter_exists_when_ros_is_used_and_not_disabled() -> None:
    """By default with nodes, topics or watched diagnostics; also alone when enabled; never without a ROS child."""

    def built(ros: Any, port: Port | None = PORT) -> bool:
        settings = Settings.model_validate({"ros": ros})
        return DiagnosticsReporter.build(replace(context(settings), ros=port)) is not None

    assert (
        built(ROS) and built({"diagnostics": {"watch": [{"name": "x"}]}}) and built({"diagnostics": {"publish": True}})
    )
    assert not built({}) and not built({**ROS, "diagnostics": {"publish": False}}) and not built(ROS, None)
