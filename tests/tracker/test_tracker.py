"""The tracker's rules: one cause, one alarm."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm.api import Evidence, Layer, Level, Slot, Unit, error, stale, warn
from phm.core.model import FaultClosed, FaultOpened, Outcome, Transition
from phm.tracker import TrackedUnit
from tests.fakes.tracker_bench import BAD, OK, Bench, chain, unit


def test_before_any_result_everything_is_stale() -> None:
    """Without a result a unit is never OK."""
    assert chain().level("nodes") is Level.STALE


def test_an_error_without_dependencies_is_published_immediately() -> None:
    """No upstream unit can explain it, so there is nothing to wait for."""
    bench = chain()
    bench.all_healthy()
    bench.see("container", BAD)
    assert bench.opened == ["container"]
    assert bench.level("container") is Level.ERROR


def test_dependencies_run_again_before_an_error_is_published() -> None:
    """A dependent's ERROR waits until all its upstream units have answered since."""
    bench = chain()
    bench.all_healthy()
    bench.now += 1
    assert bench.see("topics", BAD) == {"container", "nodes"}
    assert bench.opened == []
    bench.now += 0.1
    bench.see("container", OK)
    assert bench.opened == []
    bench.see("nodes", OK)
    assert bench.opened == ["topics"]


def test_a_fault_says_how_long_its_confirmation_took() -> None:
    """From the start of the first of its ERROR results in a row; after any other result it counts again from 0."""
    bench = chain()
    bench.all_healthy()
    for seconds, result in ((1.0, BAD), (1.0, OK), (1.0, BAD), (0.25, BAD)):
        bench.now += seconds
        bench.see("topics", result)
    bench.now += 0.25
    bench.see("container", OK)
    bench.see("nodes", OK)
    (fault,) = bench.tracker.open_faults()
    assert fault.confirmed_s == pytest.approx(0.5)


def test_a_result_with_another_target_confirms_no_action_on_the_first() -> None:
    """The same condition and text, and nothing to act on: the fault follows the newest result."""
    bench = chain()
    bench.all_healthy()
    bench.see("container", replace(BAD, target="app"))
    bench.now += 1
    bench.see("container", replace(BAD, target=""))
    (fault,) = bench.tracker.open_faults()
    assert fault.result.target == ""


def test_only_the_root_cause_is_published_in_any_order() -> None:
    """Consequences seen before their cause raise no alarm."""
    bench = chain()
    bench.all_healthy()
    bench.now += 1
    bench.see("topics", BAD)
    bench.see("nodes", BAD)
    bench.see("container", BAD)
    bench.later(10)
    assert bench.opened == ["container"]
    assert bench.blocked_by("nodes") == bench.blocked_by("topics") == "container"
    assert bench.level("topics") is Level.STALE


def test_a_result_of_an_older_run_is_ignored() -> None:
    """An overdue run that returns late is outdated by the run that followed it."""
    bench = chain()
    bench.all_healthy()
    bench.see("container", BAD, started=bench.now - 5)
    assert bench.opened == []


def test_a_dependencys_result_from_before_the_failure_does_not_count() -> None:
    """A dependency's run that began before the dependent failed says nothing about its present state."""
    bench = chain()
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK, started=bench.now - 0.5)
    assert bench.opened == []


def test_an_open_fault_is_reattributed_when_its_cause_appears_later() -> None:
    """Late evidence of the cause still results in one open fault, at the cause."""
    bench = chain()
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.opened == ["nodes"]
    bench.now += 1
    bench.see("container", BAD)
    assert bench.closed == [("nodes", Outcome.REATTRIBUTED, "container")]
    assert [fault.unit for fault in bench.tracker.open_faults()] == ["container"]


@pytest.mark.parametrize("confirmed", [False, True], ids=["a single failed run", "confirmed"])
def test_an_unconfirmed_cause_closes_no_fault(confirmed: bool) -> None:
    """The engine may not answer once, which is not a fault. Its dependents would have none then, and new ones later."""
    bench = Bench([unit("engine", failures=2), unit("container", "engine"), unit("nodes", "container")])
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    bench.see("engine", OK)
    assert bench.opened == ["nodes"]
    bench.now += 1
    bench.see("engine", BAD)
    bench.see("nodes", BAD)
    bench.now += 1
    bench.see("engine", BAD if confirmed else OK)
    bench.see("nodes", BAD)
    assert bench.closed == ([("nodes", Outcome.REATTRIBUTED, "engine")] if confirmed else [])
    assert bench.opened == ["nodes", *(["engine"] if confirmed else [])]


