"""Real nodes that die, stop, compute, return and run twice, judged by the real checks and the real tracker."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable, Collection, Iterator
from typing import Any

import pytest

from phm import api, testing
from phm.checking import plan
from phm.checking.check_turns import CheckRun
from phm.checking.pipeline import Pipeline
from phm.checking.scheduler import CheckScheduler
from phm.core.bus import Bus
from phm.core.clock import SystemClock
from phm.core.model import Event, Fault, FaultClosed, FaultOpened, Level, Transition, UnitState
from phm.facts import CannotTell, ProcessFact
from phm.probes.docker_processes import FORMS, processes
from phm.tracker import Tracker
from phm.tracker.rules import GRACE_ENDS_AFTER_OK_S
from phm_checks._process_table import ProcessTable
from phm_checks.nodes import Nodes
from phm_checks.rates import Rates
from phm_checks.topics import Topics
from tests.fakes.ros_bench import Bench, seen, until

pytestmark = pytest.mark.one_distribution
"""Decisions on graph, beacons, rates and processes: the tests of each run on both distributions."""

APP = "ros_app"
NAME = "/agent_1/node_1"
NODE, TOPIC, RATE = "nodes/agent_1/node_1", "topics/agent_1/topic_1", "rates/agent_1/topic_1"


LONG_LEASE = ("env", "-u", "FASTRTPS_DEFAULT_PROFILES_FILE")
"""Starts a node with the default lease of 20 s: killed, it stays listed for so long that a starved PHM, too, looks in that time."""


class HostList(testing.FakeDocker):
    """One running container whose processes are those that the test started on this machine."""

    def __init__(self) -> None:
        super().__init__(testing.container(APP))
        self.started: list[subprocess.Popen[bytes]] = []
        self.permitted = True

    def processes(self, name: str) -> tuple[ProcessFact, ...]:
        self.listings += 1
        if not self.permitted:
            raise CannotTell("not permitted")
        pids = ",".join(str(process.pid) for process in self.started) or "1"
        done = subprocess.run(["ps", *FORMS[0].split(), f"-q{pids}"], capture_output=True, text=True, check=False)
        titles, *rows = (line.split(None, 4) for line in done.stdout.splitlines())
        return processes({"Titles": titles, "Processes": rows})


class Agent:
    """Nodes, topics and rates of one agent, judged as in the daemon by scheduler, tracker and wake-ups; keeps all
    events.
    """

    def __init__(self, bench: Bench, *, grace: str = "8s", nodes: int = 1) -> None:
        self.bench, self.docker = bench, HostList()
        topics = [{"name": "/agent_1/topic_1", "rate": 10, "publishers": ["/agent_1/node_1"]}]
        ros = {"nodes": [{"name": f"/agent_1/node_{n + 1}"} for n in range(nodes)], "topics": topics, "grace": grace}
        settings = testing.settings(containers=[{"name": APP}], ros={**ros, "silence": "1s"})
        self.probe = bench.probe(topics, nodes=ros["nodes"], silence="1s")
        self.clock, self.events = SystemClock(), list[Event]()
        made = plan.build_plan(settings, {"nodes": Nodes, "topics": Topics, "rates": Rates})
        self.bus = Bus(self.clock)
        self.pipeline = Pipeline(Tracker(made.tracked, made.graph, self.clock.stamp()), self.bus, self.clock)
        world = testing.world(clock=self.clock, ros=self.probe, docker=self.docker)
        self.scheduler = CheckScheduler(made.scheduled, world, self.clock, self._take)
        self.pipeline.attach(self.scheduler.wake_units)
        bench.on_change = lambda: self.scheduler.wake_subject("ros")
        self.bus.subscribe("test", self.events.append, kinds=(Transition, FaultOpened, FaultClosed))
        self.scheduler.start()

    def _take(self, batch: CheckRun) -> None:
        self.pipeline.observe(dict(batch.units), batch.started, batch.duration_s, overdue=batch.overdue)

    def start(self, name: str = "node_1", *arguments: str, **more: Any) -> subprocess.Popen[bytes]:
        node = self.bench.node(name, *(arguments or ("--publish", "topic_1:10")), **more)
        self.docker.started.append(node)
        return node

    def state(self, unit: str) -> UnitState:
        return next(state for state in self.pipeline.states() if state.unit == unit)

    def until(self, condition: Callable[[], Any], what: str, limit_s: float = 120.0) -> Any:
        """Let time pass, as the daemon's main loop does, until `condition` is true."""

        def ticked() -> Any:
            self.pipeline.tick()
            return condition()

        return until(ticked, what, limit_s)

    def wait_ok(self) -> None:
        """Wait until the node and its topic have been OK for so long that grace is over."""
        self.until(lambda: self._ok_for_s() > GRACE_ENDS_AFTER_OK_S + 0.5, "a node and a rate that are OK, and stay so")
        self.events.clear()

    def _ok_for_s(self) -> float:
        states = [self.state(NODE), self.state(RATE)]
        since = max(state.since.mono for state in states)
        return self.clock.mono() - since if all(state.level is Level.OK for state in states) else 0.0

    def first_fault(self) -> Fault:
        """Wait for the first fault and return it."""
        self.until(lambda: self.faults, "a fault")
        return self.faults[0]

    def wait_blocked_by(self, unit: str) -> None:
        """Wait until the topic's rate is published as a consequence of `unit`, and assert that `unit` has the only
        fault.
        """
        self.until(lambda: self.state(RATE).blocked_by == unit, f"the rate blocked by {unit}")
        assert [fault.unit for fault in self.faults] == [unit]

    def wait(self, seconds: float) -> None:
        """Let time pass, in which an unwanted event would occur."""
        end = self.clock.mono() + seconds
        self.until(lambda: self.clock.mono() >= end, "the end")

    def published(self) -> list[tuple[str, Level]]:
        """The units and levels of all transitions, also of those that lasted for a moment."""
        return [(event.state.unit, event.state.level) for event in list(self.events) if isinstance(event, Transition)]

    @property
    def faults(self) -> list[Fault]:
        return [event.fault for event in self.events if isinstance(event, FaultOpened)]

    def close(self) -> None:
        self.scheduler.stop()
        self.bus.close()


