"""While the Docker Engine does not respond: what can be observed without it is reported, what cannot is not."""

from __future__ import annotations

import pytest

from phm.api import error
from phm.core.model import FaultOpened, Level, Outcome
from tests.fakes.agent_causes import CAUSES, NODES, TARGET
from tests.fakes.agent_world import Sim

SEEDS = range(8)
CONTAINER, NETWORK = f"container/{TARGET}", f"network/{TARGET}"


def down(seed: int, *, kernel: bool = True) -> Sim:
    """An agent whose engine has not responded for ten seconds."""
    sim = Sim(seed)
    sim.world.kernel = kernel
    sim.world.inject("engine", sim.now + 0.5)
    sim.run(10.0)
    assert sim.opened == ["engine"]
    return sim


def conditions(sim: Sim) -> list[tuple[str, str]]:
    opened = [event.fault for _, event in sim.events if isinstance(event, FaultOpened)]
    return [(fault.unit, fault.result.condition) for fault in opened[1:]]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("kind", "condition"),
    [
        ("container", "ended"),
        ("paused", "frozen"),
        ("node_1", "node_missing"),
        ("silent_2", "topic_silent"),
        ("quorum", "quorum_dead"),
        ("starved", "cpu_throttled"),
    ],
)
def test_a_fault_that_needs_no_engine_to_be_seen_is_one_more_alarm(kind: str, condition: str, seed: int) -> None:
    """For as long as the engine was down, nothing below it was reported: an application that died stayed unreported for a flight."""
    sim = down(seed)
    sim.world.inject(kind, sim.now)
    sim.run(12.0)
    assert conditions(sim) == [(CAUSES[kind][0], condition)]
    sim.world.repair("engine", sim.now)
    sim.run(20.0)
    assert conditions(sim) == [(CAUSES[kind][0], condition)], "the same fault afterwards"
    sim.world.repair(kind, sim.now)
    sim.ask(CAUSES[kind][0])
    sim.run(20.0)
    assert {event.fault.outcome for event in sim.closed} == {Outcome.RESOLVED}
    assert len(sim.closed) == 2


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", ["container", "paused", "node_1"])
def test_without_its_cgroup_a_container_and_what_needs_it_wait_for_the_engine(kind: str, seed: int) -> None:
    """The container may be the cause, so nothing below it is judged: as one alarm, not one for each of its nodes."""
    sim = down(seed, kernel=False)
    sim.world.inject(kind, sim.now)
    sim.run(30.0)
    assert sim.opened == ["engine"]
    assert sim.tracker.state(NODES[1]).level is Level.STALE
    sim.world.repair("engine", sim.now)
    sim.ask(CAUSES[kind][0])
    sim.run(12.0)
    assert sim.opened == ["engine", CAUSES[kind][0]]


@pytest.mark.parametrize("seed", SEEDS)
def test_nodes_behind_a_lost_network_wait_for_the_engine(seed: int) -> None:
    """Whether PHM or the container lost the network is known to the engine alone."""
    sim = down(seed)
    sim.world.inject("apart", sim.now)
    sim.run(30.0)
    assert sim.opened == ["engine"]
    sim.world.repair("engine", sim.now)
    sim.ask(NETWORK)
    sim.run(12.0)
    assert sim.opened == ["engine", NETWORK]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_container_that_was_down_before_stays_a_fault(seed: int) -> None:
    """Its cgroup is still empty: the fault is neither closed nor opened again."""
    sim = Sim(seed)
    sim.world.inject("container", sim.now + 0.5)
    sim.run(6.0)
    assert sim.opened == [CONTAINER]
    sim.world.inject("engine", sim.now)
    sim.run(20.0)
    sim.world.repair("engine", sim.now)
    sim.run(20.0)
    assert sorted(sim.opened) == sorted([CONTAINER, "engine"])
    assert [event.fault.unit for event in sim.closed] == ["engine"]


@pytest.mark.parametrize("seed", SEEDS)
def test_an_engine_that_fails_one_run_of_its_check_again_and_again_delays_no_other_fault(seed: int) -> None:
    """Each such run would give grace to all that depends on the engine, and the grace of the next would follow."""
    sim = Sim(seed)
    sim.run(5.0)
    sim.world.inject("node_1", sim.now)
    for _ in range(10):
        sim.take(
            sim.tracker.observe(
                "engine", error("no answer", brief="no answer", condition="engine_down"), sim.now, sim.stamp()
            )
        )
        sim.ask("engine")
        sim.run(1.5)
    assert sim.opened == [NODES[1]]