def test_an_error_is_not_published_before_settle_s() -> None:
    """A topic is silent before its node is known to be dead: settle_s covers the difference."""
    bench = chain(settle_s=2.0)
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    bench.later(1.9)
    assert bench.opened == []
    bench.later(0.2)
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.opened == ["nodes"]


def test_a_result_may_settle_earlier_than_its_unit() -> None:
    """With evidence against an upstream cause, it is published once all upstream units have run again."""
    bench = chain(settle_s=2.0)
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    bench.later(0.1)
    assert bench.opened == []
    bench.see("nodes", replace(BAD, settle_s=0.0))
    assert bench.opened == ["nodes"]


def test_a_result_that_settles_immediately_still_runs_its_dependencies() -> None:
    """Only the cause is published, even when its event was lost."""
    bench = chain(settle_s=2.0)
    bench.all_healthy()
    bench.now += 1
    assert bench.see("nodes", replace(BAD, settle_s=0.0)) == {"container"}
    assert bench.opened == []
    bench.see("container", BAD)
    assert bench.opened == ["container"]


def test_a_result_may_settle_later_than_its_unit() -> None:
    """For a failure that is known to clear spontaneously."""
    bench = chain(settle_s=0.3)
    bench.all_healthy()
    slow = replace(BAD, settle_s=3.0)
    for _ in range(3):
        bench.later(0.9)
        bench.see("container", OK)
        bench.see("nodes", slow)
    assert bench.opened == []
    bench.later(1.3)
    bench.see("container", OK)
    bench.see("nodes", slow)
    assert bench.opened == ["nodes"]


def test_a_settling_unit_is_checked_often() -> None:
    """Evidence that ends the wait early must not wait for the check's period; dependencies are queried once a second."""
    bench = chain(settle_s=2.0)
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.later(0.1) == set()
    assert bench.later(0.1) == {"nodes"}


def test_upstream_units_run_once_more_after_settling() -> None:
    """A cause that appeared during settling is found even if its event was lost: no unit is published without a new
    run.
    """
    bench = chain(settle_s=0.3)
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.now += 0.1
    bench.see("container", OK)
    assert bench.later(0.3) == {"nodes", "container"}
    bench.see("container", BAD)
    bench.see("nodes", BAD)
    assert bench.opened == ["container"]


def test_settling_restarts_after_a_good_result() -> None:
    """A flicker shorter than settle_s is never published."""
    bench = chain(settle_s=2.0)
    bench.all_healthy()
    for _ in range(5):
        bench.now += 1
        bench.see("nodes", BAD)
        bench.see("container", OK)
        bench.later(1)
        bench.see("nodes", OK)
    assert bench.opened == []


def test_settling_restarts_when_the_level_returns_to_the_published_one() -> None:
    """A unit published as WARN that was ERROR only briefly is not published as ERROR at its next brief ERROR."""
    bench = chain(settle_s=2.0)
    bench.all_healthy()
    nearly = warn("nearly", brief="nearly")
    for result in (nearly, nearly, BAD, nearly):
        bench.later(3.0)
        bench.see("nodes", result)
        bench.see("container", OK)
    bench.later(3.0)
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.level("nodes") is Level.WARN
    assert bench.opened == []


def test_dependencies_are_queried_repeatedly_while_waiting() -> None:
    """A dependency without a period would otherwise answer only at the next pass."""
    bench = chain(settle_s=5.0)
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    assert bench.later(1.0) == {"nodes", "container"}


def test_failures_in_a_row_are_counted() -> None:
    """`failures` consecutive bad runs are required; one good run restarts the count."""
    bench = Bench([unit("ping", failures=3)])
    bench.all_healthy()
    for result in (BAD, BAD, OK, BAD, BAD):
        bench.now += 1
        bench.see("ping", result)
    assert bench.opened == []
    bench.see("ping", BAD)
    assert bench.opened == ["ping"]


