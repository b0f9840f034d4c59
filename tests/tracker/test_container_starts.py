"""A container that is started from outside gives grace to its dependents, once per start."""

from __future__ import annotations

import pytest

from phm.api import Level, Result, error, ok, stale
from phm.core.model import Evidence, FaultOpened, Outcome
from tests.fakes.tracker_bench import BAD, OK, Bench, unit


def ran_in_life(life: int) -> Result:
    return ok("running").with_evidence(Evidence(generation=f"id@{life}"))


def living() -> Bench:
    """A container in its first life, long after PHM's start, with its own nodes and a topic of another container."""
    bench = Bench(
        [
            unit("container", target="app"),
            unit("nodes", "container", target="app", settle_s=0.3, grace_s=8.0),
            unit("topics", "nodes", target="other", grace_s=8.0),
        ]
    )
    bench.later(20)
    bench.all_healthy()
    bench.see("container", ran_in_life(1))
    bench.later(1)
    return bench


def all_missing(bench: Bench, seconds: float, life: int) -> None:
    """Nodes and topics are missing while the container is seen running."""
    for _ in range(round(seconds * 2)):
        bench.later(0.5)
        bench.see("topics", BAD)
        bench.see("nodes", BAD)
        bench.see("container", ran_in_life(life))


def all_published_ok(bench: Bench) -> None:
    bench.take(bench.tracker.container_started("app", bench.stamp()))


def test_a_new_life_gives_grace_to_all_dependents() -> None:
    """Restarted between two checks, with every event lost: missing dependents are unknown at first and published later."""
    bench = living()
    bench.see("nodes", BAD)
    all_missing(bench, 7.5, life=2)
    assert bench.opened == []
    assert bench.level("nodes") is bench.level("topics") is Level.STALE
    all_missing(bench, 2.0, life=2)
    assert bench.opened == ["nodes"]


def test_a_start_event_gives_the_same_grace() -> None:
    """Also when the container cannot be checked: its check is disabled, or the Docker Engine hangs."""
    bench = Bench([unit("health", target="app"), unit("nodes", "health", target="app", settle_s=0.3, grace_s=8.0)])
    bench.later(20)
    bench.all_healthy()
    all_published_ok(bench)
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


def ended(observed: float) -> Result:
    return BAD.with_evidence(Evidence(certain=True, conclusive=True, observed=observed))


def test_certain_evidence_from_before_a_start_opens_no_fault() -> None:
    """A check that runs after the start may still judge by a list of processes from before; by a newer list, the fault is certain."""
    bench = living()
    listed = bench.now
    bench.later(1)
    all_published_ok(bench)
    for _ in range(4):
        bench.later(0.3)
        bench.see("container", ran_in_life(2))
        bench.see("nodes", ended(listed))
    assert bench.opened == []
    assert bench.level("nodes") is Level.STALE
    for _ in range(4):
        bench.later(0.3)
        bench.see("container", ran_in_life(2))
        bench.see("nodes", ended(bench.now))
    assert bench.opened == ["nodes"]


def test_an_event_and_the_following_check_report_one_life() -> None:
    """Grace is given once per life, regardless of which source reports it second and how late."""
    for event_first in (True, False):
        bench = living()
        if event_first:
            all_published_ok(bench)
        else:
            bench.see("container", ran_in_life(2))
        bench.later(4)
        if event_first:
            bench.see("container", ran_in_life(2))
        else:
            all_published_ok(bench)
        all_missing(bench, 5.0, life=2)
        assert bench.opened == ["nodes"], f"{event_first=}"


def test_each_new_life_gives_grace_whichever_events_are_lost() -> None:
    """A lost event does not cost a later life its grace."""
    for events in [(True, False, True, False), (False, True, False, True), (False,) * 4, (True,) * 4]:
        bench = living()
        for life, event in enumerate(events, 2):
            if event:
                all_published_ok(bench)
                bench.now += 0.1
            all_missing(bench, 6.0, life)
            for _ in range(6):
                bench.later(0.5)
                for name in ("nodes", "topics"):
                    bench.see(name, OK)
                bench.see("container", ran_in_life(life))
        assert bench.opened == [], f"{events=}"


def test_a_check_that_began_before_the_event_describes_the_old_life() -> None:
    """The run began before the start: it saw the old life, which does not make the event wrong."""
    bench = living()
    before = bench.now
    bench.now += 0.1
    all_published_ok(bench)
    bench.see("container", ran_in_life(1), started=before)
    bench.later(4)
    bench.see("container", ran_in_life(2))
    all_missing(bench, 5.0, life=2)
    assert bench.opened == ["nodes"]


