"""A manual stop is distinguished from a crash by the engine's events, as recorded from Docker 20.10 and Compose 2.26."""

from __future__ import annotations

import pytest

from phm.recovery.holds.manual_stop import REMOVED_S, STOPPED_S, UNSURE_S, ManualStopDetector, StopVerdict

TERM, KILL = ("kill", "signal 15"), ("kill", "signal 9")
DIE, STOP, DESTROY, START = ("die", "exit code 0"), ("stop", ""), ("destroy", ""), ("start", "")


def verdicts(*events: tuple[str, str], gap_s: float = 0.05, own: bool = False) -> list[StopVerdict]:
    """The decision one minute after these consecutive events."""
    stops, now = ManualStopDetector(), 100.0
    for action, detail in events:
        stops.event("app", action, detail, now, own=own)
        now += gap_s
    assert bool(stops.undecided()) == bool(stops.next_due())
    return [verdict for _key, verdict in stops.due(now + 60.0)]


@pytest.mark.parametrize("events", [(TERM, DIE, STOP), (("kill", "signal 2"), DIE, STOP), (TERM, KILL, DIE, STOP)])
def test_a_docker_stop_is_a_manual_stop(events: tuple[tuple[str, str], ...]) -> None:
    """With any stop signal, and also when the time until SIGKILL expired."""
    assert verdicts(*events) == [StopVerdict.STOPPED]


@pytest.mark.parametrize("events", [(KILL, DIE, DESTROY), (TERM, DIE, STOP, DESTROY), (DESTROY,)])
def test_a_removal_is_recognized(events: tuple[tuple[str, str], ...]) -> None:
    """`docker rm -f`, `docker compose down`, `docker rm` of a container that had ended before."""
    assert verdicts(*events) == [StopVerdict.REMOVED]


@pytest.mark.parametrize("events", [(KILL, DIE), (TERM, DIE)])
def test_a_kill_is_a_crash(events: tuple[tuple[str, str], ...]) -> None:
    """`docker kill` is not the usual way to stop a container."""
    assert verdicts(*events) == [StopVerdict.CRASHED]


def test_an_end_without_any_kill_is_decided_immediately() -> None:
    """A crash is published as soon as it is seen."""
    assert verdicts(DIE) == [] and verdicts(("oom", ""), DIE) == []


@pytest.mark.parametrize(
    "events",
    [
        (TERM, DIE, STOP, START),
        (("replace", ""), TERM, DIE, STOP, DESTROY, ("rename", ""), START),
        (TERM, DIE, STOP, DESTROY, ("create", ""), START),
    ],
)
def test_a_container_that_runs_again_was_not_stopped(events: tuple[tuple[str, str], ...]) -> None:
    """A restart, a recreation by Compose, or a manual one."""
    assert verdicts(*events) == []


def test_a_stop_by_phm_is_not_a_manual_stop() -> None:
    """PHM's own restart also stops the container."""
    assert verdicts(TERM, DIE, STOP, own=True) == []


def test_a_restart_of_phm_that_the_engine_finishes_late_is_waited_for() -> None:
    """PHM's call has timed out: the end of the container is not a fault before its start is overdue, and never a manual
    stop.
    """
    stops = ManualStopDetector()
    for at, (action, detail) in enumerate((TERM, KILL, DIE, STOP)):
        stops.event("app", action, detail, at / 10, own=True, late=True)
    assert stops.undecided() == {"app"}
    assert stops.undecided_until("app", 0.4) == pytest.approx(0.3 + STOPPED_S)
    assert stops.due(0.3 + STOPPED_S) == [("app", StopVerdict.CRASHED)]
    stops.event("app", *DIE, 10.0, own=True, late=True)
    stops.event("app", *START, 10.1, own=True, late=True)
    assert not stops.undecided()


def test_a_slow_recreation_is_waited_for() -> None:
    """Once Compose has created the replacement, the old container may take some time to end."""
    stops = ManualStopDetector()
    for at, action in ((0.0, "replace"), (0.1, "kill"), (60.0, "die"), (60.1, "stop"), (70.0, "destroy")):
        assert stops.due(at) == []
        stops.event("app", action, "signal 15", at, own=False)
    assert stops.due(80.0) == []
    stops.event("app", "start", "", 81.0, own=False)
    assert stops.due(1000.0) == []


def test_a_stop_with_a_missed_beginning_is_a_manual_stop() -> None:
    """PHM was started during `docker stop -t 60`: only a stop by the engine ends with `stop`."""
    assert verdicts(DIE, STOP) == verdicts(STOP) == [StopVerdict.STOPPED]


def test_a_slow_stop_is_a_manual_stop() -> None:
    """`docker stop -t 900`."""
    stops = ManualStopDetector()
    stops.event("app", *TERM, 0.0, own=False)
    assert stops.due(890.0) == [] and stops.undecided() == {"app"}


def test_a_container_is_left_alone_until_the_decision() -> None:
    """Once it has ended, and from the creation of a replacement on; a signal alone does not prevent actions."""
    stops = ManualStopDetector()
    stops.event("app", *TERM, 0.0, own=False)
    assert stops.undecided_until("app", 0.0) is None
    stops.event("app", *DIE, 1.0, own=False)
    assert stops.undecided_until("app", 1.0) == 4.0
    stops.event("cam", "replace", "", 0.0, own=False)
    assert stops.undecided_until("cam", 1.0) == 15.0 and stops.undecided_until("cam", 15.0) is None


def test_a_kill_is_published_quickly() -> None:
    """`docker kill` looks like `docker rm -f` for half a second only."""
    stops = ManualStopDetector()
    stops.event("app", *KILL, 0.0, own=False)
    stops.event("app", *DIE, 1.0, own=False)
    assert stops.next_due() == 1.0 + REMOVED_S


def test_an_end_with_a_possibly_missed_signal_is_published_and_recovery_waits() -> None:
    """The event stream was interrupted: a `stop` makes it a manual stop, and without one it was a crash."""
    for then, verdict in ((STOP, StopVerdict.STOPPED), (None, StopVerdict.CRASHED)):
        stops = ManualStopDetector()
        stops.event("app", *DIE, 0.0, own=False, missed=True)
        assert not stops.undecided()
        assert stops.undecided_until("app", 0.0) == pytest.approx(UNSURE_S)
        if then is not None:
            stops.event("app", *then, UNSURE_S / 2, own=False, missed=True)
            assert stops.undecided() == {"app"}
        assert stops.due(60.0) == [("app", verdict)]