@pytest.fixture
def agent(bench: Bench) -> Iterator[Agent]:
    made = Agent(bench)
    yield made
    made.close()


def test_a_killed_node_is_detected_by_its_process(agent: Agent) -> None:
    """SIGKILL: still listed, but its process has ended. One alarm; the silence of its topic is a consequence."""
    node = agent.start(before=LONG_LEASE)
    agent.wait_ok()
    node.kill()
    fault = agent.first_fault()
    assert (fault.unit, fault.result.condition) == (NODE, "node_missing")
    assert f"its process {node.pid} has ended" in fault.result.summary
    assert "it is listed in the graph" in fault.result.summary
    agent.wait_blocked_by(NODE)


def test_a_killed_node_is_detected_by_its_beacon(agent: Agent) -> None:
    """Without a list of processes, after three missed beacons, once its lease of one second is over. One alarm."""
    agent.docker.permitted = False
    node = agent.start()
    agent.wait_ok()
    seen(agent.probe, lambda fact: fact.beacons, "its beacon")
    node.kill()
    fault = agent.first_fault()
    assert (fault.unit, fault.result.condition) == (NODE, "node_missing")
    assert "its beacon has been silent for" in fault.result.summary
    agent.wait_blocked_by(NODE)


@pytest.mark.long
def test_a_killed_node_that_stays_listed_is_the_cause_and_not_its_topic(agent: Agent) -> None:
    """Without a list of processes, with the default lease of 20 s: it does not answer, and at the end of its lease it is dead.
    One alarm.
    """
    agent.docker.permitted = False
    node = agent.start(before=LONG_LEASE)
    agent.wait_ok()
    seen(agent.probe, lambda fact: fact.beacons, "its beacon")
    node.kill()
    fault = agent.first_fault()
    assert (fault.unit, fault.result.condition) == (NODE, "node_unanswering")
    agent.wait_blocked_by(NODE)
    agent.until(lambda: agent.state(NODE).result.condition == "node_missing", "the end of its lease")
    agent.wait_blocked_by(NODE)


