"""Grace: what is not known yet is no fault, and what was seen before it never counts."""

from __future__ import annotations

from dataclasses import replace

from phm.api import Level
from phm.core.model import Evidence
from tests.fakes.tracker_bench import BAD, OK, Bench, chain, unit


def test_a_flicker_of_a_need_gives_grace() -> None:
    """What looked bad while a need was bad for a moment may follow from it, even if the need was never told."""
    bench = Bench([unit("engine", failures=2), unit("nodes", "engine", grace_s=5.0)])
    bench.later(10)
    bench.all_well()
    bench.see("engine", BAD)
    bench.see("nodes", BAD)
    bench.now += 1
    assert "nodes" in bench.see("engine", OK)
    bench.see("nodes", BAD)
    bench.later(1)
    bench.see("engine", OK)
    assert bench.opened == []


def test_what_was_seen_before_grace_never_counts() -> None:
    """A bad result from before its need recovered opens nothing, however long the unit is not run anew."""
    bench = chain()
    bench.all_well()
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


def test_grace_after_start() -> None:
    """A graph that is still filling is not known yet, and not a fault."""
    bench = Bench([unit("nodes", grace_s=5.0)])
    bench.see("nodes", BAD)
    assert bench.level("nodes") is Level.STALE
    bench.later(4.9)
    assert bench.opened == []
    bench.later(0.2)
    assert bench.opened == ["nodes"]


def test_what_is_certain_needs_no_grace() -> None:
    """Time would not change it. What was seen before a need recovered is old all the same, and must be seen anew."""
    certain = replace(BAD, evidence=Evidence(certain=True))
    bench = Bench([unit("nodes", grace_s=5.0)])
    bench.see("nodes", certain)
    assert bench.opened == ["nodes"]
    bench = chain(grace_s=5.0)
    bench.later(6)
    bench.all_well()
    bench.see("container", BAD)
    bench.see("nodes", certain)
    bench.now += 1
    bench.see("container", OK)
    assert bench.opened == ["container"]
    bench.now += 1
    bench.see("nodes", certain)
    bench.see("container", OK)
    assert bench.opened == ["container", "nodes"]


def test_grace_after_a_need_recovered() -> None:
    """What was blocked gets time to come back before it counts by itself."""
    bench = chain(grace_s=5.0)
    bench.later(6)
    bench.all_well()
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
    bench.all_well()
    bench.see("container", BAD)
    bench.see("nodes", BAD)
    bench.now += 1
    bench.see("container", OK)
    bench.events.clear()


def test_grace_ends_early_once_the_unit_is_surely_well() -> None:
    """A node that dies seconds after a restart is told as quickly as any other."""
    bench = chain(grace_s=8.0)
    recovered(bench)
    for _ in range(4):
        bench.later(1.0)
        bench.see("nodes", OK)
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.opened == ["nodes"]


def test_a_short_ok_does_not_end_grace() -> None:
    """What is still listed from before the restart says nothing about what comes after it."""
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


def test_what_goes_before_its_stopped_container_is_no_fault() -> None:
    """`docker stop`: nodes say goodbye before the container has exited, and the container alone is told."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app", settle_s=0.3)])
    bench.all_well()
    bench.take(bench.tracker.expect_stop("app", bench.stamp(), 11.0))
    bench.now += 0.1
    bench.see("nodes", BAD)
    bench.later(2.0)
    bench.see("container", BAD)
    assert bench.opened == ["container"]
    assert bench.blocked_by("nodes") == "container"


def test_a_stop_that_does_not_come_about_masks_nothing_for_long() -> None:
    """The signal was caught and only a node ended: it is told when the time for stopping is over."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app")])
    bench.all_well()
    bench.take(bench.tracker.expect_stop("app", bench.stamp(), 11.0))
    bench.see("nodes", BAD)
    for _ in range(12):
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", BAD)
    assert bench.opened == ["nodes"]


def stopping() -> Bench:
    """A container that was given a minute to end, and whose parts go on for a while."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app", settle_s=0.3)])
    bench.all_well()
    bench.take(bench.tracker.expect_stop("app", bench.stamp(), 60.0))
    for _ in range(8):
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", OK)
    return bench


def test_a_stop_that_takes_its_time_is_no_fault() -> None:
    """Parts that were OK for a while after the signal and then go are still going with their container."""
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


def test_a_container_that_was_started_again_is_no_longer_stopping() -> None:
    """`docker restart`: what fails in the new one is a fault, however much time the old one had."""
    bench = stopping()
    bench.take(bench.tracker.container_started("app", bench.stamp()))
    for _ in range(5):
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", BAD)
    assert not bench.tracker.is_stopping("app", bench.now)
    assert bench.opened == ["nodes"]


def test_the_container_itself_is_judged_while_it_is_being_stopped() -> None:
    """Only its parts go with it."""
    bench = stopping()
    bench.see("container", BAD)
    assert bench.opened == ["container"]
