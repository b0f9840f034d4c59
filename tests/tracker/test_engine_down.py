"""While the Docker Engine does not respond: it is the cause of what is unknown, but not of a container's own end."""

from __future__ import annotations

import pytest

from phm.core.model import FaultOpened, Level, Outcome
from phm_checks.container import UNNOTICED_S, WITHOUT_ENGINE_S
from tests.fakes import agent_world
from tests.fakes.agent_world import CAUSES, NODES, TARGET, Sim

SEEDS = range(8)
CONTAINER = f"container/{TARGET}"
SEEN = [("container", "ended"), ("paused", "frozen")]
"""Faults of the container that its cgroup shows, and their conditions."""
UNSEEN = ("node_1", "silent_2", "apart", "network", "quorum", "unhealthy", "file", "device")


def down(seed: int, *, cgroups: bool = True) -> Sim:
    """An agent whose engine has not responded for ten seconds."""
    sim = Sim(seed)
    sim.world.cgroups = cgroups
    sim.world.inject("engine", sim.now + 0.5)
    sim.run(10.0)
    assert sim.opened == ["engine"]
    return sim


def conditions(sim: Sim) -> list[tuple[str, str]]:
    opened = [event.fault for _, event in sim.events if isinstance(event, FaultOpened)]
    return [(fault.unit, fault.result.condition) for fault in opened[1:]]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("kind", "condition"), SEEN)
def test_a_container_that_ends_is_one_more_alarm(kind: str, condition: str, seed: int) -> None:
    """An application that died would stay unreported until the engine responds, possibly for a flight."""
    sim = down(seed)
    sim.world.inject(kind, sim.now)
    sim.run(WITHOUT_ENGINE_S - 1.0)
    assert conditions(sim) == [], "an operator may be recreating it"
    sim.run(12.0)
    assert conditions(sim) == [(CONTAINER, condition)]
    for node in NODES.values():
        assert sim.root(node) == CONTAINER
    sim.world.repair("engine", sim.now)
    sim.run(20.0)
    assert conditions(sim) == [(CONTAINER, condition)], "the same fault afterwards"
    assert sim.tracker.state(CONTAINER).result.condition == CAUSES[kind][1]
    sim.world.repair(kind, sim.now)
    sim.ask(CONTAINER)
    sim.run(20.0)
    assert {event.fault.outcome for event in sim.closed} == {Outcome.RESOLVED}
    assert len(sim.closed) == 2


@pytest.mark.parametrize("seed", SEEDS)
def test_an_end_that_no_engine_notices_is_reported_soon(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cgroup would be removed by an engine that works: no one is recreating the container."""
    monkeypatch.setattr(agent_world, "WITHOUT_ENGINE_S", UNNOTICED_S)
    sim = down(seed)
    sim.world.inject("container", sim.now)
    sim.run(UNNOTICED_S - 0.5)
    assert conditions(sim) == []
    sim.run(WITHOUT_ENGINE_S - UNNOTICED_S - 2.0)
    assert conditions(sim) == [(CONTAINER, "ended")]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", UNSEEN)
def test_what_needs_the_engine_to_be_judged_waits_for_it(kind: str, seed: int) -> None:
    """Without process lists a hanging node cannot be distinguished from one that has ended, nor a lost network from lost nodes."""
    sim = down(seed)
    sim.world.inject(kind, sim.now)
    sim.run(30.0)
    unit = CAUSES[kind][0]
    known = ["engine"] if "engine" in sim.tracker.graph.upstream(unit) else ["engine", unit]
    assert sim.opened == known
    sim.world.repair("engine", sim.now)
    sim.ask(unit)
    sim.run(20.0)
    assert sim.opened == ["engine", unit]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", [kind for kind, _ in SEEN])
def test_without_its_cgroup_a_container_waits_for_the_engine(kind: str, seed: int) -> None:
    """Whether it runs is unknown."""
    sim = down(seed, cgroups=False)
    sim.world.inject(kind, sim.now)
    sim.run(30.0)
    assert sim.opened == ["engine"]
    assert sim.tracker.state(NODES[1]).level is Level.STALE
    sim.world.repair("engine", sim.now)
    sim.ask(CONTAINER)
    sim.run(12.0)
    assert sim.opened == ["engine", CONTAINER]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", [kind for kind, _ in SEEN])
def test_a_container_that_was_down_before_stays_a_fault(kind: str, seed: int) -> None:
    """Its cgroup shows the same: the fault is neither closed nor opened again, nor attributed to the engine."""
    sim = Sim(seed)
    sim.world.inject(kind, sim.now + 0.5)
    sim.run(6.0)
    assert sim.opened == [CONTAINER]
    sim.world.inject("engine", sim.now)
    sim.run(20.0)
    assert sim.tracker.state(CONTAINER).level is Level.ERROR
    sim.world.repair("engine", sim.now)
    sim.run(20.0)
    assert sorted(sim.opened) == sorted([CONTAINER, "engine"])
    assert [event.fault.unit for event in sim.closed] == ["engine"]


@pytest.mark.parametrize("seed", SEEDS)
def test_an_engine_that_fails_now_and_then_leaves_a_container_that_is_down_one_alarm(seed: int) -> None:
    """It neither hides the fault nor opens it again."""
    sim = Sim(seed)
    sim.world.inject("container", sim.now + 0.5)
    sim.run(6.0)
    for _ in range(5):
        sim.world.inject("engine", sim.now)
        sim.run(1.0)
        sim.world.repair("engine", sim.now)
        sim.run(4.0)
    assert sim.opened.count(CONTAINER) == 1


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("by", ["hand", "recreate", "policy"])
def test_a_restart_of_the_container_meanwhile_is_not_an_end(by: str, seed: int) -> None:
    """The engine may serve others while PHM cannot reach it; it returns before this lasts for long."""
    sim = down(seed)
    sim.world.restart(sim.now, by)
    sim.run(10.0)
    sim.world.repair("engine", sim.now)
    sim.run(30.0)
    assert sim.opened == ["engine"]