def test_a_killed_node_is_detected_by_the_graph_alone(agent: Agent) -> None:
    """Without a list of processes and without a beacon, once its lease of one second is over. One alarm."""
    agent.docker.permitted = False
    node = agent.start("node_1", "--publish", "topic_1:10", "--no-beacon")
    agent.wait_ok()
    node.kill()
    fault = agent.first_fault()
    assert (fault.unit, fault.result.condition) == (NODE, "node_missing")
    assert "it is not in the graph" in fault.result.summary
    agent.wait_blocked_by(NODE)


def test_a_stopped_node_is_hung_until_it_resumes(agent: Agent) -> None:
    """SIGSTOP: state T in the list of processes. One alarm, closed when it resumes."""
    node = agent.start()
    agent.wait_ok()
    node.send_signal(signal.SIGSTOP)
    fault = agent.first_fault()
    assert (fault.unit, fault.result.condition) == (NODE, "node_hung")
    assert f"its process {node.pid} is stopped" in fault.result.summary
    agent.wait_blocked_by(NODE)
    node.send_signal(signal.SIGCONT)
    agent.until(lambda: any(isinstance(event, FaultClosed) for event in agent.events), "its end")
    agent.until(lambda: agent.state(RATE).level is Level.OK, "the rate again")
    assert len(agent.faults) == 1


BUSY_S, TRIES = 5, 3
"""On a machine that gives the node no CPU for seconds it does look hung: this agent has no checks of the machine's load, which explain it."""


def silent_once(agent: Agent, node: subprocess.Popen[bytes]) -> None:
    """Let the node compute until the silence of its topic is published: again if PHM lost its view in that time, as on an
    overloaded machine.
    """
    again_s = float("-inf")

    def silent() -> bool:
        nonlocal again_s
        if agent.state(RATE).level is Level.ERROR:
            return True
        if agent.clock.mono() >= again_s and agent.state(RATE).level is Level.OK:
            node.send_signal(signal.SIGUSR1)
            again_s = agent.clock.mono() + 4 * BUSY_S
        return False

    agent.until(silent, "the silence of its topic")


@pytest.mark.parametrize("more", [(), ("--no-beacon",)])
def test_a_busy_node_is_not_reported_dead(agent: Agent, more: tuple[str, ...]) -> None:
    """A callback computes for 5 s: the silent topic is published, the node is not, because its process is running."""
    node = agent.start("node_1", "--seconds", str(BUSY_S), *more, module="tests.fakes.ros_busy")
    agent.wait_ok()
    for _ in range(TRIES):
        before = len(agent.faults)
        silent_once(agent, node)
        agent.until(lambda: agent.state(RATE).level is agent.state(NODE).level is Level.OK, "the end of its work")
        units = {fault.unit for fault in agent.faults[before:]}
        if units == {RATE}:
            break
    assert units == {RATE}


def test_a_blocked_executor_is_blocked_and_then_hung(agent: Agent) -> None:
    """Its process sleeps and its beacon states for how long: one alarm, at the node, closed when the executor runs
    again. It is blocked first, where its CPU use is known by then: on a slow machine it may be hung immediately.
    """
    node = agent.start("node_1", "--seconds", "15", "--asleep", module="tests.fakes.ros_busy")
    agent.wait_ok()
    node.send_signal(signal.SIGUSR1)
    fault = agent.first_fault()
    assert fault.unit == NODE and fault.result.condition in ("node_blocked", "node_hung")
    assert "its executor has been blocked for" in fault.result.summary
    agent.wait_blocked_by(NODE)
    agent.until(lambda: agent.state(NODE).result.condition == "node_hung", "hung after a while")
    agent.until(lambda: agent.state(NODE).level is Level.OK and agent.state(RATE).level is Level.OK, "its return")
    assert len(agent.faults) == 1


def test_a_silent_topic_of_a_live_node_is_a_fault_of_the_topic(agent: Agent) -> None:
    """Its process runs and it is listed: the node is OK."""
    node = agent.start()
    agent.wait_ok()
    node.send_signal(signal.SIGUSR1)
    assert agent.first_fault().unit == RATE
    agent.until(lambda: agent.state(NODE).level is Level.OK, "a node that is OK")
    assert {fault.unit for fault in agent.faults} == {RATE}


