"""Slot 6: a running subscriber that does not receive its running publisher, while PHM receives both."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from phm import api, testing
from tests.fakes.consensus_bench import A, B, C, D, Quorum, beacon, matrix

FLOW = [{"name": "/agent_1/flow", "publishers": [A], "subscribers": [B, C]}]


def test_a_subscriber_that_lost_its_publisher_is_an_error() -> None:
    """All others receive both, so no node is dead; the data of a configured topic does not arrive."""
    quorum = Quorum(topics=FLOW)
    quorum.after(20, matrix(A, B, C))
    cut = matrix(A, B, C, not_received=((B, A),))
    early = quorum.after(9, cut)
    assert (early.level, early.condition) == (api.Level.WARN, "partly_received")
    result = quorum.after(1, cut)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "publisher_not_received", "ros_app")
    assert (result.brief, result.settle_s) == ("b does not receive a", 10.0)
    assert result.summary.startswith(
        "agent_1/b does not receive agent_1/a, which publishes agent_1/flow for it, while PHM receives both: check"
    )
    assert quorum.after(0, matrix(A, B, C)).level is api.Level.OK
    assert quorum.after(9, cut).condition == "partly_received", "the time begins again"


@pytest.mark.parametrize(
    "beacons",
    [
        matrix(A, B, C, not_received=((A, B), (C, B))),  # the other direction carries no topic
        {**matrix(A, B, C, not_received=((B, A),)), A: beacon({B: True, C: True}, age_s=5.0, witness=A)},
        {**matrix(A, B, C), B: beacon({C: True}, witness=B, full=True)},
        {**matrix(A, B, C), A: beacon({C: True}, witness="one"), B: beacon({C: True}, witness="one")},
        {**matrix(A, B, C), B: beacon({C: True}, witness=B, heartbeats=5)},
    ],
    ids=["other direction", "silent", "full", "one process", "just started"],
)
def test_what_says_nothing_about_a_publisher(beacons: Mapping[str, api.BeaconFact]) -> None:
    """Only a running subscriber that does not receive a running publisher does."""
    assert Quorum(topics=FLOW).after(19, beacons).condition != "publisher_not_received"


def test_nodes_without_a_common_topic_are_only_a_warning() -> None:
    """The same loss, and no configured data between them."""
    result = Quorum(topics=[{**FLOW[0], "subscribers": [C]}]).after(60, matrix(A, B, C, not_received=((B, A),)))
    assert (result.level, result.condition) == (api.Level.WARN, "partly_received")


def test_a_lost_publisher_can_be_switched_off() -> None:
    """By the same setting as the quorum."""
    result = Quorum(topics=FLOW, consensus={"open_faults": False}).after(60, matrix(A, B, C, not_received=((B, A),)))
    assert (result.level, result.condition) == (api.Level.WARN, "partly_received")


def test_a_publisher_never_received_in_this_run_of_the_container_is_not_restarted() -> None:
    """A restart restores only what the run of the subscriber's container had."""
    nodes = [{"name": A, "container": "one"}, {"name": B, "container": "two"}, {"name": C, "container": "two"}]
    quorum = Quorum(containers=("one", "two"), nodes=nodes, topics=FLOW)
    docker = testing.FakeDocker(testing.container("one"), testing.container("two"))
    cut = matrix(A, B, C, not_received=((B, A),))
    result = quorum.after(30, cut, docker)
    assert (result.condition, result.target, result.evidence.never_ok) == ("publisher_not_received", "two", True)
    quorum.after(20, matrix(A, B, C), docker)
    assert quorum.after(12, cut, docker).evidence.never_ok is False


def test_a_lost_publisher_is_reported_beside_a_copied_beacon() -> None:
    """Any participant of the domain can copy one, e.g. a recording that is played."""
    quorum = Quorum(topics=FLOW)
    quorum.after(20, matrix(A, B, C))
    cut = matrix(A, B, C, not_received=((B, A),))
    copied = {**cut, C: beacon({A: True, B: True}, witness=C, copied_by="/elsewhere/bag")}
    assert quorum.after(12, copied).condition == "publisher_not_received"


def test_the_subscriber_that_a_restart_can_help_is_the_target() -> None:
    """Another one is on the host, without a container."""
    nodes = [{"name": A, "container": "one"}, {"name": B}, {"name": C, "container": "two"}, {"name": D}]
    quorum = Quorum(containers=("one", "two"), nodes=nodes, topics=FLOW)
    docker = testing.FakeDocker(testing.container("one"), testing.container("two"))
    quorum.after(20, matrix(A, B, C, D), docker)
    result = quorum.after(12, matrix(A, B, C, D, not_received=((B, A), (C, A))), docker)
    assert (result.condition, result.target) == ("publisher_not_received", "two")
