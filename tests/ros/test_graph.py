"""The real child and real nodes: existing nodes are seen, and departed ones disappear."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from phm.facts import EndpointFact, NameFact, RateFact, RosFact
from phm.probes.ros.graph import node_of
from phm.probes.ros.supervisor import RosSupervisor, SupervisorLimits
from tests.fakes.ros_bench import Bench, gone, seen, stale, until
from tests.fakes.ros_truth import within_2_percent

TOPIC = "/agent_1/topic_1"
STRING = "std_msgs/msg/String"


def rate_of(fact: RosFact) -> RateFact:
    """The rate of the only topic; an unknown rate while there is none."""
    return fact.topics[TOPIC].rate or RateFact(None, None)


def has_named_endpoints(fact: RosFact) -> bool:
    """Whether both endpoints of the only topic have the names of their nodes, which may arrive a moment later."""
    return all(side and side[0].node for side in (fact.topics[TOPIC].publishers, fact.topics[TOPIC].subscribers))


TRIES = 3
"""A machine that starves the child delists a node late, but not each time; a lease of 20 s is late each time."""


def delisted_after_s(bench: Bench, probe: RosSupervisor) -> float:
    """How long after its SIGKILL a new node has left the graph."""
    node = bench.node("node_1", "--publish", "topic_1:10")
    seen(probe, lambda fact: fact.nodes.get("/agent_1/node_1") == 1 and fact.topics[TOPIC].publishers, "the node")
    changes, began_s = bench.changes, time.monotonic()
    node.send_signal(signal.SIGKILL)
    seen(probe, lambda fact: not fact.nodes and not fact.topics[TOPIC].publishers, "its absence")
    passed_s = time.monotonic() - began_s
    until(lambda: bench.changes > changes, "the wake-up, which follows the news")
    return passed_s


def test_a_killed_node_leaves_the_graph(bench: Bench) -> None:
    """With the shipped profile, a node ended by SIGKILL is delisted long before the default 20 s."""
    probe = bench.probe([{"name": "agent_1/topic_1", "rate": 10}])
    assert any(delisted_after_s(bench, probe) < 10.0 for _ in range(TRIES))


def test_a_node_that_shuts_down_is_delisted(bench: Bench) -> None:
    """SIGTERM ends the demo node with code 0 and removes it from the graph."""
    node = bench.node("node_1")
    probe = bench.probe(nodes=[{"name": "/agent_1/node_1"}])
    seen(probe, lambda fact: "/agent_1/node_1" in fact.nodes, "the node")
    node.terminate()
    assert node.wait(60) == 0
    seen(probe, lambda fact: not fact.nodes, "its absence")


def test_endpoints_are_reported_with_node_type_and_qos(bench: Bench) -> None:
    """Publishers and subscribers have the node's full name; PHM's own reader is not among them."""
    bench.node("node_1", "--publish", "topic_1:10")
    bench.node("node_2", "--subscribe", "topic_1")
    probe = bench.probe([{"name": TOPIC, "rate": 10}, {"name": "/agent_1/other"}])

    def complete(fact: RosFact) -> RosFact | None:
        return fact if len(fact.nodes) == 2 and has_named_endpoints(fact) and rate_of(fact).hz else None

    fact = seen(probe, complete, "both ends, their nodes and a rate")
    (publisher,), (subscriber,) = fact.topics[TOPIC].publishers, fact.topics[TOPIC].subscribers
    plain = EndpointFact(
        "/agent_1/node_1", STRING, "reliable", "volatile", None, "automatic", None, publisher.type_hash
    )
    assert (publisher, subscriber) == (plain, replace(plain, node="/agent_1/node_2"))
    assert publisher.type_hash.startswith("RIHS01_")
    assert fact.topics["/agent_1/other"].publishers == ()
    assert fact.topics["/agent_1/other"].rate is None
    assert set(fact.nodes) == {"/agent_1/node_1", "/agent_1/node_2"}


def test_every_policy_of_an_endpoint_is_reported(bench: Bench) -> None:
    """Both sides as in DDS; an infinite duration is None."""
    strict = "reliability=best_effort,durability=transient_local,liveliness=manual_by_topic,deadline=0.5,lease=2"
    bench.script("ros_endpoints.py", "talker", f"pub:topic_1:{strict}", "sub:topic_1")
    probe = bench.probe([{"name": TOPIC}])
    fact = seen(probe, lambda fact: has_named_endpoints(fact) and fact, "both ends")
    (publisher,), (subscriber,) = fact.topics[TOPIC].publishers, fact.topics[TOPIC].subscribers
    assert replace(publisher, type_hash="") == EndpointFact(
        "/agent_1/talker", STRING, "best_effort", "transient_local", 0.5, "manual_by_topic", 2.0
    )
    assert (subscriber.deadline_s, subscriber.liveliness, subscriber.lease_s) == (None, "automatic", None)


@pytest.mark.one_distribution
def test_deadlines_and_subscribers_have_no_qos_with_a_middleware_that_ignores_it(bench: Bench) -> None:
    """Zenoh has no QoS that keeps two endpoints from matching. That a topic is latched is reported."""
    code = (
        "import phm.probes.ros.graph as g; g.quality_matters = lambda: False\n"
        "from phm.probes.ros.child import main; raise SystemExit(main())"
    )
    bench.script("ros_endpoints.py", "talker", "pub:topic_1:durability=transient_local,deadline=0.5", "sub:topic_1")
    probe = bench.probe([{"name": TOPIC}], command=(sys.executable, "-c", code))
    fact = seen(probe, lambda fact: has_named_endpoints(fact) and fact, "both ends")
    plain = EndpointFact("/agent_1/talker", STRING)
    latched = replace(plain, reliability="reliable", durability="transient_local")
    assert replace(fact.topics[TOPIC].publishers[0], type_hash="") == latched
    assert replace(fact.topics[TOPIC].subscribers[0], type_hash="") == plain


@pytest.mark.one_distribution
def test_unconfigured_topics_are_reported_with_their_nodes(bench: Bench) -> None:
    """A misspelt name appears there; configured, hidden and standard topics are left out; a departed one disappears."""
    node = bench.script(
        "ros_endpoints.py", "talker", "pub:topc_1", "sub:topc_1", "sub:topic_1", "sub:_hidden", "sub:/other"
    )
    bench.script("ros_endpoints.py", "second", "sub:topc_1")
    probe = bench.probe([{"name": TOPIC}])
    expected = {
        "/agent_1/topc_1": NameFact(("/agent_1/talker",), ("/agent_1/second", "/agent_1/talker")),
        "/other": NameFact((), ("/agent_1/talker",)),
    }
    seen(probe, lambda fact: fact.others == expected, "both names")
    node.kill()
    seen(probe, lambda fact: fact.others == {"/agent_1/topc_1": NameFact((), ("/agent_1/second",))}, "what is left")


@pytest.mark.parametrize("hz", [10.0, 200.0])
def test_the_measured_rate_is_the_true_rate(bench: Bench, tmp_path: Path, hz: float) -> None:
    """Within 2 % of the published rate, at 10 and at 200 Hz."""
    bench.source(hz, tmp_path / "sent")
    probe = bench.probe([{"name": TOPIC, "rate": hz}])
    seen(probe, lambda fact: within_2_percent(rate_of(fact), tmp_path / "sent"), "a rate within 2 %", limit_s=120.0)


@pytest.mark.one_distribution
def test_a_stopped_node_is_listed_and_silent(bench: Bench) -> None:
    """SIGSTOP: the topic falls silent, which is reported immediately, and flows again after SIGCONT."""
    node = bench.node("node_1", "--publish", "topic_1:10")
    probe = bench.probe([{"name": TOPIC, "rate": 10}], silence=0.5)

    seen(probe, lambda fact: rate_of(fact).hz, "a rate")
    changes = bench.changes
    node.send_signal(signal.SIGSTOP)
    seen(probe, lambda fact: rate_of(fact).hz == 0.0 and (rate_of(fact).silent_s or 0.0) > 0.5, "silence")
    until(lambda: bench.changes > changes, "the wake-up, which follows the news")
    node.send_signal(signal.SIGCONT)
    seen(probe, lambda fact: rate_of(fact).hz, "a rate again")


@pytest.mark.one_distribution
def test_an_unknown_type_is_reported_without_a_crash(bench: Bench) -> None:
    """A topic whose type is not available has publishers, no rate, and a reason."""
    bench.node("node_1", "--publish", "topic_1:10")
    hidden = (
        "import sys; sys.modules['std_msgs'] = None; from phm.probes.ros.child import main\n"
        "from phm.probes.ros import opaque_types; opaque_types.KNOWN.clear(); raise SystemExit(main())"
    )
    probe = bench.probe([{"name": TOPIC, "rate": 10}], command=(sys.executable, "-c", hidden))
    rate = seen(probe, lambda fact: fact.topics[TOPIC].publishers and fact.topics[TOPIC].rate, "the publisher")
    assert rate.hz is None
    assert rate.problem.startswith(f"type unknown: {STRING} is not installed beside PHM")
    assert probe.restarts == 0


@pytest.mark.one_distribution
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_real_child_is_replaced(bench: Bench, number: signal.Signals) -> None:
    """Killed or stopped, the child is replaced, and the new one sees the same nodes."""
    bench.node("node_1")
    probe = bench.probe(nodes=[{"name": "/agent_1/node_1"}], limits=SupervisorLimits(start_s=60.0, backoff_s=0.1))
    seen(probe, lambda fact: "/agent_1/node_1" in fact.nodes, "the node")
    first, reasons = probe.pid, list[str]()
    bench.on_change = lambda: reasons.append(stale(probe))
    os.kill(first, number)
    until(lambda: any(reasons), "STALE in between, as the checks that are woken see it")
    seen(probe, lambda fact: probe.pid not in (0, first) and "/agent_1/node_1" in fact.nodes, "the node again")
    until(lambda: gone(first), "the end of the first child")
    assert probe.restarts == 1


@pytest.mark.one_distribution
def test_a_leaking_child_is_replaced(bench: Bench) -> None:
    """Above the memory limit it is killed, and the note has both figures."""
    limits = SupervisorLimits(memory_period_s=0.1, backoff_s=0.1)
    probe = bench.probe(
        nodes=[{"name": "/a"}], max_memory="120MB", limits=limits, environ={"PHM_DEBUG_ROS_LEAK_MB": "20"}
    )
    until(lambda: probe.restarts >= 1, "a replacement")
    assert "allowed are 120 MB" in bench.notes[0]


@pytest.mark.one_distribution
def test_the_child_ends_with_its_parent(bench: Bench) -> None:
    """A killed daemon leaves no child behind, neither running nor stopped."""
    code = (
        "import sys, time; from phm.core.clock import SystemClock; from phm.core.settings import RosSettings\n"
        "from phm.probes.ros.supervisor import RosSupervisor\n"
        "p = RosSupervisor(RosSettings(), 'a', SystemClock(), lambda: print(p.pid, flush=True), print)\n"
        "p.start(); time.sleep(60)"
    )
    daemon = subprocess.Popen([sys.executable, "-c", code], env=bench.environ, stdout=subprocess.PIPE)
    assert daemon.stdout is not None
    child = int(daemon.stdout.readline())
    daemon.kill()
    daemon.wait()
    daemon.stdout.close()
    until(lambda: gone(child), "the end of the child")


SLEEPY = (
    "import phm.probes.ros.child as child; plain = child._report\n"
    "child._report = lambda watch, peers, out, tick_s: plain(watch, peers, out, 3600.0); raise SystemExit(child.main())"
)
"""A child that polls once an hour, and when the middleware reports a change."""


def test_a_change_of_the_graph_is_seen_immediately(bench: Bench) -> None:
    """Nodes and endpoints that appear and disappear, and a publisher recreated with another QoS, do not wait for a
    poll.

    The node is killed: a node that shuts down may stay listed until PHM compares its view with a second participant's,
    which needs polls (`test_graph_comparison.py`).
    """
    probe = bench.probe(
        [{"name": TOPIC}], command=(sys.executable, "-c", SLEEPY), limits=SupervisorLimits(start_s=60.0, silent_s=60.0)
    )
    node = bench.node("node_1", "--publish", "topic_1:10", "--subscribe", "topic_1", "--no-beacon")
    seen(
        probe, lambda fact: [end.node for end in fact.topics[TOPIC].publishers] == ["/agent_1/node_1"], "the publisher"
    )
    node.send_signal(signal.SIGHUP)
    seen(probe, lambda fact: not fact.topics[TOPIC].subscribers, "that it listens no more")
    node.send_signal(signal.SIGRTMIN + 1)
    seen(
        probe,
        lambda fact: [end.reliability for end in fact.topics[TOPIC].publishers] == ["best_effort"],
        "the recreated publisher",
    )
    node.kill()
    seen(probe, lambda fact: not fact.nodes and not fact.topics[TOPIC].publishers, "its absence")


def test_a_node_without_a_name_yet_is_not_called_by_a_placeholder() -> None:
    """rclpy names an endpoint whose node discovery has not delivered by a placeholder: it has no name then."""
    unknown = SimpleNamespace(node_name="_NODE_NAME_UNKNOWN_", node_namespace="_NODE_NAMESPACE_UNKNOWN_")
    assert node_of(unknown) == ""
    assert node_of(SimpleNamespace(node_name="node_1", node_namespace="/agent_1")) == "/agent_1/node_1"
