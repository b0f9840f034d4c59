"""A node that others receive and PHM's own participant does not: PHM looks again with a new participant."""

from __future__ import annotations

import signal
from itertools import pairwise

import pytest

from phm.facts import BeaconFact, NeighbourFact, RosFact
from phm.facts.ros import VIEWS_S
from phm.probes.ros.renewal_pace import REST_MOST_S, REST_S
from phm.probes.ros.unreceived_nodes import UNRECEIVED_S, UnreceivedNodes
from tests.fakes.ros_bench import Bench, seen

A, B = "/agent_1/a", "/agent_1/b"
NODES = [{"name": A}, {"name": B}]


def fact(silent_s: float, *, heard_s: float | None = 0.5, alive: bool = True, witness: str = "w2") -> RosFact:
    """A's beacon has been silent here for so long, and B received it `heard_s` ago; None: B has not met it."""
    views = {} if heard_s is None else {A: NeighbourFact(alive, heard_s)}
    return RosFact(
        0.0,
        60.0,
        beacons={A: BeaconFact(silent_s, 0.2, witness="w1"), B: BeaconFact(0.1, 0.2, views=views, witness=witness)},
    )


def test_a_node_that_only_others_receive_is_received_by_a_new_participant(bench: Bench) -> None:
    """Real nodes: one no longer sends to the subscriptions that exist now, and greets its neighbour as before."""
    node = bench.script("ros_beaconed.py", "a", "--lose")
    bench.script("ros_beaconed.py", "b")
    probe = bench.probe(nodes=NODES)

    def both(graph: RosFact) -> bool:
        """PHM receives both, and b receives a."""
        a, b = graph.beacons.get(A), graph.beacons.get(B)
        return a is not None and b is not None and a.missed < 2 and A in b.views and b.views[A].alive

    seen(probe, both, "both nodes")
    node.send_signal(signal.SIGUSR2)
    seen(probe, lambda graph: A in graph.beacons and graph.beacons[A].age_s > 2.0, "its silence")
    seen(probe, both, "its beacon again")
    assert probe.restarts == 0
    assert any(f"receives no beacon of {A}, which {B} receives" in note for note in bench.notes), bench.notes


@pytest.mark.parametrize(
    ("seen_now", "unreceived"),
    [
        (fact(4.0), True),
        (fact(0.5 + VIEWS_S), False),  # the report may be older than PHM's last heartbeat
        (fact(4.0, heard_s=3.0), False),
        (fact(4.0, alive=False), False),
        (fact(4.0, heard_s=None), False),
        (fact(4.0, witness="w1"), False),  # nodes of one process receive as one
        (RosFact(3.0, 60.0, beacons=fact(4.0).beacons), False),  # PHM's own child is late
        (RosFact(0.0, 60.0), False),
    ],
)
def test_another_process_must_have_received_it_since_phm_did(seen_now: RosFact, unreceived: bool) -> None:
    """What B says is as old as its report at the most; a report of the time before proves nothing."""
    report = seen_now.received_only_elsewhere(A)
    assert (report is not None) is unreceived
    assert report is None or report == (B, 0.5 + VIEWS_S + 0.1, 0.0)


def test_reports_of_some_nodes_may_be_left_out() -> None:
    """For what only nodes of other containers can say."""
    assert fact(4.0).received_elsewhere(A, without={A, B}) is None
    assert fact(4.0).received_elsewhere(A, without={A}) is not None


def test_a_new_participant_is_requested_when_it_lasts_and_not_repeatedly() -> None:
    """Not while nodes are discovered again one by one; then at intervals that grow while it does not help."""
    unreceived = UnreceivedNodes()
    assert unreceived.observe(fact(0.1), [A, B], -10.0) == {}
    assert unreceived.observe(fact(4.0), [A, B], -9.0) == {}
    assert unreceived.observe(fact(0.1), [A, B], -1.0) == {}
    assert unreceived.observe(fact(4.0), [A, B], 0.0) == {}
    assert unreceived.observe(fact(4.0), [A, B], UNRECEIVED_S - 0.1) == {}
    assert unreceived.observe(fact(4.0), [A, B], UNRECEIVED_S) == {A: B}
    asked = [at for at in range(11, 2200) if unreceived.observe(fact(4.0), [A, B], float(at))]
    assert [later - earlier for earlier, later in pairwise([10, *asked])] == [
        REST_S,
        2 * REST_S,
        4 * REST_S,
        8 * REST_S,
        REST_MOST_S,
    ]


def test_nodes_that_are_not_configured_cause_nothing() -> None:
    """Anybody can send beacons under other names."""
    unreceived = UnreceivedNodes(0.0)
    assert unreceived.observe(fact(4.0), [B], 0.0) == {}
