"""A real lifecycle node: its states through the real child, and its faults through the real checks and the real tracker."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from phm import testing
from phm.checking import plan
from phm.checking.check_turns import CheckRun
from phm.checking.pipeline import Pipeline
from phm.checking.scheduler import CheckScheduler
from phm.core.bus import Bus
from phm.core.clock import SystemClock
from phm.core.model import Event, FaultOpened, Level
from phm.facts import AnswerFact, RosFact
from phm.probes.ros.protocol import ReadinessUpdate, Wanted
from phm.probes.ros.readiness import ReadinessReader
from phm.probes.ros.supervisor import RosSupervisor
from phm.tracker import Tracker
from phm_checks.node_ready import NodeReady
from phm_checks.nodes import Nodes
from tests.fakes.ros_bench import Bench, seen, until

NODE, TOPIC, SERVICE, CALL = "/agent_1/planner", "/agent_1/plan", "/agent_1/plan_path", "/agent_1/is_ready"
READY = {"lifecycle": "active", "topics": [TOPIC], "services": [SERVICE], "call": CALL, "within": "5s"}
ROS: dict[str, Any] = {"nodes": [{"name": NODE, "ready": READY}], "grace": "5s"}


class Planner:
    """The node, and the transitions that it is asked for."""

    def __init__(self, bench: Bench) -> None:
        self.process: subprocess.Popen[bytes] = bench.script("ros_lifecycle.py", "planner")

    def do(self, transition: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{transition}\n".encode())
        self.process.stdin.flush()


def lifecycle(fact: RosFact) -> AnswerFact:
    return fact.lifecycle.get(NODE, AnswerFact())


def test_each_state_of_a_lifecycle_node_is_seen(bench: Bench) -> None:
    """From its start to its end, with the service and topic that it has only in some of them."""
    probe = bench.probe(**ROS)
    assert seen(probe, lambda fact: not lifecycle(fact).served and fact.services == {SERVICE: 0}, "no node yet")
    node = Planner(bench)
    seen(probe, lambda fact: lifecycle(fact).answer == "unconfigured", "the node unconfigured")
    node.do("configure")
    seen(probe, lambda fact: lifecycle(fact).answer == "inactive" and fact.services[SERVICE] == 1, "the node inactive")
    assert seen(probe, lambda fact: fact.topics[TOPIC].publishers, "its publisher")
    assert seen(probe, lambda fact: fact.calls[CALL].answer, "its answer") == "false"
    assert seen(probe, lambda fact: fact.calls[CALL].detail, "its reason") == "waits for its activation"
    node.do("activate")
    seen(probe, lambda fact: lifecycle(fact).answer == "active", "the node active")
    seen(
        probe,
        lambda fact: (fact.topics[TOPIC].rate or None) and fact.topics[TOPIC].rate.silent_s is not None,
        "its data",
    )
    seen(probe, lambda fact: fact.calls[CALL].answer == "true", "its new answer")
    node.do("fail")
    seen(probe, lambda fact: lifecycle(fact).answer == "finalized", "the node finalized")
    node.do("block")
    seen(probe, lambda fact: lifecycle(fact).unanswered_s > 3, "no answer of a blocked executor")
    node.process.kill()
    seen(probe, lambda fact: lifecycle(fact) == AnswerFact(), "no service after its end")


class Agent:
    """Liveness and readiness of the node, judged as in the daemon; keeps faults."""

    def __init__(self, bench: Bench, probe: RosSupervisor) -> None:
        self.clock, self.faults = SystemClock(), list[Event]()
        made = plan.build_plan(testing.settings(ros=ROS), {"nodes": Nodes, "node_ready": NodeReady})
        bus = Bus(self.clock)
        self.pipeline = Pipeline(Tracker(made.tracked, made.graph, self.clock.stamp()), bus, self.clock)
        world = testing.world(clock=self.clock, ros=probe)
        self.scheduler = CheckScheduler(made.scheduled, world, self.clock, self._take)
        self.pipeline.attach(self.scheduler.wake_units)
        bench.on_change = lambda: self.scheduler.wake_subject("ros")
        bus.subscribe("test", self.faults.append, kinds=(FaultOpened,))
        self.scheduler.start()

    def _take(self, run: CheckRun) -> None:
        self.pipeline.observe(dict(run.units), run.started, run.duration_s, overdue=run.overdue)

    def until(self, check: str, level: Level, words: str) -> None:
        def found() -> bool:
            self.pipeline.tick()
            states = {state.check: state for state in self.pipeline.states()}
            return states[check].level is level and words in states[check].result.summary

        until(found, f"{check} {level.name}: {words}")


@pytest.fixture
def node(bench: Bench) -> Planner:
    return Planner(bench)


def is_ready(fact: RosFact) -> bool:
    """Whether the node is listed and active, and has all that READY names."""
    rate = fact.topics[TOPIC].rate
    received = rate is not None and rate.silent_s is not None
    answers = lifecycle(fact).answer == "active" and fact.calls[CALL].answer == "true"
    return NODE in fact.nodes and answers and fact.services[SERVICE] == 1 and received


@pytest.fixture
def agent(bench: Bench, node: Planner) -> Iterator[Agent]:
    """It begins once the node is ready: on a busy machine a start takes longer than the grace, which would rightly be a fault."""
    probe = bench.probe(**ROS)
    node.do("configure")
    node.do("activate")
    seen(probe, is_ready, "the node ready")
    made = Agent(bench, probe)
    yield made
    made.scheduler.stop()


@pytest.mark.one_distribution
def test_a_node_that_is_not_ready_is_one_fault_and_a_dead_one_another(node: Planner, agent: Agent) -> None:
    """A deactivated node is reported as not ready; a killed one as dead, and its readiness is blocked by that."""
    agent.until("node_ready", Level.OK, "is ready")
    node.do("deactivate")
    agent.until("node_ready", Level.ERROR, "its lifecycle state is inactive, expected active")
    node.do("activate")
    agent.until("node_ready", Level.OK, "is ready")
    node.process.kill()
    agent.until("nodes", Level.ERROR, "is no longer running")
    agent.until("node_ready", Level.STALE, "blocked by nodes/agent_1/planner")
    until(lambda: len(agent.faults) == 2, "both faults")  # the bus delivers in a separate thread
    assert [event.fault.unit for event in agent.faults if isinstance(event, FaultOpened)] == [
        "node_ready/agent_1/planner", "nodes/agent_1/planner",
    ]  # fmt: skip


class FakeClient:
    """A client of rclpy without ROS: `answers` are the numbers of states that arrived."""

    def __init__(self) -> None:
        self.handle, self.answers, self.asked = self, list[int](), 0

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...

    def service_is_ready(self) -> bool:
        return True

    def send_request(self, request: object) -> int:
        self.asked += 1
        return self.asked

    def take_response(self, kind: Any) -> tuple[object, Any]:
        if not self.answers:
            return None, None
        response = kind()
        response.current_state.id = self.answers.pop(0)
        response.current_state.label = "any text"
        return object(), response


class FakeNode:
    def __init__(self) -> None:
        self.client, self.servers = FakeClient(), 1

    def create_client(self, kind: object, service: str) -> FakeClient:
        assert service == f"{NODE}/get_state"
        return self.client

    def count_services(self, service: str) -> int:
        return self.servers


class Reader:
    """A reader of one lifecycle node on fake time."""

    def __init__(self) -> None:
        self.node, self.now_s, self.fact = FakeNode(), 0.0, AnswerFact()
        self._reader = ReadinessReader(self.node, Wanted("agent_1", lifecycle=(NODE,)))

    def poll(self, *answers: int, seconds: float = 0.25, graph_changed: bool = False) -> AnswerFact:
        """Let so much time pass, in looks of 0.25 s, and receive the answers in the last one."""
        self.now_s += seconds
        self.node.client.answers = list(answers)
        for message in self._reader.poll(self.now_s, graph_changed=graph_changed):
            assert isinstance(message, ReadinessUpdate)
            self.fact = message.lifecycle[NODE]
        return self.fact


def test_the_newest_state_counts_and_its_text_is_not_used() -> None:
    """Texts come from other participants; a number that ROS 2 does not define is unknown."""
    reader = Reader()
    assert reader.poll(1, 2, 3).answer == "active"
    assert reader.poll(99).answer == "unknown"


def test_questions_are_limited() -> None:
    """One per second, more often only after a change of the graph; an open one is repeated after two seconds."""
    reader = Reader()
    asked = []
    for answers, graph_changed in [((), False), ((3,), False), ((), False), ((), False), ((), False), ((), True)]:
        reader.poll(*answers, graph_changed=graph_changed)
        asked.append(reader.node.client.asked)
    assert asked == [1, 1, 1, 1, 2, 2]
    reader.poll(3)
    reader.poll(graph_changed=True)
    assert reader.node.client.asked == 3
    for _ in range(8):
        reader.poll()
    assert reader.node.client.asked == 4


def test_time_in_which_the_child_did_not_run_is_not_silence() -> None:
    """Of a minute without a look, half a second counts."""
    reader = Reader()
    reader.poll(3)
    reader.poll(seconds=1.0)
    assert reader.poll(seconds=60.0).unanswered_s <= 1.0
    assert reader.poll(3).unanswered_s == 0.0


def test_a_new_server_has_no_state_of_the_old_one() -> None:
    """A node that was started again answers for itself."""
    reader = Reader()
    reader.poll(3)
    reader.node.servers = 0
    assert reader.poll() == AnswerFact()
    reader.node.servers = 1
    assert (reader.poll().served, reader.fact.answer) == (True, "")
