"""One cause, one alarm: whatever order the evidence arrives in.

The graph is the shipped configuration's, with the installed checks; `tests/fakes/agent_world.py` simulates the agent and
states the bounds of time within which evidence of a cause and of its consequences may interleave. Within them the
order of runs, lost wake-ups, slow answers and flickers are drawn anew in each of more than 1000 examples.
"""

from __future__ import annotations

from itertools import pairwise

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phm.api import error, stale
from phm.model import FaultClosed, FaultOpened, Level, Outcome
from tests.fakes.agent_world import CAUSES, Healer, Sim, shipped

SEEDS = st.integers(0, 2**32)
KINDS = st.sampled_from(sorted(CAUSES))


def examples(count: int) -> settings:
    """Reproducible in CI; a slow machine is no failure."""
    return settings(max_examples=count, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


def independent(one: str, other: str) -> bool:
    """Whether neither fault's unit is upstream of the other's, nor the same."""
    needs = Sim(0).tracker.needs
    a, b = CAUSES[one][0], CAUSES[other][0]
    return a != b and a not in needs.upstream(b) and b not in needs.upstream(a)


PAIRS = st.sampled_from([(a, b) for a in sorted(CAUSES) for b in sorted(CAUSES) if a < b and independent(a, b)])


def assert_attributed(sim: Sim, causes: set[str]) -> None:
    """The causes alone are ERROR; who suffers is STALE, blocked in the end by one of the causes."""
    assert sim.told(Level.ERROR) == causes
    for unit in sim.told(Level.STALE):
        if sim.tracker.state(unit).result.level is Level.STALE and sim.tracker.state(unit).blocked_by:
            assert sim.root(unit) in causes, unit


def assert_over(sim: Sim, causes: set[str]) -> None:
    """Each fault was opened once and closed once as resolved, and all is well."""
    assert sorted(sim.opened) == sorted(causes)
    assert sorted(event.fault.unit for event in sim.closed) == sorted(causes)
    assert {event.fault.outcome for event in sim.closed} == {Outcome.RESOLVED}
    assert sim.told(Level.OK) == {state.unit for state in sim.tracker.states()}


@examples(400)
@given(KINDS, SEEDS, st.booleans())
def test_one_fault_is_one_alarm_at_its_cause(kind: str, seed: int, events_are_lost: bool) -> None:
    """One primary fault opens one fault, at its cause; whoever suffers is STALE and names it; repaired, all is OK."""
    sim = Sim(seed, wakes_lost=1.0 if events_are_lost else 0.3)
    sim.world.inject(kind, sim.now + 1.5)
    sim.run(10.0)
    unit = CAUSES[kind][0]
    sim.ask(unit)  # the next pass: nobody may have needed it, its event was lost and its period is long
    sim.run(2.0)
    assert sim.opened == [unit]
    assert_attributed(sim, {unit})
    sim.world.repair(kind, sim.now)
    sim.ask(unit)
    sim.run(14.0)
    assert_over(sim, {unit})


@examples(250)
@given(PAIRS, SEEDS, st.floats(0.0, 4.0))
def test_independent_faults_are_each_told_once(pair: tuple[str, str], seed: int, apart_s: float) -> None:
    """Two causes of which neither needs the other open two faults, and each is closed once when it is repaired."""
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


@examples(250)
@given(KINDS, SEEDS)
def test_a_healed_fault_is_told_once_and_closed_once(kind: str, seed: int) -> None:
    """What the repair itself breaks for a moment, and what comes back slowly after it, is no alarm."""
    sim = Sim(seed)
    healer = Healer(sim)
    sim.world.inject(kind, sim.now + 1.5)
    sim.run(5.0)
    sim.ask(CAUSES[kind][0])
    sim.run(15.0)
    if kind in sim.world.active:
        sim.world.repair(kind, sim.now)
        sim.ask(CAUSES[kind][0])
    sim.run(20.0)
    assert_over(sim, {CAUSES[kind][0]})
    assert len(healer.acted) <= 1 + (kind == "paused")


@examples(120)
@given(st.lists(KINDS, min_size=1, max_size=4), SEEDS, st.floats(0.0, 0.9), st.booleans())
def test_actions_respect_budget_hold_and_arming(kinds: list[str], seed: int, helps: float, critical: bool) -> None:
    """However often repairs fail: one action at a time, none beyond the budget, none armed on what is flight-critical."""
    sim = Sim(seed)
    armed = [(begin := sim.random.uniform(0, 60), begin + sim.random.uniform(0, 20)) for _ in range(2)]

    def is_armed(now: float) -> bool:
        return any(begin <= now < end for begin, end in armed)

    healer = Healer(sim, helps=helps, armed=is_armed)
    assert healer.container is not None
    healer.container = healer.container.model_copy(update={"flight_critical": critical})
    healer.recovery = healer.recovery.model_copy(update={"budget": 3, "window": 40.0, "same_failure": 10})
    for kind in kinds:
        if kind not in sim.world.active:
            sim.world.inject(kind, sim.now + sim.random.uniform(1.5, 20.0))
    sim.run(60.0)
    begun = [began for began, _, _, _ in healer.acted]
    assert all(ended <= began for (_, ended, _, _), (began, _, _, _) in pairwise(healer.acted))
    assert all(sum(first <= other < first + 40.0 for other in begun) <= 3 for first in begun)
    assert not critical or not any(is_armed(began) for began in begun)


@examples(120)
@given(KINDS, SEEDS, st.floats(0.05, 0.25))
def test_neither_flicker_nor_old_nor_unknown_opens_a_fault(kind: str, seed: int, lasts_s: float) -> None:
    """Bad evidence of a dependent shorter than its settle_s, results of older runs, and STALE tell nothing."""
    sim = Sim(seed)
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
    sim.run(12.0)
    assert [event for _, event in sim.events if isinstance(event, FaultOpened | FaultClosed)] == []
    assert {state.level for state in sim.tracker.states()} == {Level.OK}
