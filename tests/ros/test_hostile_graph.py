"""Announcements of foreign participants in the ROS domain neither blind PHM nor displace configured nodes."""

from __future__ import annotations

import signal
from dataclasses import replace

import pytest

from phm.facts import EndpointFact, RosFact, TopicFact
from phm.probes.ros.graph_snapshot import GraphSnapshot
from phm.probes.ros.line_splitter import LineSplitter
from phm.probes.ros.name_limits import MAX_STRANGERS, kept_ends, kept_nodes
from phm.probes.ros.protocol import LINE_LIMIT, GraphMessage, Tick, encode
from phm.probes.ros.raw_names import LONGEST, printable
from phm.probes.ros.supervisor import OVERLONG, RosSupervisor
from tests.fakes.ros_bench import Bench, seen, stale, until
from tests.ros.test_supervision import FAST, fake

TOPIC, NODE = "/agent_1/topic_1", "/agent_1/node_1"
STRING = "std_msgs/msg/String"


def observing(bench: Bench) -> RosSupervisor:
    """A probe that sees the node and measures its topic."""
    probe = bench.probe([{"name": TOPIC, "rate": 10}], nodes=[{"name": NODE}])
    seen(probe, lambda fact: NODE in fact.nodes and measured(fact) and NODE in fact.beacons, "node, rate and beacon")
    return probe


def measured(fact: RosFact) -> bool:
    rate = fact.topics[TOPIC].rate
    return rate is not None and bool(rate.hz)


@pytest.mark.one_distribution
def test_thousands_of_forged_names_hide_no_death(bench: Bench) -> None:
    """A snapshot never exceeds the size of a message: the configured node is in it while it is alive, and not after."""
    node = bench.node("node_1", "--publish", "topic_1:10")
    probe = observing(bench)
    bench.script("ros_discovery_forger.py", "5000")
    # Its lease is one second: a node that gets no CPU for longer is rightly not listed until it runs again.
    fact = seen(
        probe, lambda fact: len(fact.nodes) > MAX_STRANGERS and NODE in fact.nodes and fact, "it and the forged names"
    )
    assert len(fact.nodes) <= MAX_STRANGERS + 1
    until(lambda: any("unconfigured nodes" in problem for problem in probe.problems()), "the report")
    node.send_signal(signal.SIGKILL)
    seen(probe, lambda fact: NODE not in fact.nodes and not fact.topics[TOPIC].publishers, "its absence", 60.0)
    assert OVERLONG not in probe.problems() and probe.restarts == 0


@pytest.mark.parametrize(
    "bad",
    [
        "node",
        pytest.param("topic", marks=pytest.mark.one_distribution),
        pytest.param("name", marks=pytest.mark.one_distribution),
    ],
)
def test_a_name_that_is_not_utf_8_is_reported_and_hides_nothing(bench: Bench, bad: str) -> None:
    """Of a node, of a publisher of a configured topic, of a topic: nodes, endpoints, rates and beacons are still seen."""
    node = bench.node("node_1", "--publish", "topic_1:10")
    probe = observing(bench)
    first = probe.pid
    bench.script("ros_discovery_forger.py", "1", bad)
    until(lambda: any(r"no_\xff\xfe" in problem for problem in probe.problems()), "the report")

    def all_seen(fact: RosFact) -> bool:
        ends = [end.node for end in fact.topics[TOPIC].publishers]
        others = [name for name in ends if name != NODE]
        known = not others if bad != "topic" else others and all(r"\xff" in name for name in others)
        return NODE in fact.nodes and NODE in ends and bool(known) and measured(fact) and fact.beacons[NODE].missed < 3

    seen(probe, all_seen, "all that is configured")
    node.send_signal(signal.SIGKILL)
    seen(probe, lambda fact: NODE not in fact.nodes, "its absence", 60.0)
    assert probe.restarts == 0 and probe.pid == first


