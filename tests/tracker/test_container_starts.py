"""A container that somebody starts again gives grace to what needs it, once for each life."""

from __future__ import annotations

from phm.api import Level, Result, error, ok, stale
from phm.core.model import Evidence, FaultOpened, Outcome
from tests.fakes.tracker_bench import BAD, OK, Bench, unit


def lived(life: int) -> Result:
    return ok("running").with_evidence(Evidence(generation=f"id@{life}"))


def living() -> Bench:
    """A container in its first life, long after PHM's start, with nodes of its own and a topic of another container."""
    bench = Bench(
        [
            unit("container", target="app"),
            unit("nodes", "container", target="app", settle_s=0.3, grace_s=8.0),
            unit("topics", "nodes", target="other", grace_s=8.0),
        ]
    )
    bench.later(20)
    bench.all_well()
    bench.see("container", lived(1))
    bench.later(1)
    return bench


def all_missing(bench: Bench, seconds: float, life: int) -> None:
    """Nodes and topics are looked for in vain, and the container is seen to run."""
    for _ in range(round(seconds * 2)):
        bench.later(0.5)
        bench.see("topics", BAD)
        bench.see("nodes", BAD)
        bench.see("container", lived(life))


def heard(bench: Bench) -> None:
    bench.take(bench.tracker.container_started("app", bench.stamp()))


def test_a_new_life_gives_grace_to_all_that_need_the_container() -> None:
    """Restarted between two looks, with every event lost: what is missing meanwhile is not known yet, and told after."""
    bench = living()
    bench.see("nodes", BAD)
    all_missing(bench, 7.5, life=2)
    assert bench.opened == []
    assert bench.level("nodes") is bench.level("topics") is Level.STALE
    all_missing(bench, 2.0, life=2)
    assert bench.opened == ["nodes"]


def test_the_event_of_a_start_gives_the_same_grace() -> None:
    """Also where nobody can look at the container: its check is disabled, or the engine hangs."""
    bench = Bench([unit("health", target="app"), unit("nodes", "health", target="app", settle_s=0.3, grace_s=8.0)])
    bench.later(20)
    bench.all_well()
    heard(bench)
    for _ in range(14):
        bench.later(0.5)
        bench.see("nodes", BAD)
        bench.see("health", OK)
    assert bench.opened == []
    for _ in range(6):
        bench.later(0.5)
        bench.see("nodes", BAD)
        bench.see("health", OK)
    assert bench.opened == ["nodes"]


def test_an_event_and_the_look_after_it_are_one_life() -> None:
    """Grace is given once for each life, whoever tells of it second and however late."""
    for event_first in (True, False):
        bench = living()
        if event_first:
            heard(bench)
        else:
            bench.see("container", lived(2))
        bench.later(4)
        if event_first:
            bench.see("container", lived(2))
        else:
            heard(bench)
        all_missing(bench, 5.0, life=2)
        assert bench.opened == ["nodes"], f"{event_first=}"


def test_each_further_life_gives_grace_whichever_events_are_lost() -> None:
    """An event that never came must not cost a later life its grace."""
    for events in [(True, False, True, False), (False, True, False, True), (False,) * 4, (True,) * 4]:
        bench = living()
        for life, event in enumerate(events, 2):
            if event:
                heard(bench)
                bench.now += 0.1
            all_missing(bench, 6.0, life)
            for _ in range(6):
                bench.later(0.5)
                for name in ("nodes", "topics"):
                    bench.see(name, OK)
                bench.see("container", lived(life))
        assert bench.opened == [], f"{events=}"


def test_a_look_that_was_on_its_way_when_the_event_came_is_of_the_old_life() -> None:
    """The run began before the start: that it saw the old life does not mean that the event was wrong."""
    bench = living()
    before = bench.now
    bench.now += 0.1
    heard(bench)
    bench.see("container", lived(1), started=before)
    bench.later(4)
    bench.see("container", lived(2))
    all_missing(bench, 5.0, life=2)
    assert bench.opened == ["nodes"]


def test_the_first_life_seen_is_no_restart() -> None:
    """A look at the container must not end what is known about its nodes."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app", settle_s=0.3)])
    bench.later(20)
    bench.see("nodes", BAD)
    all_seen = bench.see("container", lived(1))
    bench.later(0.5)
    bench.see("nodes", BAD)
    bench.see("container", lived(1))
    assert all_seen == set()
    assert bench.opened == ["nodes"]


def test_only_one_unit_tells_the_lives_of_a_container() -> None:
    """Two that name them differently would tell of a new one all the time, and hide everything behind its grace."""
    bench = living()
    for _ in range(4):
        bench.later(0.5)
        bench.see(
            "nodes", error("gone", brief="gone", condition="gone").with_evidence(Evidence(generation="other words"))
        )
        bench.see("container", lived(1))
    assert bench.opened == ["nodes"]


def test_an_open_fault_goes_on_through_a_new_life() -> None:
    """Somebody restarts the container to mend a dead node: it stays told until it is well."""
    bench = living()
    all_missing(bench, 1.5, life=1)
    assert bench.opened == ["nodes"]
    heard(bench)
    all_missing(bench, 3.0, life=2)
    assert bench.level("nodes") is Level.ERROR
    bench.see("nodes", OK)
    assert bench.closed == [("nodes", Outcome.RESOLVED, "itself")]
    assert bench.opened == ["nodes"]


def test_a_memory_of_what_was_there_does_not_end_grace() -> None:
    """A topic whose publisher has gone counts as silent three seconds later: until then OK says nothing."""
    bench = Bench([unit("container", target="app"), unit("rates", "container", grace_s=8.0, memory_s=4.0)])
    bench.later(20)
    bench.all_well()
    bench.see("container", lived(1))
    bench.see("container", lived(2))
    for result in (*[OK] * 6, *[BAD] * 8):
        bench.later(0.5)
        bench.see("rates", result)
        bench.see("container", lived(2))
    assert bench.opened == []


def ok_since_start_s(bench: Bench) -> list[float]:
    return [round(event.fault.ok_since_start_s, 3) for event in bench.events if isinstance(event, FaultOpened)]


def test_a_fault_knows_how_long_its_unit_was_well_in_this_life() -> None:
    """In all, breaks or not; what was well before the container was started does not count."""
    bench = living()
    bench.later(30)
    bench.see("container", lived(2))
    bench.see("nodes", OK)
    bench.later(4)
    bench.see("nodes", stale("no picture"))
    bench.later(3)
    bench.see("nodes", OK)
    bench.later(6)
    for _ in range(4):
        bench.see("nodes", BAD)
        bench.see("container", lived(2))
        bench.later(0.2)
    assert bench.opened == ["nodes"]
    (seconds,) = ok_since_start_s(bench)
    assert 10.0 <= seconds <= 11.0


def test_what_was_never_told_well_in_this_life_counts_nothing() -> None:
    """Broken from the start."""
    bench = living()
    bench.later(30)
    bench.see("nodes", BAD)
    all_missing(bench, 10.0, life=2)
    assert ok_since_start_s(bench) == [0.0]


def test_a_fault_knows_whether_its_container_was_started_before_phm_looked() -> None:
    """Then all has come up long ago, as far as anybody knows."""
    bench = living()
    bench.later(1)
    for _ in range(4):
        bench.see("nodes", BAD)
        bench.see("container", lived(1))
        bench.later(0.2)
    all_missing(bench, 2.0, life=1)
    (fault,) = [event.fault for event in bench.events if isinstance(event, FaultOpened)]
    assert (fault.start_seen, fault.ok_since_start_s > 0) == (False, True)
