"""Grace: a unit that is not known yet is not a fault, and results from before grace never count."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm.api import Level
from phm.core.model import Evidence
from tests.fakes.tracker_bench import BAD, OK, Bench, chain, unit


def test_a_flicker_of_a_dependency_gives_grace() -> None:
    """A failure seen while a dependency failed briefly may be its consequence, even if that failure was never
    published.
    """
    bench = Bench([unit("engine", failures=2), unit("nodes", "engine", grace_s=5.0)])
    bench.later(10)
    bench.all_healthy()
    bench.see("engine", BAD)
    bench.see("nodes", BAD)
    bench.now += 1
    assert "nodes" in bench.see("engine", OK)
    bench.see("nodes", BAD)
    bench.later(1)
    bench.see("engine", OK)
    assert bench.opened == []


def test_a_result_from_before_grace_never_counts() -> None:
    """A bad result from before the dependency recovered opens no fault, however long the unit is not run again."""
    bench = chain()
    bench.all_healthy()
    bench.see("container", BAD)
    bench.see("nodes", BAD)
    bench.now += 1
    bench.see("container", OK)
    bench.now += 1
    bench.later(30)
    bench.see("container", OK)
    assert bench.opened == ["container"]
    assert bench.level("nodes") is Level.STALE
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.opened == ["container", "nodes"]


def test_missing_units_are_unknown_during_grace_after_start() -> None:
    """An incomplete ROS graph is unknown, not a fault."""
    bench = Bench([unit("nodes", grace_s=5.0)])
    bench.see("nodes", BAD)
    assert bench.level("nodes") is Level.STALE
    bench.later(4.9)
    assert bench.opened == []
    bench.later(0.2)
    assert bench.opened == ["nodes"]


def test_a_defect_in_one_unit_does_not_stop_the_time_of_others() -> None:
    """Here a result that no check may return (`phm.checking.result_check`)."""
    bench = Bench([unit("odd", grace_s=5.0), unit("nodes", grace_s=5.0)])
    with pytest.raises(TypeError):
        bench.see("odd", replace(BAD, evidence=Evidence(observed=None)))  # type: ignore[arg-type]
    bench.see("nodes", BAD)
    bench.later(5.1)
    assert bench.opened == ["nodes"]


def test_conclusive_evidence_needs_no_grace() -> None:
    """Time would not change it. Evidence from before a dependency recovered is still outdated and must be seen again."""
    certain = replace(BAD, evidence=Evidence(certain=True))
    bench = Bench([unit("nodes", grace_s=5.0)])
    bench.see("nodes", certain)
    assert bench.opened == ["nodes"]
    bench = chain(grace_s=5.0)
    bench.later(6)
    bench.all_healthy()
    bench.see("container", BAD)
    bench.see("nodes", certain)
    bench.now += 1
    bench.see("container", OK)
    assert bench.opened == ["container"]
    bench.now += 1
    bench.see("nodes", certain)
    bench.see("container", OK)
    assert bench.opened == ["container", "nodes"]


def test_a_blocked_unit_gets_grace_after_its_dependency_recovered() -> None:
    """A blocked unit gets time to recover before its own failure counts."""
    bench = chain(grace_s=5.0)
    bench.later(6)
    bench.all_healthy()
    bench.see("container", BAD)
    bench.see("nodes", BAD)
    bench.now += 1
    rerun = bench.see("container", OK)
    assert "nodes" in rerun
    bench.now += 1
    bench.see("nodes", BAD)
    bench.later(2)
    assert bench.opened == ["container"]
    bench.later(5)
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.opened == ["container", "nodes"]


def recovered(bench: Bench) -> None:
    """The container was down and is back; its nodes have eight seconds of grace."""
    bench.later(10)
    bench.all_healthy()
    bench.see("container", BAD)
    bench.see("nodes", BAD)
    bench.now += 1
    bench.see("container", OK)
    bench.events.clear()


def test_grace_ends_early_once_the_unit_is_reliably_ok() -> None:
    """A node that dies seconds after a restart is published as quickly as any other."""
    bench = chain(grace_s=8.0)
    recovered(bench)
    for _ in range(4):
        bench.later(1.0)
        bench.see("nodes", OK)
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.opened == ["nodes"]


def test_a_short_ok_does_not_end_grace() -> None:
    """The graph may still list an endpoint from before the restart."""
    bench = chain(grace_s=8.0)
    recovered(bench)
    bench.see("nodes", OK)
    bench.later(1.0)
    bench.see("nodes", OK)
    for _ in range(3):
        bench.later(1.0)
        bench.see("nodes", BAD)
        bench.see("container", OK)
    bench.see("nodes", OK)
    assert bench.opened == []


def test_a_node_that_ends_before_its_stopped_container_is_not_a_fault() -> None:
    """`docker stop`: nodes shut down before the container has exited; only the container is published."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app", settle_s=0.3)])
    bench.all_healthy()
    bench.take(bench.tracker.expect_stop("app", bench.stamp(), 11.0))
    bench.now += 0.1
    bench.see("nodes", BAD)
    bench.later(2.0)
    bench.see("container", BAD)
    assert bench.opened == ["container"]
    assert bench.blocked_by("nodes") == "container"


def test_an_ignored_stop_masks_faults_only_briefly() -> None:
    """The signal was caught and only a node ended: it is published when the time for stopping is over."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app")])
    bench.all_healthy()
    bench.take(bench.tracker.expect_stop("app", bench.stamp(), 11.0))
    bench.see("nodes", BAD)
    for _ in range(12):
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", BAD)
    assert bench.opened == ["nodes"]


def stopping() -> Bench:
    """A container with a stop timeout of one minute, whose nodes keep running for a while."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app", settle_s=0.3)])
    bench.all_healthy()
    bench.take(bench.tracker.expect_stop("app", bench.stamp(), 60.0))
    for _ in range(8):
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", OK)
    return bench


def test_a_slow_stop_is_not_a_fault() -> None:
    """Nodes that are OK for a while after the signal and then end still end with their container."""
    bench = stopping()
    for _ in range(40):
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", BAD)
    assert bench.opened == []
    assert bench.level("nodes") is Level.STALE
    assert "app is being stopped" in bench.tracker.state("nodes").result.summary
    bench.take(bench.tracker.container_ended("app", bench.stamp()))
    bench.see("container", BAD)
    assert (bench.opened, bench.blocked_by("nodes")) == (["container"], "container")


def test_a_restarted_container_is_no_longer_stopping() -> None:
    """`docker restart`: a failure in the new run is a fault, however long the stop timeout of the old one was."""
    bench = stopping()
    bench.take(bench.tracker.container_started("app", bench.stamp()))
    for _ in range(5):
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", BAD)
    assert not bench.tracker.is_stopping("app", bench.now)
    assert bench.opened == ["nodes"]


def test_the_container_itself_is_still_checked_while_it_is_stopping() -> None:
    """Only its dependents are masked."""
    bench = stopping()
    bench.see("container", BAD)
    assert bench.opened == ["container"]
