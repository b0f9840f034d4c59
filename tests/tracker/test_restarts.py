"""A container that restarts between two checks raises no alarm for its nodes; one that keeps restarting raises one.

Drawn interleavings on the shipped graph, as in `test_interleavings.py`; the container itself is judged by the real
check.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from hypothesis import given, strategies as st

from phm import api, testing
from phm.api import ContainerFact, Level
from phm.core.model import Result
from phm_checks.container import Container
from tests.fakes.agent_world import NODES, TARGET, Bad, Sim, World
from tests.tracker.test_interleavings import SEEDS, assert_over, examples

pytestmark = pytest.mark.long

UNIT = f"container/{TARGET}"
BACKOFF_S, BACKOFF_MAX_S, UP_S = 0.1, 60.0, 10.0
"""How long Docker waits before a restart: twice as long each time, at first again after a life of UP_S."""


@dataclass(frozen=True, slots=True)
class Span:
    """The container waits from `down` on and runs its next life from `up` on."""

    down: float
    up: float
    restarts: int


@dataclass(slots=True)
class LivingWorld(World):
    """A world in which the container ends and is restarted from outside; its check is the real one."""

    spans: list[Span] = field(default_factory=list)
    check: api.Check = field(default_factory=lambda: _container_check())

    def restart_unseen(self, at: float, gap_s: float, *, by_engine: bool, back: bool = True) -> float:
        """The container ends at `at` and runs again after `gap_s`; its nodes return, or never do."""
        up = at + gap_s
        count = self.spans[-1].restarts if self.spans else 0
        self.spans.append(Span(at, up, count + 1 if by_engine else 0))
        cause = Bad(UNIT, at, "exited", 0.0)
        for span in self._ros(at, set(NODES), cause, "container"):
            span.end = max(span.begin, up + span.back_s) if back else float("inf")
            self.bad.setdefault(span.unit, []).append(span)
        self.stale_names.append((up, up + self.random.uniform(0.0, 1.0)))
        return up

    def fact(self, at: float) -> ContainerFact:
        begun = [span for span in self.spans if span.down <= at]
        waits = bool(begun) and at < begun[-1].up
        life = len(begun) - waits
        return testing.container(
            TARGET,
            status="restarting" if waits else "running",
            started_at=f"t{life}",
            restart_count=begun[-1].restarts if begun else 0,
        )

    def result(self, unit: str, at: float) -> Result:
        if unit == UNIT:
            docker = testing.FakeDocker(self.fact(at))
            result = self.check.run(testing.world(clock=testing.FakeClock(at), docker=docker))
            assert isinstance(result, Result)
            return result
        if unit.startswith(("network/", "health/")) and not self.fact(at).running:
            return Result(Level.STALE, "not judged while the container does not run")
        # Not super() without arguments: dataclass slots replace this class.
        return World.result(self, unit, at)


def _container_check() -> api.Check:
    (check,) = Container.build(testing.settings(containers=[{"name": TARGET}]))
    return check


def living(seed: int, *, wakes_lost: float) -> tuple[Sim, LivingWorld]:
    sim = Sim(seed, wakes_lost=wakes_lost)
    world = sim.world = LivingWorld(sim.random)
    sim.ask(UNIT)
    sim.run(2.0)
    return sim, world


def report_starts(sim: Sim, world: LivingWorld, arrives_s: Callable[[], float | None]) -> None:
    """Let the Docker Engine report each start after a delay, or never."""
    due: dict[Span, float | None] = {}

    def observe() -> None:
        for span in world.spans:
            delay_s = due.setdefault(span, arrives_s())
            if delay_s is not None and sim.now >= span.up + delay_s:
                due[span] = None
                sim.take(sim.tracker.container_started(TARGET, sim.stamp()))
                sim.ask(UNIT)

    sim.watch.append(observe)


EVENTS = st.sampled_from(["quick", "late", "some", "none"])


def arrivals(sim: Sim, kind: str) -> Callable[[], float | None]:
    """Events arrive immediately, after an outage of the stream, only sometimes, or never."""
    rnd = sim.random
    return {
        "quick": lambda: rnd.uniform(0.0, 0.2),
        "late": lambda: rnd.uniform(1.0, 6.0),
        "some": lambda: rnd.choice((None, rnd.uniform(0.0, 0.5))),
        "none": lambda: None,
    }[kind]


@examples(120)
@given(SEEDS, EVENTS, st.booleans(), st.integers(1, 2))
def test_a_restart_between_two_checks_is_not_a_fault(seed: int, events: str, by_engine: bool, times: int) -> None:
    """Regardless of who restarted it and which events are lost; a node that dies later is published as quickly as
    usual.
    """
    sim, world = living(seed, wakes_lost=1.0 if events == "none" else 0.3)
    report_starts(sim, world, arrivals(sim, events))
    for _ in range(times):
        world.restart_unseen(sim.now + 0.5, sim.random.uniform(0.1, 1.0), by_engine=by_engine)
        sim.run(sim.random.uniform(16.0, 25.0))
    assert sim.opened == []
    sim.ask(UNIT)
    sim.run(1.0)
    assert sim.units_at(Level.OK) == {state.unit for state in sim.tracker.states()}
    sim.world.inject("node_1", sim.now)
    sim.run(3.0)
    assert sim.opened == [NODES[1]]


@examples(40)
@given(SEEDS, EVENTS)
def test_a_node_missing_after_a_restart_is_published_when_grace_is_over(seed: int, events: str) -> None:
    """Grace is given once per life: nodes that stay away are separate faults, each published once, and nothing else is."""
    sim, world = living(seed, wakes_lost=0.3)
    report_starts(sim, world, arrivals(sim, events))
    world.restart_unseen(sim.now + 0.5, sim.random.uniform(0.1, 1.0), by_engine=True, back=False)
    sim.run(2.0)
    assert sim.opened == []
    sim.run(18.0)
    assert sorted(sim.opened) == sorted(NODES.values())
    assert sim.closed == []


@examples(30)
@given(SEEDS, EVENTS, st.floats(0.2, 7.0))
def test_a_crash_loop_is_one_fault_at_the_container(seed: int, events: str, life_s: float) -> None:
    """Grace after each start hides the nodes, not the loop: one alarm, open until the container stays up."""
    sim, world = living(seed, wakes_lost=1.0 if events == "none" else 0.3)
    report_starts(sim, world, arrivals(sim, events))
    wait_s, lives = BACKOFF_S, 0
    while sim.now < 120.0:
        world.restart_unseen(sim.now + life_s, wait_s, by_engine=True, back=False)
        sim.run(life_s + wait_s)
        wait_s, lives = min(2 * wait_s, BACKOFF_MAX_S), lives + 1
        assert set(sim.opened) <= {UNIT}
        assert sim.closed == []
    assert lives > 3
    assert sim.opened == [UNIT]
    for unit in sim.units_at(Level.STALE).intersection(NODES.values()):
        assert sim.root(unit) == UNIT
    for spans in world.bad.values():
        for span in spans:
            span.end = max(span.begin, sim.now + sim.random.uniform(1.0, 5.0))
    sim.run(40.0)
    sim.ask(UNIT)
    sim.run(1.0)
    assert_over(sim, {UNIT})
