"""A check that observed what ended its unit's failure: the fault closes, and no action is credited."""

from __future__ import annotations

from phm.api import Evidence, Level, stale, warn
from phm.core.model import FaultClosed, Outcome, Transition
from tests.fakes.tracker_bench import BAD, OK, Bench, unit

REBOOT = Evidence(certain=True, ended_by="reboot")
REBOOTED = warn("rebooted", brief="rebooted", condition="rebooted").with_evidence(REBOOT)
FORECAST = warn("4 restarts", brief="4 restarts", condition="restarts_rising").with_evidence(Evidence(forecast=True))


def failing(target: str = "") -> Bench:
    bench = Bench([unit("pilot", target=target, grace_s=5.0)])
    bench.later(10)
    bench.all_healthy()
    bench.now += 1
    bench.see("pilot", BAD)
    bench.later(3)
    assert bench.opened == ["pilot"]
    return bench


def test_a_warning_that_states_the_end_closes_the_fault_first() -> None:
    """Two lines in this order: the failure is over, and something else is to be known."""
    bench = failing()
    bench.see("pilot", REBOOTED)
    assert bench.closed == [("pilot", Outcome.RESOLVED, "reboot")]
    assert bench.level("pilot") is Level.WARN
    newest = [type(event) for event in bench.events][-2:]
    assert newest == [FaultClosed, Transition]


def test_any_other_warning_leaves_the_fault_open() -> None:
    """Only a result that is OK, or one that states the end, closes it."""
    bench = failing()
    bench.see("pilot", warn("weak", brief="weak", condition="weak"))
    bench.later(3)
    assert bench.closed == []


def test_a_forecast_closes_the_fault_first() -> None:
    """The unit works. A container that PHM had started stayed a fault for as long as its restarts became more frequent."""
    bench = failing()
    bench.see("pilot", FORECAST)
    assert bench.closed == [("pilot", Outcome.RESOLVED, "itself")]
    assert bench.level("pilot") is Level.WARN


def test_a_warning_about_something_else_closes_the_fault_if_it_says_so() -> None:
    """A fault stayed open for as long as its unit had a lasting WARN."""
    bench = failing()
    recovered = Evidence(recovered=True)
    bench.see("pilot", warn("lossy", brief="lossy", condition="lossy").with_evidence(recovered))
    assert bench.closed == [("pilot", Outcome.RESOLVED, "itself")]
    assert bench.level("pilot") is Level.WARN


def test_a_forecast_verifies_an_action() -> None:
    """It has recovered the unit, whatever comes."""
    bench = failing("link")
    bench.take(bench.tracker.begin_action("link", "pilot", "start", bench.stamp(), 60.0, verifying=True))
    bench.now += 1
    bench.see("pilot", FORECAST)
    assert bench.tracker.found_ok("pilot", bench.now)
    bench.take(bench.tracker.end_action("link", bench.stamp(), worked=True))
    assert bench.level("pilot") is Level.WARN
    assert [(unit, outcome) for unit, outcome, _ in bench.closed] == [("pilot", Outcome.RESOLVED)]


def test_an_ok_that_states_the_end_names_it() -> None:
    """In the fault's `by`."""
    bench = failing()
    bench.see("pilot", OK.with_evidence(REBOOT))
    assert bench.closed == [("pilot", Outcome.RESOLVED, "reboot")]


def test_an_action_that_ran_meanwhile_is_not_credited() -> None:
    """The end counts as the unit's recovery for the verification, and is published when that is over."""
    bench = failing("link")
    bench.take(bench.tracker.begin_action("link", "pilot", "reopen", bench.stamp(), 60.0, verifying=True))
    bench.now += 1
    bench.see("pilot", REBOOTED)
    assert bench.closed == []
    assert bench.tracker.found_ok("pilot", bench.now)
    bench.take(bench.tracker.end_action("link", bench.stamp(), worked=True))
    assert bench.closed == [("pilot", Outcome.RESOLVED, "reboot")]
    bench.now += 0.5
    bench.see("pilot", REBOOTED)
    assert bench.level("pilot") is Level.WARN, "also in the grace after the action"


def test_what_ended_it_is_remembered_until_the_action_is_verified() -> None:
    """A check states it only for a time; later results say that the unit is OK, no more."""
    bench = failing("link")
    bench.take(bench.tracker.begin_action("link", "pilot", "reopen", bench.stamp(), 60.0, verifying=True))
    for result in (REBOOTED, stale("not known"), OK):
        bench.now += 1
        bench.see("pilot", result)
    bench.take(bench.tracker.end_action("link", bench.stamp(), worked=True))
    assert bench.closed == [("pilot", Outcome.RESOLVED, "reboot")]


def test_what_ended_a_failure_does_not_end_the_next_one() -> None:
    """Failing again, it has to be ended again."""
    bench = failing("link")
    bench.take(bench.tracker.begin_action("link", "pilot", "reopen", bench.stamp(), 60.0, verifying=True))
    for result in (REBOOTED, BAD, OK):
        bench.now += 1
        bench.see("pilot", result)
    bench.take(bench.tracker.end_action("link", bench.stamp(), worked=True))
    assert bench.closed == [("pilot", Outcome.RESOLVED, "reopen")]


def test_a_forecast_ends_a_fault_that_was_given_up() -> None:
    """Else the next failure opened no fault and was not recovered, for as long as restarts became more frequent."""
    bench = failing()
    fault = bench.tracker.open_faults()[0]
    bench.take(bench.tracker.escalate(fault.id, bench.stamp()))
    bench.now += 1
    bench.see("pilot", FORECAST)
    assert bench.tracker.given_up() == ()
    bench.later(20)
    bench.see("pilot", BAD)
    bench.later(3)
    assert bench.opened == ["pilot", "pilot"]
