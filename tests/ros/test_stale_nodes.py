"""When a node that is listed twice is looked at with new eyes."""

from __future__ import annotations

from phm.probes.ros.stale_nodes import DOUBT_S, StaleNodes


def test_only_what_lasts_longer_than_a_lease_is_doubted() -> None:
    """After a restart the old node is listed beside the new one until its lease ends."""
    ghosts = StaleNodes()
    assert ghosts.look({"/a": 2, "/b": 1}, 0.0) == ()
    assert ghosts.look({"/a": 1, "/b": 1}, DOUBT_S - 1.0) == ()
    assert ghosts.look({"/a": 2, "/b": 2}, DOUBT_S) == ()
    assert ghosts.look({"/a": 2, "/b": 1}, 2 * DOUBT_S - 0.1) == ()
    assert ghosts.look({"/a": 2, "/b": 1}, 2 * DOUBT_S) == ("/a",)


def test_each_is_doubted_once_until_it_was_single_for_long() -> None:
    """A participant that was made anew lists nothing in its first moment: that alone does not settle it."""
    ghosts = StaleNodes(10.0)
    ghosts.look({"/a": 3}, 0.0)
    assert ghosts.look({"/a": 3}, 10.0) == ("/a",)
    ghosts.look({}, 11.0)
    for second in range(12, 60):
        assert ghosts.look({"/a": 2}, float(second)) == ()
    ghosts.look({"/a": 1}, 60.0)
    ghosts.look({"/a": 1}, 75.0)
    ghosts.look({"/a": 2}, 76.0)
    assert ghosts.look({"/a": 2}, 86.0) == ("/a",)
