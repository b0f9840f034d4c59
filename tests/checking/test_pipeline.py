"""The pipeline: passes, wake-ups, and queries of reporters and recovery."""

from __future__ import annotations

from collections.abc import Iterable

from phm import testing
from phm.api import Layer, Level, Slot, Unit, error, ok, stale
from phm.checking.pipeline import Pipeline
from phm.core.bus import Bus
from phm.core.model import Event, Report, ReportStarted, Result
from phm.tracker import TrackedUnit, Tracker, graph_of

BAD = error("broken", brief="broken", condition="broken")


class Rig:
    """A pipeline of two units on a fake clock; collects events and wake-ups."""

    def __init__(self, target: str = "") -> None:
        self.clock = testing.FakeClock()
        self.events: list[Event] = []
        self.wakes: list[tuple[frozenset[str], str]] = []
        tracked = [
            TrackedUnit(Unit("container", target=target), "container", Slot.CONTAINER, Layer.DOCKER),
            TrackedUnit(Unit("nodes", ("container",)), "nodes", Slot.NODES, Layer.ROS, 1, ("container",)),
        ]
        bus = Bus(self.clock)
        bus.publish = self.events.append  # type: ignore[method-assign]
        self.pipeline = Pipeline(
            Tracker(tracked, graph_of(tracked), self.clock.stamp()), bus, self.clock, pass_limit_s=15.0
        )
        self.pipeline.attach(self.wake)

    def wake(self, units: Iterable[str], reason: str) -> None:
        self.wakes.append((frozenset(units), reason))

    def reports(self) -> list[Report]:
        return [event for event in self.events if isinstance(event, Report)]


def test_a_pass_is_complete_when_every_unit_ran_since_its_start() -> None:
    """A result from before the pass does not count."""
    rig = Rig()
    before = rig.clock.mono()
    rig.clock.advance(1)
    rig.pipeline.begin_pass()
    assert isinstance(rig.events[0], ReportStarted)
    assert rig.wakes == [(frozenset({"container", "nodes"}), "pass")]
    rig.pipeline.observe({"container": ok("fine")}, rig.clock.mono(), 0.0)
    rig.pipeline.observe({"nodes": ok("fine")}, before, 0.0)
    assert rig.reports() == []
    rig.pipeline.observe({"nodes": ok("fine")}, rig.clock.mono(), 0.0)
    assert [state.level for state in rig.reports()[0].units] == [Level.OK, Level.OK]


def test_a_pass_ends_even_if_a_check_hangs() -> None:
    """A hung check costs its own line, not the report."""
    rig = Rig()
    rig.pipeline.begin_pass()
    rig.pipeline.observe({"container": ok("fine")}, rig.clock.mono(), 0.0)
    rig.clock.advance(15)
    rig.pipeline.tick()
    assert [state.level for state in rig.reports()[0].units] == [Level.OK, Level.STALE]


def test_an_overdue_check_counts_for_the_pass_but_not_as_a_sign_of_life() -> None:
    """The report of a hung check must not keep the heartbeat alive."""
    rig = Rig()
    alive = rig.pipeline.last_result_at
    rig.pipeline.begin_pass()
    rig.clock.advance(5)
    rig.pipeline.observe({"container": stale("hung"), "nodes": stale("hung")}, rig.clock.mono(), 0.0, overdue=True)
    assert len(rig.reports()) == 1
    assert rig.pipeline.last_result_at == alive


def test_a_permanently_hung_check_does_not_end_the_periodic_report() -> None:
    """Each later pass is published as soon as the other checks are done, with the hung unit named in it."""
    rig = Rig()
    rig.pipeline.begin_pass()
    rig.pipeline.observe({"container": ok("running")}, rig.clock.mono(), 0.0)
    rig.clock.advance(5)
    rig.pipeline.observe({"nodes": stale("hung")}, rig.clock.mono(), 5.0, overdue=True)
    for number in (2, 3, 4):
        rig.clock.advance(10)  # an interval shorter than the limit of a pass
        rig.pipeline.begin_pass()
        rig.clock.advance(1)
        rig.pipeline.observe({"container": ok("running")}, rig.clock.mono(), 0.0)
        assert [report.number for report in rig.reports()] == list(range(1, number + 1))
        assert rig.reports()[-1].missing == ("nodes",)
    came_back = rig.clock.mono()
    rig.pipeline.observe({"nodes": ok("back")}, came_back - 35, 35.0)
    rig.clock.advance(10)
    rig.pipeline.begin_pass()
    rig.pipeline.observe({"container": ok("running")}, rig.clock.mono(), 0.0)
    assert len(rig.reports()) == 4, "it has returned, so the pass waits for it again"
    rig.pipeline.observe({"nodes": ok("running")}, rig.clock.mono(), 0.0)
    assert rig.reports()[-1].missing == ()