def test_stale_neither_opens_nor_closes() -> None:
    """An unknown result neither opens nor resolves a fault."""
    bench = chain()
    bench.all_healthy()
    bench.see("container", stale("engine silent"))
    assert bench.opened == []
    bench.see("container", BAD)
    bench.see("container", stale("engine silent"))
    assert bench.closed == []
    assert len(bench.tracker.open_faults()) == 1
    bench.see("container", OK)
    assert bench.closed == [("container", Outcome.RESOLVED, "itself")]


def test_a_fault_states_the_longest_earlier_pause_of_its_unit() -> None:
    """Only what ended without an action counts: an action ends a fault before the pause would have."""
    bench = chain()
    bench.all_healthy()
    for seconds in (3.0, 1.0):
        bench.see("container", BAD)
        bench.later(seconds)
        bench.see("container", OK)
        bench.later(1)
    bench.see("container", BAD)
    bench.take(bench.tracker.begin_action("", "container", "restart", bench.stamp(), 60.0))
    bench.later(20)
    bench.see("container", OK)
    bench.take(bench.tracker.end_action("", bench.stamp(), worked=True))
    bench.later(60)
    bench.see("container", BAD)
    pauses = [event.fault.pause_s for event in bench.events if isinstance(event, FaultOpened)]
    assert pauses == pytest.approx([0.0, 3.0, 3.0, 3.0])


