"""When a node that is listed twice is looked up with a new participant."""

from __future__ import annotations

from phm.probes.ros.renewal_pace import REST_MOST_S, REST_S
from phm.probes.ros.stale_nodes import DOUBT_S, StaleNodes


def test_only_a_duplicate_that_outlasts_a_lease_is_doubted() -> None:
    """After a restart the old node is listed beside the new one until its lease ends."""
    stale_nodes = StaleNodes()
    assert stale_nodes.observe({"/a": 2, "/b": 1}, 0.0) == ()
    assert stale_nodes.observe({"/a": 1, "/b": 1}, DOUBT_S - 1.0) == ()
    assert stale_nodes.observe({"/a": 2, "/b": 2}, DOUBT_S) == ()
    assert stale_nodes.observe({"/a": 2, "/b": 1}, 2 * DOUBT_S - 0.1) == ()
    assert stale_nodes.observe({"/a": 2, "/b": 1}, 2 * DOUBT_S) == ("/a",)


def test_each_duplicate_is_doubted_once_until_it_was_single_for_long() -> None:
    """A new participant lists nothing at first: that alone does not resolve the duplicate."""
    stale_nodes = StaleNodes(10.0)
    stale_nodes.observe({"/a": 3}, 0.0)
    assert stale_nodes.observe({"/a": 3}, 10.0) == ("/a",)
    stale_nodes.observe({}, 11.0)
    for second in range(12, 60):
        assert stale_nodes.observe({"/a": 2}, float(second)) == ()
    stale_nodes.observe({"/a": 1}, 60.0)
    stale_nodes.observe({"/a": 1}, 75.0)
    stale_nodes.observe({"/a": 2}, 76.0)
    assert stale_nodes.observe({"/a": 2}, 86.0) == ("/a",)


def test_duplicates_that_come_and_go_cause_few_new_participants() -> None:
    """Each one interrupts the observation of ROS. Two nodes, each of them listed twice and once in turn."""
    stale_nodes, renewed = StaleNodes(), list[int]()
    for second in range(3600):
        turn = second // 24 % 2
        if stale_nodes.observe({"/a": 2 - turn, "/b": 1 + turn}, float(second)):
            renewed.append(second)
    assert 4 <= len(renewed) <= 8
    assert renewed[1] - renewed[0] >= REST_S and renewed[-1] - renewed[-2] >= REST_MOST_S / 2
