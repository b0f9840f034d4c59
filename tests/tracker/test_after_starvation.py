"""When starvation is over: as measured, however long its alarm lasts, and how long each symptom may last after it."""

from __future__ import annotations

from phm.api import Level, Result, error, warn
from phm.core.model import Evidence
from phm.tracker.starvation import FOUND_AGAIN_S, RECOVERY_S
from phm_checks._liveness import LOST_S
from tests.fakes.tracker_bench import OK, Bench, unit

FALLING = Evidence(falling=True)
OVERLOADED = error("CPU at 100 %", brief="CPU 100 %", condition="cpu_high")
DAMPED = OVERLOADED.with_evidence(FALLING)
SLOW = error("topic /x at 3 Hz, expected 10", brief="3 Hz", condition="rate_low")
DROPPED = error("topic lost its subscriber", brief="lost", condition="subscriber_lost")
GONE = error("node left the graph", brief="dead", condition="node_missing")
GRACE_S = 30.0


def bench(grace_s: float = GRACE_S) -> Bench:
    """The host, and a topic that may take `grace_s` to start."""
    made = Bench([unit("host/cpu"), unit("rates/x", starved_by=("host/cpu",), grace_s=grace_s)])
    made.all_healthy()
    made.later(GRACE_S)
    made.all_healthy()
    return made


def seconds(made: Bench, count: float, cpu: Result, topic: Result) -> None:
    """Both are checked once a second."""
    for _ in range(int(count)):
        made.later(1.0)
        made.see("host/cpu", cpu)
        made.see("rates/x", topic)


def test_a_symptom_that_needs_no_start_gets_no_time_for_one() -> None:
    """A publisher that runs all the time is scheduled again: after a start it has GRACE_S, after starvation RECOVERY_S."""
    made = bench()
    seconds(made, 3, OVERLOADED, SLOW)
    seconds(made, RECOVERY_S, OK, SLOW)
    assert made.opened == ["host/cpu"]
    seconds(made, 2, OK, SLOW)
    assert made.opened == ["host/cpu", "rates/x"]


def test_what_must_be_discovered_again_gets_the_time_of_a_start() -> None:
    """Participants that were dropped from the graph announce themselves again."""
    made = bench()
    seconds(made, 3, OVERLOADED, DROPPED)
    seconds(made, GRACE_S, OK, DROPPED)
    assert made.opened == ["host/cpu"]
    seconds(made, 2, OK, DROPPED)
    assert made.opened == ["host/cpu", "rates/x"]


def test_a_node_that_left_the_graph_has_as_long_to_be_found_as_without_starvation() -> None:
    """Its time in the overload does not count, also where the grace of a start is shorter; a process that has ended needs none."""
    assert FOUND_AGAIN_S >= LOST_S + 2.0
    made = bench(grace_s=8.0)
    seconds(made, 3, OVERLOADED, GONE)
    seconds(made, FOUND_AGAIN_S, OK, GONE)
    assert made.opened == ["host/cpu"]
    seconds(made, 2, OK, GONE)
    assert made.opened == ["host/cpu", "rates/x"]
    made = bench(grace_s=8.0)
    seconds(made, 3, OVERLOADED, OK)
    seconds(made, 2, OK, GONE.with_evidence(Evidence(conclusive=True)))
    assert made.opened == ["host/cpu", "rates/x"]


def test_an_alarm_that_ends_later_explains_no_longer() -> None:
    """The alarm lasts on against flapping; the measurements say that nothing waits any more."""
    made = bench()
    seconds(made, 3, OVERLOADED, SLOW)
    seconds(made, RECOVERY_S, DAMPED, SLOW)
    assert made.opened == ["host/cpu"]
    assert made.tracker.starved_by("rates/x", made.stamp()) == "host/cpu"
    seconds(made, 2, DAMPED, SLOW)
    assert made.opened == ["host/cpu", "rates/x"]
    assert made.level("host/cpu") is Level.ERROR
    assert made.tracker.starved_by("rates/x", made.stamp()) == ""


def test_the_time_after_starvation_counts_from_the_last_measurement_above_the_limit() -> None:
    """Not from the end of its alarm."""
    made = bench()
    seconds(made, 3, OVERLOADED, SLOW)
    seconds(made, RECOVERY_S - 1, DAMPED, SLOW)
    seconds(made, 1, OK, SLOW)
    assert made.opened == ["host/cpu"]
    seconds(made, 2, OK, SLOW)
    assert made.opened == ["host/cpu", "rates/x"]


def test_bursts_with_short_pauses_explain_a_symptom_all_the_time() -> None:
    """Each measurement above the limit gives it the time again."""
    made = bench()
    for _ in range(5):
        seconds(made, 2, OVERLOADED, SLOW)
        seconds(made, RECOVERY_S - 1, DAMPED, SLOW)
    assert made.opened == ["host/cpu"]
    assert made.blocked_by("rates/x") == "host/cpu"


def test_an_alarm_whose_measurement_is_below_the_limit_begins_no_starvation() -> None:
    """After a restart of PHM, for instance."""
    made = bench()
    seconds(made, 1, DAMPED, OK)
    seconds(made, 2, DAMPED, SLOW)
    assert made.opened == ["host/cpu", "rates/x"]


def test_a_warning_that_is_ending_delays_no_symptom() -> None:
    """It does not become an error soon."""
    made = bench()
    ending = warn("CPU at 91 %", brief="CPU 91 %", condition="cpu_high").with_evidence(FALLING)
    made.see("host/cpu", ending)
    made.later(0.1)
    made.see("rates/x", SLOW)
    made.see("host/cpu", ending)
    assert made.opened == ["rates/x"]