@pytest.mark.parametrize("announced", [True, False])
def test_a_failure_ended_by_a_restart_of_others_is_not_a_pause(announced: bool) -> None:
    """An operator, or the engine's restart policy: the unit did not return by itself. Known by the event or by a result."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app")])

    def fail(generation: str) -> None:
        bench.later(5)
        bench.see("nodes", BAD)
        bench.see("container", OK.with_evidence(Evidence(generation=generation)))
        bench.later(1)

    bench.all_healthy()
    fail("1")
    bench.later(40)
    if announced:
        bench.take(bench.tracker.container_started("app", bench.stamp()))
    bench.see("container", OK.with_evidence(Evidence(generation="2")))
    bench.later(5)
    bench.see("nodes", OK)
    fail("2")
    bench.see("nodes", OK)
    fail("2")
    faults = [event.fault for event in bench.events if isinstance(event, FaultOpened)]
    assert [fault.pause_s for fault in faults] == pytest.approx([0.0, 0.0, 1.0])


def test_a_warning_blocks_no_unit_and_opens_no_fault() -> None:
    """WARN is published as a transition; only ERROR can be a cause."""
    bench = chain()
    bench.all_healthy()
    bench.see("container", warn("nearly", brief="nearly"))
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", warn("nearly", brief="nearly"))
    assert bench.opened == ["nodes"]


def test_an_unchanged_error_is_published_once() -> None:
    """Transitions trigger actions, samples do not."""
    bench = Bench([unit("disk")])
    for _ in range(5):
        bench.now += 1
        bench.see("disk", BAD)
    assert sum(isinstance(event, Transition) for event in bench.events) == 1


def test_a_changed_summary_at_the_same_level_is_published() -> None:
    """Exited, then removed: the same ERROR has another meaning, which recovery needs."""
    bench = Bench([unit("container")])
    bench.see("container", BAD)
    bench.see("container", error("gone", brief="gone", condition="missing"))
    last = bench.events[-1]
    assert isinstance(last, Transition) and last.changed_text
    assert bench.opened == ["container"]
    assert bench.tracker.open_faults()[0].result.condition == "missing"


def test_independent_faults_are_each_published() -> None:
    """Two causes, two alarms."""
    bench = Bench([unit("a"), unit("b"), unit("c", "a")])
    bench.all_healthy()
    bench.see("a", BAD)
    bench.see("b", BAD)
    bench.see("c", BAD)
    assert bench.opened == ["a", "b"]


def test_a_fault_lists_what_it_blocks() -> None:
    """The cause names its consequences."""
    bench = chain()
    bench.all_healthy()
    bench.now += 1
    bench.see("container", BAD)
    bench.see("nodes", BAD)
    bench.see("topics", BAD)
    assert bench.tracker.open_faults()[0].blocks == ("nodes", "topics")


def test_a_fault_names_its_consequences_when_it_opens() -> None:
    """The checks that cannot be OK follow from the graph, in slot order, before any of them has failed."""
    rates = TrackedUnit(Unit("rates/t"), "rates", Slot.RATES, Layer.ROS, needs=("topics/t",))
    topics = TrackedUnit(Unit("topics/t"), "topics", Slot.TOPICS, Layer.ROS, needs=("nodes/a", "nodes/b"))
    nodes = [TrackedUnit(Unit(f"nodes/{n}"), "nodes", Slot.NODES, Layer.ROS, needs=("container",)) for n in "ab"]
    bench = Bench([rates, topics, *nodes, unit("container"), unit("files")])
    bench.see("container", BAD)
    [event] = [event for event in bench.events if isinstance(event, FaultOpened)]
    assert event.fault.consequences == ("nodes", "topics", "rates")
    assert event.fault.blocks == ()


def test_events_are_in_publication_order() -> None:
    """An opening precedes its transition; a closing follows its transition and precedes that of a reattributed unit."""
    bench = chain()
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    bench.now += 1
    bench.see("container", BAD)
    bench.see("container", OK)
    seen = [
        (type(event).__name__, event.unit if isinstance(event, Transition) else event.fault.unit)
        for event in bench.events
        if isinstance(event, FaultOpened | FaultClosed | Transition)
    ]
    assert seen[:2] == [("FaultOpened", "nodes"), ("Transition", "nodes")]
    assert seen[2:4] == [("FaultOpened", "container"), ("Transition", "container")]
    assert seen[4:6] == [("FaultClosed", "nodes"), ("Transition", "nodes")]
    assert seen[6:8] == [("Transition", "container"), ("FaultClosed", "container")]


def test_a_suspect_is_named_and_blocks_no_unit() -> None:
    """A full disk can cause a dead node but need not: the fault is published with the disk as a hint."""
    disk = TrackedUnit(Unit("host/disk", suspect=True), "host", Slot.HOST, Layer.COMPANION)
    bench = Bench([disk, unit("nodes")])
    bench.all_healthy()
    bench.see("host/disk", warn("nearly full", brief="disk 90%"))
    bench.see("nodes", BAD)
    bench.see("nodes", OK)
    bench.see("host/disk", BAD)
    bench.see("nodes", BAD)
    assert bench.opened == ["nodes", "host/disk", "nodes"]
    opened = [event.fault for event in bench.events if isinstance(event, FaultOpened)]
    assert [fault.suspects for fault in opened] == [(), (), ("host/disk",)]


def test_an_unknown_dependency_gets_time_to_answer() -> None:
    """A topic is silent while the graph is still incomplete: its dead node is published, not the topic."""
    bench = chain()
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", stale("the graph is young"))
    bench.see("topics", BAD)
    bench.see("container", OK)
    bench.later(3.0)
    bench.see("nodes", stale("the graph is young"))
    assert bench.opened == []
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.opened == ["nodes"]
    assert bench.blocked_by("topics") == "nodes"


def test_a_result_from_before_a_dependency_became_known_does_not_count() -> None:
    """A restarted node appears before its topic: an earlier failure of the topic is checked once more."""
    bench = chain()
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", stale("it is starting"))
    bench.see("topics", BAD)
    bench.see("container", OK)
    bench.later(2.0)
    bench.see("topics", BAD)
    bench.see("container", OK)
    bench.now += 0.1
    assert bench.see("nodes", OK) == {"topics"}
    assert bench.opened == []
    bench.see("topics", BAD)
    assert bench.opened == ["topics"]


def test_an_unknown_dependency_hides_a_fault_for_a_limited_time() -> None:
    """A check that never reaches a result costs twelve seconds, not the alarm."""
    bench = chain()
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", stale("the graph is young"))
    bench.see("topics", BAD)
    for second in range(13):
        assert bench.opened == [] or second > 11
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", stale("the graph is young"))
    assert bench.opened == ["topics"]
