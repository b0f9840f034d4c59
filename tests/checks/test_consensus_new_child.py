"""Slot 6: a new ROS child process does not end what the consensus has reported."""

from __future__ import annotations

from phm.api import Level
from phm_checks.consensus import FORGET_S
from tests.fakes.consensus_bench import A, B, C, Quorum, beacon, matrix

NOT_RECEIVED = matrix(A, B, C, not_received=((A, C), (B, C)))


def reported() -> Quorum:
    """A node that the others have not received for long."""
    quorum = Quorum()
    assert quorum.after(60, NOT_RECEIVED).condition == "quorum_dead"
    return quorum


def test_the_first_picture_of_a_new_child_ends_nothing() -> None:
    """It has no beacons yet, then the first ones."""
    quorum = reported()
    assert quorum.after(0, {}, nodes={}, up_s=0.2).level is Level.STALE
    result = quorum.after(0, {name: NOT_RECEIVED[name] for name in (B, C)}, nodes={A: 1, B: 1, C: 1}, up_s=1.0)
    assert result.level is not Level.OK
    assert quorum.after(60, NOT_RECEIVED, up_s=70.0).condition == "quorum_dead"


def test_a_node_that_no_one_receives_stays_dead_for_a_new_child() -> None:
    """Until it would be reported again; and an OK of all ends it immediately."""
    quorum = reported()
    beacons = {**NOT_RECEIVED, C: beacon({}, age_s=5.0, witness=C)}
    assert quorum.after(0, beacons, up_s=1.0).level is Level.STALE
    assert quorum.after(0, matrix(A, B, C), up_s=2.0).level is Level.OK


def test_known_beacons_are_awaited_before_the_result_is_ok() -> None:
    """Also if nothing was reported."""
    quorum = Quorum()
    assert quorum.after(5, matrix(A, B, C)).level is Level.OK
    assert quorum.after(0, matrix(A, B), up_s=1.0).level is Level.STALE
    assert quorum.after(0, matrix(A, B), up_s=100.0).level is Level.OK


def test_without_any_beacon_a_report_is_kept_for_as_long_as_a_beacon() -> None:
    """Afterwards nothing is evaluated, so nothing is observed."""
    quorum = reported()
    assert quorum.after(0, {}, up_s=FORGET_S - 1.0).level is Level.STALE
    result = quorum.after(0, {}, up_s=FORGET_S + 1.0)
    assert result.bypass and result.evidence.unobserved
