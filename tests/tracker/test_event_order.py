"""Events of the Docker Engine apply before the results that they explain, in whatever order threads deliver them."""

from __future__ import annotations

import itertools

import pytest

from phm.api import Evidence, Level, Result, error, ok
from tests.fakes.tracker_bench import BAD, OK, Bench, unit

GONE = error("exited", brief="exited", condition="exited").with_evidence(Evidence(generation="id@1"))


def ran_in_life(life: int) -> Result:
    return ok("running").with_evidence(Evidence(generation=f"id@{life}"))


def agent() -> Bench:
    """A container with a node, and a topic of another container; all OK for a long time."""
    bench = Bench(
        [
            unit("container", target="app"),
            unit("nodes", "container", target="app", grace_s=8.0),
            unit("topics", "nodes", target="other", settle_s=0.3, grace_s=8.0),
        ]
    )
    bench.later(20)
    bench.all_healthy()
    bench.see("container", ran_in_life(1))
    bench.later(5)
    return bench


def died(bench: Bench) -> set[str]:
    return bench.take(bench.tracker.container_ended("app", bench.stamp()))


def test_a_check_that_began_before_the_reported_end_is_outdated() -> None:
    """The Docker Engine is queried, the container ends, its event arrives, and only then the answer: running."""
    bench = agent()
    bench.see("nodes", BAD)
    looked = bench.now = bench.now + 0.01
    bench.now += 0.3
    again = died(bench)
    bench.now += 0.1
    bench.see("container", ran_in_life(1), started=looked)
    assert bench.opened == []
    assert "nodes" in again
    bench.see("nodes", BAD)
    bench.later(0.1)
    bench.see("container", GONE)
    assert bench.opened == ["container"]
    assert bench.blocked_by("nodes") == "container"


@pytest.mark.parametrize("order", list(itertools.permutations(("nodes", "topics", "container", "end"))))
def test_runs_from_before_the_end_raise_no_alarm_in_any_order(order: tuple[str, ...]) -> None:
    """Runs that began before the container ended return late and in any order, with its end in between."""
    bench = agent()
    began = bench.now
    late = {"nodes": BAD, "topics": BAD, "container": ran_in_life(1)}
    bench.now += 0.5
    for what in order:
        bench.later(0.2)
        if what == "end":
            died(bench)
        else:
            bench.see(what, late[what], started=began)
    for _ in range(4):
        bench.later(0.2)
        bench.see("topics", BAD)
        bench.see("nodes", BAD)
    assert bench.opened == []
    bench.see("container", GONE)
    assert bench.opened == ["container"]
    assert bench.level("nodes") is bench.level("topics") is Level.STALE


def test_a_node_that_died_independently_is_reported_by_later_runs() -> None:
    """The end of a life gives no grace: runs that began after it, in a running container, count immediately."""
    bench = agent()
    died(bench)
    bench.now += 0.01
    bench.see("nodes", BAD)
    bench.now += 0.01
    bench.see("container", ran_in_life(1))
    assert bench.opened == ["nodes"]


def test_results_from_before_an_announced_life_prove_nothing() -> None:
    """A start event arrived, and a run shows that the container has been started once more since."""
    bench = agent()
    bench.take(bench.tracker.container_started("app", bench.stamp()))
    for _ in range(18):
        bench.later(0.5)
        bench.see("nodes", OK)
    bench.see("nodes", BAD)
    bench.now += 0.01
    assert "nodes" in bench.see("container", ran_in_life(3))
    assert bench.opened == []
    assert bench.level("nodes") is not Level.ERROR