@pytest.mark.one_distribution
def test_a_topic_name_that_ros_does_not_allow_is_reported_and_hides_nothing(bench: Bench) -> None:
    """A plain DDS participant can announce `rt/arm-state`; rclpy refuses each question about it."""
    bench.node("node_1", "--publish", "topic_1:10", "--publish", "topic_2:10")
    probe = observing(bench)
    bench.script("ros_discovery_forger.py", "1", "refused")
    until(lambda: any("/arm-state" in problem for problem in probe.problems()), "the report")
    seen(probe, lambda fact: "/agent_1/topic_2" in fact.others and measured(fact), "the other topic, and the rate")
    assert probe.restarts == 0


@pytest.mark.one_distribution
def test_an_oversized_message_invalidates_the_snapshot(bench: Bench) -> None:
    """Nothing is known until the next snapshot, the reason is given, and PHM reports it as its own problem."""
    probe = bench.probe(command=fake("blind"), limits=replace(FAST, start_s=60.0, silent_s=10.0))
    # The snapshot lasts for 0.1 s, so it is not looked at: checks are woken when it comes, and when it is lost.
    until(lambda: bench.changes >= 2, "a snapshot and its loss")
    until(lambda: stale(probe) == OVERLONG, "the reason of the loss")
    assert OVERLONG in probe.problems() and OVERLONG in bench.notes
    assert probe.restarts == 0


def test_a_tick_does_not_refresh_another_snapshot() -> None:
    """A tick refreshes only the snapshot that it names, and other messages refresh none."""
    view = GraphSnapshot().with_message(GraphMessage(5.0, {NODE: 1}, number=1), 100.0)
    assert view.graph is not None
    assert view.with_message(Tick(6.0, {}, 1), 101.0).fact(view.graph, 101.5).age_s == 0.5
    lost = view.with_message(Tick(6.0, {}, 2), 101.0)
    assert lost.graph is not None and lost.fact(lost.graph, 101.5).age_s == 1.5


def test_an_oversized_line_is_counted_once_and_dropped() -> None:
    """Whether it arrives in one piece or in many."""
    for size in (1000, LINE_LIMIT * 4):
        lines, data, got = LineSplitter(), b"a\n" + b"x" * (LINE_LIMIT + 1) + b"\nb\n", []
        for at in range(0, len(data), size):
            got += lines.add(data[at : at + size])
        assert (got, lines.dropped) == ([b"a", b"b"], 1)


def test_configured_nodes_are_kept_whatever_others_announce() -> None:
    """Other nodes share the remaining space."""
    listed = {f"/a/{number}": 1 for number in range(10_000)} | {"/z/own": 2}
    kept, left_out = kept_nodes(listed, {"/z/own"})
    assert kept["/z/own"] == 2 and len(kept) == MAX_STRANGERS + 1 and left_out
    assert kept_nodes({"/b": 1, "/a": 1}, ()) == ({"/a": 1, "/b": 1}, False)


def test_configured_endpoints_are_kept_whatever_others_announce() -> None:
    """Other endpoints, and one node listed very often, are dropped first; the rest fits into a message."""
    long = '"' * LONGEST
    strangers = tuple(EndpointFact(f"{long[:-5]}{number:05}", long) for number in range(3000))
    copies = (EndpointFact("/z/own", STRING),) * 3000
    subscribers = {f"/t{number}": (EndpointFact("/z/own", STRING),) for number in range(200)}
    (kept, kept_subscribers), left_out = kept_ends(({"/t": (*strangers, *copies)}, subscribers), {"/z/own"})
    assert left_out and kept_subscribers == subscribers
    assert [end.node for end in kept["/t"]].count("/z/own") >= 1
    topics = {name: TopicFact(kept.get(name, ()), kept_subscribers.get(name, ())) for name in {*kept, *subscribers}}
    nodes, _ = kept_nodes({end.node: 1 for end in strangers}, ())
    assert len(encode(GraphMessage(1.0, nodes, topics))) < LINE_LIMIT


def test_a_name_from_outside_is_short_and_printable() -> None:
    """Other characters are escaped."""
    assert printable("/a/b_1") == "/a/b_1"
    assert printable("a\x1b[2J\n\u00e9") == r"a\x1b[2J\n\xe9"
    assert len(printable("\x00" * 1000)) == LONGEST