def test_the_first_observed_life_is_not_a_restart() -> None:
    """The first check of the container does not discard what is known about its nodes."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app", settle_s=0.3)])
    bench.later(20)
    bench.see("nodes", BAD)
    all_seen = bench.see("container", ran_in_life(1))
    bench.later(0.5)
    bench.see("nodes", BAD)
    bench.see("container", ran_in_life(1))
    assert all_seen == set()
    assert bench.opened == ["nodes"]


def test_only_one_unit_reports_the_lives_of_a_container() -> None:
    """Two units that name lives differently would report a new life at every run and hide all faults behind its grace."""
    bench = living()
    for _ in range(4):
        bench.later(0.5)
        bench.see(
            "nodes", error("gone", brief="gone", condition="gone").with_evidence(Evidence(generation="other words"))
        )
        bench.see("container", ran_in_life(1))
    assert bench.opened == ["nodes"]


def test_an_open_fault_persists_through_a_new_life() -> None:
    """A container is restarted to repair a dead node: the fault stays published until the node is OK."""
    bench = living()
    all_missing(bench, 1.5, life=1)
    assert bench.opened == ["nodes"]
    all_published_ok(bench)
    all_missing(bench, 3.0, life=2)
    assert bench.level("nodes") is Level.ERROR
    bench.see("nodes", OK)
    assert bench.closed == [("nodes", Outcome.RESOLVED, "itself")]
    assert bench.opened == ["nodes"]


def test_an_outdated_ok_does_not_end_grace() -> None:
    """A topic counts as silent only three seconds after its publisher disappears; OK until then proves nothing."""
    bench = Bench([unit("container", target="app"), unit("rates", "container", grace_s=8.0, memory_s=4.0)])
    bench.later(20)
    bench.all_healthy()
    bench.see("container", ran_in_life(1))
    bench.see("container", ran_in_life(2))
    for result in (*[OK] * 6, *[BAD] * 8):
        bench.later(0.5)
        bench.see("rates", result)
        bench.see("container", ran_in_life(2))
    assert bench.opened == []


def ok_since_start_s(bench: Bench) -> list[float]:
    return [round(event.fault.ok_since_start_s, 3) for event in bench.events if isinstance(event, FaultOpened)]


def test_a_fault_records_how_long_its_unit_was_ok_in_this_life() -> None:
    """The total, with or without interruptions; time before the start of the container does not count."""
    bench = living()
    bench.later(30)
    bench.see("container", ran_in_life(2))
    bench.see("nodes", OK)
    bench.later(4)
    bench.see("nodes", stale("no picture"))
    bench.later(3)
    bench.see("nodes", OK)
    bench.later(6)
    for _ in range(4):
        bench.see("nodes", BAD)
        bench.see("container", ran_in_life(2))
        bench.later(0.2)
    assert bench.opened == ["nodes"]
    (seconds,) = ok_since_start_s(bench)
    assert 10.0 <= seconds <= 11.0


def test_a_unit_never_ok_in_this_life_has_no_ok_time() -> None:
    """The unit is broken from the start."""
    bench = living()
    bench.later(30)
    bench.see("nodes", BAD)
    all_missing(bench, 10.0, life=2)
    assert ok_since_start_s(bench) == [0.0]


@pytest.mark.parametrize("by_phm", [True, False])
def test_a_fault_records_how_long_its_unit_was_ok_before_phm_restarted_the_container(by_phm: bool) -> None:
    """Also over a second restart by PHM. After one by someone else it may be another program."""
    bench = living()
    bench.see("nodes", OK)
    bench.later(30)
    for life in (2, 3):
        if by_phm or life == 2:
            bench.take(bench.tracker.begin_action("app", "container", "restart", bench.stamp(), 60.0))
        bench.see("container", ran_in_life(life))
        bench.take(bench.tracker.end_action("app", bench.stamp(), worked=True))
        bench.later(1)
    all_missing(bench, 20.0, life=3)
    (fault,) = [event.fault for event in bench.events if isinstance(event, FaultOpened)]
    assert (fault.ok_in_run_before_s >= 30.0, fault.ok_since_start_s < 10.0) == (by_phm, True)


def test_a_fault_records_whether_its_container_was_started_before_phm() -> None:
    """If so, PHM assumes that everything in it came up long ago."""
    bench = living()
    bench.later(1)
    for _ in range(4):
        bench.see("nodes", BAD)
        bench.see("container", ran_in_life(1))
        bench.later(0.2)
    all_missing(bench, 2.0, life=1)
    (fault,) = [event.fault for event in bench.events if isinstance(event, FaultOpened)]
    assert (fault.start_seen, fault.ok_since_start_s > 0) == (False, True)


def open_ok_s(bench: Bench) -> tuple[float, bool]:
    (fault,) = bench.tracker.open_faults()
    return fault.ok_since_start_s, fault.start_seen


def test_an_open_fault_says_what_is_known_since_the_newest_start() -> None:
    """An operator restarts the container: that the unit was OK before says nothing about a restart by PHM any more. PHM's own
    restart is made because of that, and does not change it."""
    bench = living()
    all_missing(bench, 1.5, life=1)
    bench.take(bench.tracker.begin_action("app", "nodes", "restart", bench.stamp(), 60.0))
    all_published_ok(bench)
    assert open_ok_s(bench)[0] > 0.0
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=False))
    bench.see("container", ran_in_life(2))
    bench.later(1)
    all_published_ok(bench)
    assert open_ok_s(bench) == (0.0, True)