def test_an_unfinished_pass_is_published_before_the_next_one_starts() -> None:
    """With an interval shorter than the slowest check, known results are reported and the rest is named."""
    rig = Rig()
    rig.pipeline.begin_pass()
    rig.pipeline.observe({"container": ok("running")}, rig.clock.mono(), 0.0)
    rig.clock.advance(2)
    rig.pipeline.begin_pass()
    assert [(report.number, report.missing) for report in rig.reports()] == [(1, ("nodes",))]
    kinds = [type(event) for event in rig.events if isinstance(event, (Report, ReportStarted))]
    assert kinds == [ReportStarted, Report, ReportStarted]


def test_a_query_of_the_tracker_wakes_the_checks() -> None:
    """A dependent unit triggers the check of the engine."""
    rig = Rig()
    rig.pipeline.observe({"container": ok("fine"), "nodes": ok("fine")}, rig.clock.mono(), 0.0)
    rig.clock.advance(1)
    rig.pipeline.observe({"nodes": BAD}, rig.clock.mono(), 0.0)
    assert rig.wakes == [(frozenset({"container"}), "confirm")]


def test_a_container_start_triggers_all_dependent_checks() -> None:
    """A unit that was bad in the old generation is checked again, and does not count before that."""
    rig = Rig(target="app")
    rig.pipeline.observe({"container": ok("fine"), "nodes": ok("fine")}, rig.clock.mono(), 0.0)
    rig.clock.advance(1)
    rig.pipeline.observe({"nodes": BAD}, rig.clock.mono(), 0.0)
    rig.clock.advance(1)
    rig.pipeline.container_started("app")
    rig.pipeline.observe({"container": ok("fine")}, rig.clock.mono(), 0.0)
    assert rig.wakes[-1] == (frozenset({"nodes"}), "confirm")
    assert rig.pipeline.open_faults() == ()


def test_verification_counts_only_runs_that_started_after_the_action() -> None:
    """An OK that was in progress when the action ended proves nothing."""
    rig = Rig()
    rig.pipeline.observe({"container": ok("fine")}, rig.clock.mono(), 0.0)
    done = rig.clock.mono() + 1
    assert not rig.pipeline.found_ok("container", done)
    rig.clock.advance(2)
    rig.pipeline.observe({"container": ok("fine")}, rig.clock.mono(), 0.0)
    assert rig.pipeline.found_ok("container", done)


def test_closed_faults_are_kept_up_to_a_limit() -> None:
    """`phm status` shows the recent ones; memory does not grow with the number of faults."""
    rig = Rig()
    for _ in range(50):
        rig.clock.advance(1)
        rig.pipeline.observe({"container": BAD}, rig.clock.mono(), 0.0)
        rig.clock.advance(1)
        rig.pipeline.observe({"container": ok("fine")}, rig.clock.mono(), 0.0)
    recent = rig.pipeline.recent_faults()
    assert len(recent) == 20
    assert recent[-1].id == "F50"


def test_the_main_loop_ticks_only_while_time_may_change_a_state() -> None:
    """OK or already published: no ticks. A result, an action or a held unit that changes that triggers it immediately."""
    rig = Rig(target="app")
    stirred: list[float] = []
    rig.pipeline.attach(rig.wake, lambda: stirred.append(rig.clock.mono()))

    def observe(unit: str, result: Result) -> bool:
        """Whether the main loop was woken; then tick until nothing is pending."""
        before = len(stirred)
        rig.clock.advance(0.5)
        rig.pipeline.observe({unit: result}, rig.clock.mono(), 0.0)
        called = len(stirred) > before
        for _ in range(40):
            rig.clock.advance(0.5)
            rig.pipeline.observe({"container": ok("fine"), unit: result}, rig.clock.mono(), 0.0)
            rig.pipeline.tick()
        assert not rig.pipeline.waiting
        return called

    for unit in ("container", "nodes"):
        observe(unit, ok("fine"))
    assert not observe("nodes", ok("fine"))
    assert observe("nodes", BAD), "it waits for the check of its dependency"
    assert not observe("nodes", BAD), "already published"
    assert observe("nodes", ok("fine"))
    rig.pipeline.begin_action("app", "container", "restart", 30.0)
    rig.pipeline.tick()
    assert rig.pipeline.waiting, "an action that does not end has a time limit"
    rig.clock.advance(31)
    rig.pipeline.tick()
    rig.pipeline.tick()
    assert not rig.pipeline.waiting
