"""The consensus on /phm/consensus: the contract of docs/reference/ros.md."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import phm
from phm.core.model import Level, NodeVotes, Result, Slot
from phm.core.settings import Settings
from phm.facts.ros import CONSENSUS, DIAGNOSTICS, DiagnosticFact
from phm.probes.ros.protocol import LINE_LIMIT, Publish, encode_order
from phm.reporters.consensus import AT_LEAST_S, MAX_NODES, ConsensusReporter
from phm.testing import FakeClock
from tests.fakes.records import context, transition, unit

DOCUMENT = Path(phm.__file__).parents[1] / "docs" / "reference" / "ros.md"
ROS: dict[str, Any] = {"nodes": [{"name": "/agent_1/a"}]}
ALIVE = NodeVotes("agent_1/a", "alive", ("agent_1/b", "PHM"))
DEAD = NodeVotes("agent_1/c", "dead", ("PHM",), ("agent_1/a", "agent_1/b"))
A, C = "phm/agent_1/consensus: agent_1/a", "phm/agent_1/consensus: agent_1/c"


class Port:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.sent: list[Mapping[str, DiagnosticFact]] = []
        self.not_taken = 0

    def idle(self, topic: str = DIAGNOSTICS) -> bool:
        return False

    def publish(self, statuses: Mapping[str, DiagnosticFact], topic: str = DIAGNOSTICS) -> int:
        assert topic == CONSENSUS
        self.sent.append(statuses)
        return self.not_taken


class Scene:
    """A reporter whose check returns `result`."""

    def __init__(self, *votes: NodeVotes) -> None:
        self.port, self.clock, self.alive = Port(), FakeClock(), True
        self.result: Result | None = Result(Level.OK, "fine", votes=votes)
        made = context(Settings.model_validate({"ros": ROS}), clock=self.clock, alive=lambda: self.alive)
        newest = {"consensus": lambda: self.result}
        reporter = ConsensusReporter.build(replace(made, ros=self.port, newest=lambda unit: newest[unit]()))
        assert reporter is not None
        self.reporter = reporter

    def tick(self, seconds: float = 1.0) -> int:
        """The number of arrays published until now."""
        self.clock.advance(seconds)
        self.reporter.tick()
        return len(self.port.sent)


def test_each_node_is_a_status_with_its_votes() -> None:
    """A dead node is ERROR, a living one OK."""
    scene = Scene(ALIVE, DEAD)
    scene.tick()
    (sent,) = scene.port.sent
    assert {name: (fact.level, fact.message, fact.hardware_id) for name, fact in sent.items()} == {
        A: (0, "alive: 2 alive, 0 dead", "agent_1"),
        C: (2, "dead: 1 alive, 2 dead", "agent_1"),
    }
    assert dict(sent[C].values) == {
        "node": "agent_1/c",
        "verdict": "dead",
        "alive": "PHM",
        "dead": "agent_1/a, agent_1/b",
    }


def observers(count: int) -> tuple[str, ...]:
    return tuple(f"agent_1/localization_node_{number}" for number in range(count))


def test_many_observers_are_complete() -> None:
    """A subscriber compares them with the names that it knows."""
    scene = Scene(NodeVotes("agent_1/a", "alive", (*observers(30), "PHM")))
    scene.tick()
    assert scene.port.sent[0][A].values["alive"].split(", ") == [*observers(30), "PHM"]


def test_extremely_many_observers_are_cut_between_names() -> None:
    """All arrays pass the pipe to the ROS child in one line."""
    names = observers(400)
    scene = Scene(*(NodeVotes(f"agent_1/{number}", "dead", names, names) for number in range(MAX_NODES)))
    scene.tick()
    values = [fact.values for fact in scene.port.sent[0].values()]
    assert len(encode_order(Publish(1.0, scene.port.sent[0], CONSENSUS))) < LINE_LIMIT
    for text in (values[0]["alive"], values[-1]["dead"]):
        *shown, more = text.split(", ")
        assert tuple(shown) == names[: len(shown)] and more == f"and {400 - len(shown)} more"


def test_consensus_is_published_on_change_and_every_few_seconds() -> None:
    """A change of a unit of the nodes is looked at immediately."""
    scene = Scene(ALIVE)
    assert scene.tick() == 1
    assert scene.tick() == 1
    assert scene.tick(AT_LEAST_S) == 2
    scene.result = Result(Level.OK, "fine", votes=(DEAD,))
    scene.reporter.handle(transition(unit("rates/t", Slot.RATES)))
    assert len(scene.port.sent) == 2
    scene.reporter.handle(transition(unit("nodes/agent_1/c", Slot.NODES)))
    assert len(scene.port.sent) == 3


def test_nothing_is_published_before_the_first_consensus() -> None:
    """Without a result, or without a beacon."""
    scene = Scene()
    assert scene.tick() == 0
    scene.result = None
    assert scene.tick() == 0


def test_an_unknown_consensus_makes_its_nodes_stale() -> None:
    """With the reason; the next consensus replaces it."""
    scene = Scene(ALIVE)
    scene.tick()
    scene.result = Result(Level.STALE, "no child")
    scene.tick()
    assert {name: (fact.level, fact.message) for name, fact in scene.port.sent[-1].items()} == {A: (3, "no child")}


def test_at_the_end_all_nodes_are_stale() -> None:
    """After a reload of the configuration the next reporter continues."""
    scene = Scene(ALIVE)
    scene.reporter.close()
    assert not scene.port.sent
    scene.tick()
    scene.reporter.hand_over()
    assert len(scene.port.sent) == 1
    scene.reporter.close()
    assert scene.port.sent[-1][A].message == "PHM has stopped"


def test_a_hung_scheduler_publishes_nothing() -> None:
    """Subscribers see the statuses become stale."""
    scene = Scene(ALIVE)
    scene.alive = False
    assert scene.tick() == 0


def test_publishing_of_consensus_can_be_switched_off() -> None:
    """By configuration, and there is nothing to report without nodes."""
    for ros in ({}, {**ROS, "consensus": {"publish": False}}):
        made = context(Settings.model_validate({"ros": ros}))
        assert ConsensusReporter.build(replace(made, ros=Port())) is None
    assert ConsensusReporter.build(context(Settings.model_validate({"ros": ROS}))) is None


def test_a_child_that_takes_nothing_is_a_problem() -> None:
    """`phm status` shows it."""
    scene = Scene(ALIVE)
    scene.port.not_taken = 5
    scene.tick()
    assert scene.reporter.problem().startswith("/phm/consensus is not published")


def test_the_contract_is_documented() -> None:
    """docs/reference/ros.md names exactly the keys that are published."""
    scene = Scene(DEAD)
    scene.tick()
    text = DOCUMENT.read_text().partition("### Verdict topic")[2].partition("\n## ")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)) == set(scene.port.sent[-1][C].values)
