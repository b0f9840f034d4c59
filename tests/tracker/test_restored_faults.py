"""Faults that an earlier run of PHM left open: only an observation ends them."""

from __future__ import annotations

from phm.api import bypass
from phm.core.model import Evidence, Fault, Level, Outcome
from phm.tracker.faults import ITSELF, TIMEOUT, UNOBSERVED_S
from tests.fakes.tracker_bench import BAD, OK, Bench, unit

UNIT = "autopilot"
NOTHING = bypass("nothing received")
UNOBSERVED = NOTHING.with_evidence(Evidence(unobserved=True))


def restarted(*, given_up: bool = False) -> Bench:
    """A run of PHM after one in which the unit failed and was acted on."""
    before = Bench([unit(UNIT, target="link:fc")])
    before.all_healthy()
    before.later(1)
    before.see(UNIT, BAD)
    before.take(before.tracker.begin_action("link:fc", UNIT, "reopen", before.stamp(), 5.0))
    (fault,) = before.tracker.open_faults()
    if given_up:
        before.take(before.tracker.escalate(fault.id, before.stamp()))
    after, tracker = Bench(before.tracked, before.now + 10), before.tracker
    after.take(after.tracker.restore(tracker.open_faults(), tracker.given_up(), after.stamp(), tracker.fault_count))
    after.later(1)
    return after


def open_fault(bench: Bench) -> list[Fault]:
    return list(bench.tracker.open_faults())


def test_a_subject_not_observed_yet_is_unknown_and_its_fault_stays_open() -> None:
    """`Nothing received` may also mean that it is still lost. Recovery finds it not OK either."""
    bench = restarted()
    bench.see(UNIT, UNOBSERVED)
    state = bench.tracker.state(UNIT)
    assert (state.level, state.not_applicable) == (Level.STALE, False)
    assert state.result.summary == "not observed since PHM was restarted: nothing received"
    assert not bench.tracker.found_ok(UNIT, 0.0)
    bench.later(60)
    bench.see(UNIT, UNOBSERVED)
    assert (bench.closed, len(open_fault(bench))) == ([], 1)


def test_an_observation_decides() -> None:
    """OK ends the fault, ERROR continues it; the alarm is not raised twice."""
    bench = restarted()
    bench.see(UNIT, UNOBSERVED)
    bench.later(1)
    bench.see(UNIT, BAD)
    assert (bench.level(UNIT), bench.opened, bench.closed) == (Level.ERROR, [], [])
    bench.later(1)
    bench.see(UNIT, OK)
    assert (bench.level(UNIT), bench.closed) == (Level.OK, [(UNIT, Outcome.RESOLVED, ITSELF)])


def test_a_unit_that_was_given_up_is_unknown_too() -> None:
    bench = restarted(given_up=True)
    bench.see(UNIT, UNOBSERVED)
    assert (bench.level(UNIT), len(bench.tracker.given_up())) == (Level.STALE, 1)
    bench.later(1)
    bench.see(UNIT, BAD)
    assert (bench.level(UNIT), bench.opened) == (Level.ERROR, [])


def test_a_subject_that_is_never_observed_again_ends_its_fault_after_a_time() -> None:
    """It may have been removed on purpose. No action is credited."""
    bench = restarted()
    bench.see(UNIT, UNOBSERVED)
    bench.later(UNOBSERVED_S)
    bench.see(UNIT, UNOBSERVED)
    assert (bench.closed, bench.tracker.state(UNIT).not_applicable) == ([(UNIT, Outcome.RESOLVED, TIMEOUT)], True)


def test_what_no_longer_applies_ends_its_fault() -> None:
    """Example: the container has no health check any more."""
    bench = restarted()
    bench.see(UNIT, NOTHING)
    assert bench.closed == [(UNIT, Outcome.RESOLVED, "reopen")]


def test_without_a_restored_fault_nothing_received_is_not_applicable() -> None:
    bench = Bench([unit(UNIT)])
    bench.see(UNIT, UNOBSERVED)
    assert bench.tracker.state(UNIT).not_applicable
