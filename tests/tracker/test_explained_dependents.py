"""What a recovery waits for while a dependent fails because of another fault."""

from __future__ import annotations

from tests.fakes.tracker_bench import BAD, OK, Bench, unit


def two_containers() -> Bench:
    """Both are down. The first one is started and its node is back; its topic also needs the node of the second one, which stays down."""
    bench = Bench(
        [
            unit("container/a", target="a"),
            unit("container/b", target="b"),
            unit("nodes/a", "container/a", target="a"),
            unit("nodes/b", "container/b", target="b"),
            unit("topics/t", "nodes/a", "nodes/b", target="a"),
        ]
    )
    bench.later(10)
    bench.all_healthy()
    for name in ("container/b", "container/a"):
        bench.see(name, BAD)
    bench.take(bench.tracker.begin_action("a", "container/a", "start", bench.stamp(), 60.0, verifying=True))
    bench.later(1)
    for name, result in (("container/a", OK), ("nodes/a", OK), ("topics/t", BAD)):
        bench.see(name, result)
    return bench


def test_a_dependent_that_another_fault_explains_is_not_waited_for() -> None:
    """No action on the first container brings the second one back. Once that is back, the topic counts."""
    bench = two_containers()
    done = bench.now
    assert bench.opened == ["container/b", "container/a"]
    assert bench.tracker.failing_dependents("container/a", done) == ()
    bench.see("container/b", OK)
    assert bench.tracker.failing_dependents("container/a", done) == ("topics/t",)


def test_an_unverified_recovery_does_not_wait_for_a_dependent_that_another_fault_explains() -> None:
    """Its own node is back, so the container is OK, and nothing more is done to it."""
    bench = two_containers()
    bench.take(bench.tracker.end_action("a", bench.stamp(), worked=False))
    bench.later(1)
    for name, result in (("nodes/a", OK), ("topics/t", BAD), ("container/a", OK)):
        bench.see(name, result)
    assert [name for name, *_ in bench.closed] == ["container/a"]
    assert bench.opened == ["container/b", "container/a"]