def test_a_node_that_shuts_down_is_dead(agent: Agent) -> None:
    """SIGTERM: removed from the graph and from the list of processes."""
    node = agent.start()
    agent.wait_ok()
    node.terminate()
    fault = agent.first_fault()
    assert (fault.unit, fault.result.brief) == (NODE, "node_1 dead")


def test_a_node_that_never_started_is_reported(bench: Bench) -> None:
    """Its neighbour runs; the snapshot is old enough to prove the absence."""
    agent = Agent(bench, grace="3s", nodes=2)
    agent.start()
    agent.until(lambda: agent.faults, "a fault")
    assert [(fault.unit, fault.result.brief) for fault in agent.faults] == [
        ("nodes/agent_1/node_2", "node_2 never started")
    ]
    agent.close()


def test_a_node_that_runs_twice_is_one_fault(agent: Agent) -> None:
    """Both alive, each with a separate process: one fault, at the node, and none for its doubled rate."""
    agent.start()
    agent.wait_ok()
    agent.start()
    fault = agent.first_fault()
    assert (fault.unit, fault.result.condition) == (NODE, "node_duplicate")
    agent.wait(2.0)
    assert len(agent.faults) == 1


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_restarted_node_is_neither_duplicate_nor_dead(agent: Agent, number: signal.Signals) -> None:
    """Restarted immediately: whatever the gap causes, the node ends OK, and no duplicate is reported before the old
    lease ends.
    """
    node = agent.start()
    agent.wait_ok()
    old = seen(agent.probe, lambda fact: fact.beacons.get(NAME), "its beacon")
    node.send_signal(number)
    node.wait()
    again = agent.start()
    agent.until(lambda: str(again.pid) in str(agent.state(NODE).result.values["process"]), "its new process")
    seen(agent.probe, lambda fact: fact.beacons.get(NAME, old).birth != old.birth, "its new beacon")
    agent.until(lambda: agent.state(RATE).level is Level.OK and agent.state(NODE).level is Level.OK, "its return")
    agent.wait(2.0)
    assert agent.state(NODE).level is Level.OK, agent.state(NODE).result.summary
    briefs = {event.state.result.brief for event in agent.events if isinstance(event, Transition)}
    assert "node_1 runs twice" not in briefs
    assert {fault.unit for fault in agent.faults} <= {NODE}


def test_a_restarted_ros_child_raises_no_alarm(agent: Agent) -> None:
    """Its first snapshots are empty: no unit is published from them, and afterwards everything is OK again."""
    agent.start()
    agent.wait_ok()
    agent.probe.renew("the test wants it")
    agent.until(lambda: (NODE, Level.STALE) in agent.published(), "STALE in between")
    agent.until(lambda: agent.state(NODE).level is Level.OK and agent.state(RATE).level is Level.OK, "all as before")
    assert agent.faults == []


@pytest.mark.long
def test_processes_are_listed_rarely_while_all_units_are_ok(agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    """A node with a topic of 10 Hz: at most one list in three seconds. On a busy machine messages are late at times, which is a
    reason to look for another five seconds: the first window without that counts.
    """
    observe, doubts = ProcessTable.observe, list[Collection[object]]()

    def observed(table: ProcessTable, world: api.World, suspicions: Collection[Any], *, blind: bool) -> None:
        doubts.extend([suspicions] if suspicions else [])
        observe(table, world, suspicions, blind=blind)

    monkeypatch.setattr(ProcessTable, "observe", observed)
    agent.start()
    agent.wait_ok()
    seen(agent.probe, lambda fact: fact.nodes, "the node")
    for _ in range(9):
        doubts.clear()
        agent.wait(5.5)
        before, began_s = agent.docker.listings, agent.clock.mono()
        agent.wait(9.0)
        listed, seconds = agent.docker.listings - before, agent.clock.mono() - began_s
        if not doubts:
            break
    assert not doubts, "messages were late in each of the nine windows"
    assert listed <= seconds / 3
