"""One cause, one alarm, in whatever order the evidence arrives.

The graph is that of the shipped configuration with the installed checks; `tests/fakes/agent_world.py` simulates the
agent and states the time bounds within which evidence of a cause and of its consequences may interleave. Within them,
the order of runs, lost wake-ups, slow answers and flickers are drawn again for each of more than 1000 examples.
Recovery is the real code (`tests/fakes/sim_recovery.py`); the effects of its actions, and external interventions, are drawn.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st

from phm.api import error, stale
from phm.core.model import FaultClosed, FaultOpened, Level, Outcome
from phm.tracker.starvation import BEFORE_PRESSURE_S
from tests.fakes.agent_world import CAUSES, HIDDEN, STARVING, TARGET, Sim, shipped
from tests.fakes.sim_recovery import SimRecovery

pytestmark = pytest.mark.long

SEEDS = st.integers(0, 2**32)
KINDS = st.sampled_from(sorted(CAUSES))


def examples(count: int) -> settings:
    """Set no deadline: a slow machine is not a failure."""
    return settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck))


NEEDS = Sim(0).tracker.graph


def independent(one: str, other: str) -> bool:
    """Whether the two units differ, neither is upstream of the other, and neither fault explains the other."""
    if STARVING.intersection((one, other)) and HIDDEN.intersection((one, other)):
        return False
    a, b = CAUSES[one][0], CAUSES[other][0]
    return a != b and a not in NEEDS.upstream(b) and b not in NEEDS.upstream(a)


PAIRS = st.sampled_from([(a, b) for a in sorted(CAUSES) for b in sorted(CAUSES) if a < b and independent(a, b)])


@contextmanager
def recovering(sim: Sim, **more: Any) -> Iterator[SimRecovery]:
    recovery = SimRecovery(sim, **more)
    try:
        yield recovery
    finally:
        recovery.stop()


def assert_attributed(sim: Sim, causes: set[str]) -> None:
    """Only the causes are ERROR; affected units are STALE and blocked, directly or indirectly, by one of the causes."""
    assert sim.units_at(Level.ERROR) == causes
    for unit in sim.units_at(Level.STALE):
        if sim.tracker.state(unit).result.level is Level.STALE and sim.tracker.state(unit).blocked_by:
            assert sim.root(unit) in causes, unit


def assert_over(sim: Sim, causes: set[str]) -> None:
    """Each fault was opened once and closed once as resolved, and all units are OK."""
    assert sorted(sim.opened) == sorted(causes)
    assert sorted(event.fault.unit for event in sim.closed) == sorted(causes)
    assert {event.fault.outcome for event in sim.closed} == {Outcome.RESOLVED}
    assert sim.units_at(Level.OK) == {state.unit for state in sim.tracker.states()}


@examples(400)
@given(KINDS, SEEDS, st.booleans())
def test_one_primary_fault_raises_one_alarm_at_its_cause(kind: str, seed: int, events_are_lost: bool) -> None:
    """One primary fault opens one fault, at its cause; affected units are STALE and name it; after the repair all is
    OK.
    """
    sim = Sim(seed, wakes_lost=1.0 if events_are_lost else 0.3)
    sim.world.inject(kind, sim.now + 1.5)
    sim.run(10.0)
    unit = CAUSES[kind][0]
    sim.ask(unit)  # the next pass: possibly nothing depends on it, its event was lost and its period is long
    sim.run(2.0)
    assert sim.opened == [unit]
    assert_attributed(sim, {unit})
    sim.world.repair(kind, sim.now)
    sim.ask(unit)
    sim.run(14.0)
    assert_over(sim, {unit})


@examples(250)
@given(PAIRS, SEEDS, st.floats(0.0, 4.0))
def test_independent_faults_are_each_published_once(pair: tuple[str, str], seed: int, apart_s: float) -> None:
    """Two causes, neither dependent on the other, open two faults; each is closed once when it is repaired."""
    sim = Sim(seed)
    sim.world.inject(pair[0], sim.now + 1.5)
    sim.world.inject(pair[1], sim.now + 1.5 + apart_s)
    sim.run(10.0 + apart_s)
    units = {CAUSES[kind][0] for kind in pair}
    for unit in units - set(sim.opened):
        sim.ask(unit)
    sim.run(2.0)
    assert sorted(sim.opened) == sorted(units)
    assert_attributed(sim, units)
    for kind in pair:
        sim.world.repair(kind, sim.now)
        sim.ask(CAUSES[kind][0])
    sim.run(14.0)
    assert_over(sim, units)


@examples(60)
@given(st.sampled_from(sorted(STARVING)), st.sampled_from(sorted(HIDDEN)), SEEDS, st.floats(1.0, 6.0))
def test_failures_explained_by_starvation_are_published_when_it_is_over(
    starving: str, kind: str, seed: int, after_s: float
) -> None:
    """During starvation there is one alarm, at the cause; a failure that persists after symptoms had time to clear is a
    fault.
    """
    sim, (cause, unit) = Sim(seed), (CAUSES[starving][0], CAUSES[kind][0])
    sim.world.inject(starving, sim.now + 1.5)
    sim.run(1.5 + after_s)
    sim.world.inject(kind, sim.now)
    sim.run(10.0)
    assert sim.opened == [cause]
    sim.world.repair(starving, sim.now)
    sim.ask(cause)
    # The engine probes every 30 s; grace and settling follow a symptom that may last 4.5 s longer; the consensus waits for its nodes.
    sim.run({"unhealthy": 40.0, "quorum": 20.0}.get(kind, 18.0))
    assert sim.opened == [cause, unit]
    assert_attributed(sim, {unit})
    sim.world.repair(kind, sim.now)
    sim.ask(unit)
    sim.run(14.0)
    assert_over(sim, {cause, unit})


@examples(60)
@given(st.sampled_from(sorted(STARVING)), st.sampled_from(sorted(HIDDEN)), SEEDS)
def test_a_fault_older_than_starvation_stays_open(starving: str, kind: str, seed: int) -> None:
    """It is neither published again nor closed; during starvation, recovery is asked to leave it alone."""
    sim, (cause, unit) = Sim(seed), (CAUSES[starving][0], CAUSES[kind][0])
    sim.world.inject(kind, sim.now + 1.5)
    sim.run(5.0)
    sim.ask(unit)
    sim.run(6.0 + BEFORE_PRESSURE_S)
    assert sim.opened == [unit]
    sim.world.inject(starving, sim.now + 1.5)
    sim.run(8.0)
    assert_attributed(sim, {cause, unit})
    assert sim.tracker.starved_by(unit, sim.stamp()) in {cause, f"pressure/{TARGET}"}
    sim.world.repair(starving, sim.now)
    sim.ask(cause)
    sim.run(40.0 if kind == "unhealthy" else 20.0)
    assert sim.tracker.starved_by(unit, sim.stamp()) == ""
    sim.world.repair(kind, sim.now)
    sim.ask(unit)
    sim.run(14.0)
    assert_over(sim, {cause, unit})


@examples(120)
@example(pair=("silent_2", "unhealthy"), seed=1, apart_s=3.5)  # a fault is older than the restart that removes its node
@given(PAIRS, SEEDS, st.floats(0.0, 8.0))
def test_independent_faults_are_each_published_once_during_recovery(
    pair: tuple[str, str], seed: int, apart_s: float
) -> None:
    """One repair may clear both before the second is published; no fault is published twice, and no other one."""
    sim = Sim(seed)
    with recovering(sim):
        sim.world.inject(pair[0], sim.now + 1.5)
        sim.world.inject(pair[1], sim.now + 1.5 + apart_s)
        sim.run(45.0)
        for kind in pair:
            sim.world.repair(kind, sim.now)
            sim.ask(CAUSES[kind][0])
        sim.run(25.0)
    units = {CAUSES[kind][0] for kind in pair}
    published = set(sim.opened)
    assert units >= published >= {unit for unit in units if unit not in sim.touched}
    assert published
    assert_over(sim, published)


@examples(130)
@given(KINDS, SEEDS, st.booleans())
def test_a_repaired_fault_is_published_once_and_closed_once(kind: str, seed: int, in_part: bool) -> None:
    """A brief failure caused by the repair, or a slow return after it, raises no alarm; nor does a target that the
    first step of a ladder leaves lost and the next step recovers.
    """
    sim = Sim(seed)
    with recovering(sim, in_part=float(in_part)) as recovery:
        sim.world.inject(kind, sim.now + 1.5)
        sim.run(5.0)
        sim.ask(CAUSES[kind][0])
        sim.run(35.0)
        if kind in sim.world.active:
            sim.world.repair(kind, sim.now)
            sim.ask(CAUSES[kind][0])
        sim.run(20.0)
    assert_over(sim, {CAUSES[kind][0]})
    assert len(recovery.acted) <= 1 + in_part


BY_OTHERS = ("hand", "policy", "recreate")
HAPPENINGS = st.lists(
    st.tuples(st.sampled_from([*sorted(CAUSES), *BY_OTHERS]), st.floats(6.5, 50.0)), min_size=1, max_size=6
)


def seen_by_phm(happenings: list[tuple[str, float]]) -> bool:
    """Starvation that begins and ends while the Docker Engine is unreachable cannot be seen, nor a probe result caused
    by it.
    """
    kinds = {what for what, _ in happenings}
    return "engine" not in kinds or STARVING.isdisjoint(kinds)


@examples(150)
@example(happenings=[("container", 6.5), ("apart", 17.0), ("starved", 6.5)], seed=0, helps=0.0, critical=False)
@example(happenings=[("apart", 8.0), ("apart", 28.0), ("unhealthy", 7.0)], seed=0, helps=0.0, critical=False)
@example(  # an overload delays the verification of an action for longer than the action may last
    happenings=[("apart", 7.0), ("device", 30.0), ("overload", 7.0)], seed=0, helps=1.0, critical=False
)
@example(  # given up as dead, and unanswering for a moment when it returns
    happenings=[("unhealthy", 13.0), ("device", 14.0), ("node_1", 18.0), ("device", 24.0), ("starved", 37.0)],
    seed=0,
    helps=0.0,
    critical=False,
)
@given(HAPPENINGS.filter(seen_by_phm), SEEDS, st.floats(0.0, 1.0), st.booleans())
def test_recovery_respects_budget_hold_and_arming(
    happenings: list[tuple[str, float]], seed: int, helps: float, critical: bool
) -> None:
    """Whatever fails, returns or is restarted from outside, and however often repairs fail: one cause, one alarm.

    `SimRecovery` asserts that actions run one at a time, within the budget, on a held target, and never on a flight-critical
    target while armed. At the end, everything is repaired and OK.
    """
    sim = Sim(seed)
    sim.ask(f"container/{TARGET}")  # PHM has seen the life that is ended from outside
    sim.run(1.0)
    rules = {"budget": 3, "window": 40.0, "same_failure": 2, "verify": 6.0}
    causes: Counter[str] = Counter()
    with recovering(sim, helps=helps, in_part=0.3, armed=drawn(sim), critical=critical, **rules) as recovery:
        for what, at in sorted(happenings, key=lambda happening: happening[1]):
            sim.run(max(0.0, at - sim.now))
            causes.update(happen(sim, what))
        sim.run(25.0)
        repair_all(sim)
    # What a repair left lost is published as lost when no next step may follow in time.
    causes.update(recovery.left_lost)
    assert not Counter(sim.opened) - (causes + reasons_to_publish_again(sim))
    assert sim.units_at(Level.OK) == {state.unit for state in sim.tracker.states()}


CHANGING = ("network", "apart", "container", "paused", "node_1", *BY_OTHERS)
"""What makes a unit bad in one way and then in another."""


@examples(100)
@given(
    st.lists(st.tuples(st.sampled_from(CHANGING), st.floats(6.5, 60.0)), min_size=2, max_size=7), SEEDS, st.booleans()
)
def test_a_unit_in_error_always_has_a_visible_fault(
    happenings: list[tuple[str, float]], seed: int, nothing_helps: bool
) -> None:
    """The fault is open or given up, also when the failure changes before, during and after a repair; `Sim` asserts it
    at each tick.
    """
    sim = Sim(seed)
    rules = {"budget": 20, "window": 40.0, "same_failure": 2, "verify": 6.0}
    with recovering(sim, helps=0.0 if nothing_helps else 0.6, in_part=0.3, **rules):
        for what, at in sorted(happenings, key=lambda happening: happening[1]):
            sim.run(max(0.0, at - sim.now))
            happen(sim, what)
        sim.run(30.0)
        repair_all(sim)
    assert sim.units_at(Level.OK) == {state.unit for state in sim.tracker.states()}


def repair_all(sim: Sim) -> None:
    """End all faults and let PHM find that. The second request is for a HEALTHCHECK that is starting at the first."""
    for kind in list(sim.world.active):
        sim.world.repair(kind, sim.now)
    for seconds in (10.0, 30.0):
        for state in sim.tracker.states():
            sim.ask(state.unit)
        sim.run(seconds)


def reasons_to_publish_again(sim: Sim) -> Counter[str]:
    """Causes whose fault may be published again: after each start, during which the container did not run, the fault
    may have been found to be a consequence; or it was given up, and recovery attempts were reset from outside, or it failed in
    another way.
    """
    again = Counter({f"container/{TARGET}": len(sim.world.lives) - 1})
    again.update(event.fault.unit for event in sim.closed if event.fault.outcome is Outcome.REATTRIBUTED)
    again.update(sim.reset_units)
    given_up = {
        (event.fault.unit, event.fault.result.condition)
        for event in sim.closed
        if event.fault.outcome is Outcome.ESCALATED
    }
    opened = {
        (event.fault.unit, event.fault.result.condition) for _, event in sim.events if isinstance(event, FaultOpened)
    }
    again.update(unit for unit, _ in opened - given_up if unit in {one for one, _ in given_up})
    return again


def drawn(sim: Sim) -> Callable[[float], bool]:
    """Two periods during which the vehicle is armed."""
    spans = [(begin := sim.random.uniform(0, 60), begin + sim.random.uniform(0, 20)) for _ in range(2)]
    return lambda now: any(begin <= now < end for begin, end in spans)


def happen(sim: Sim, what: str) -> list[str]:
    """Start a cause, end it if it is active, or start the container from outside; return units with a new cause."""
    now, spans = sim.now, sim.world.active.get(what)
    if what in BY_OTHERS:
        sim.world.restart(now + 0.05, what)
    elif spans is None:
        sim.world.inject(what, now + 0.05)
        return [CAUSES[what][0]]
    elif now - spans[0].begin > 3.0:  # a cause that ended before all its consequences began does not count
        sim.world.repair(what, now)
        if what == "container" and sim.world.fact(now).running:
            sim.world.record_start(now, "hand")
    return []


@examples(120)
@given(KINDS, SEEDS, st.floats(0.05, 0.25))
def test_flickers_old_results_and_unknown_units_open_no_fault(kind: str, seed: int, lasts_s: float) -> None:
    """Bad evidence of a dependent that is shorter than its settle_s, results of older runs, and STALE publish nothing."""
    sim = Sim(seed)
    sim.world.sure = False  # conclusive evidence does not settle and is published immediately
    unit = CAUSES[kind][0]
    settle_s = {entry.unit.id: entry.unit.settle_s for entry in shipped()[1].tracked}[unit]
    if settle_s:
        sim.world.inject(kind, sim.now + 1.5)
        for span in sim.world.active[kind]:
            span.back_s = lasts_s
            span.end = span.begin + lasts_s
    for _ in range(20):
        sim.run(0.4)
        other = sim.random.choice([state.unit for state in sim.tracker.states()])
        old = error("old news", brief="old", condition="old")
        sim.take(sim.tracker.observe(other, old, sim.tracker.last_started(other) - 0.01, sim.stamp()))
        sim.take(sim.tracker.observe(other, stale("cannot tell"), sim.now, sim.stamp()))
        sim.ask(other)
    sim.run(
        12.0 + max(entry.period_s for entry in sim.plan.scheduled)
    )  # a unit whose wake-up was lost runs by its period
    assert [event for _, event in sim.events if isinstance(event, FaultOpened | FaultClosed)] == []
    assert {state.level for state in sim.tracker.states()} == {Level.OK}
