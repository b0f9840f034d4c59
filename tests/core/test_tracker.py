"""The tracker's rules: one cause, one alarm."""

from __future__ import annotations

from dataclasses import dataclass, field

from phm.api import Layer, Level, Result, Slot, Unit, error, ok, stale, warn
from phm.model import Event, FaultClosed, FaultOpened, Outcome, Stamp, Transition
from phm.tracker import Step, Tracked, Tracker

OK = ok("well")
BAD = error("broken", brief="broken", condition="broken")


@dataclass
class Bench:
    """A tracker with a hand-driven clock that collects events."""

    tracked: list[Tracked]
    now: float = 100.0
    events: list[Event] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.tracker = Tracker(self.tracked, self.stamp())

    def stamp(self) -> Stamp:
        return Stamp(1e9 + self.now, self.now)

    def take(self, step: Step) -> set[str]:
        self.events += step.events
        return step.rerun

    def see(self, unit: str, result: Result, *, started: float | None = None) -> set[str]:
        return self.take(self.tracker.observe(unit, result, self.now if started is None else started, self.stamp()))

    def all_well(self) -> None:
        for entry in self.tracked:
            self.see(entry.unit.id, OK)
        self.events.clear()

    def later(self, seconds: float) -> set[str]:
        self.now += seconds
        return self.take(self.tracker.tick(self.stamp()))

    def level(self, unit: str) -> Level:
        return self.tracker.state(unit).level

    def blocked_by(self, unit: str) -> str:
        return self.tracker.state(unit).blocked_by

    @property
    def opened(self) -> list[str]:
        return [event.fault.unit for event in self.events if isinstance(event, FaultOpened)]

    @property
    def closed(self) -> list[tuple[str, Outcome, str]]:
        faults = [event.fault for event in self.events if isinstance(event, FaultClosed)]
        return [(fault.unit, fault.outcome, fault.by) for fault in faults]


def unit(name: str, *needs: str, failures: int = 1, **more: float | str) -> Tracked:
    return Tracked(Unit(name, needs, **more), name, Slot.CONTAINER, Layer.DOCKER, failures, needs)  # type: ignore[arg-type]


def chain(**more: float | str) -> Bench:
    return Bench([unit("container"), unit("nodes", "container", **more), unit("topics", "nodes", **more)])


def test_before_any_result_everything_is_stale() -> None:
    """Silence is never OK."""
    assert chain().level("nodes") is Level.STALE


def test_an_error_without_needs_is_told_at_once() -> None:
    """Nothing upstream can explain it, so waiting gains nothing."""
    bench = chain()
    bench.all_well()
    bench.see("container", BAD)
    assert bench.opened == ["container"]
    assert bench.level("container") is Level.ERROR


def test_needs_are_run_again_before_an_error_is_told() -> None:
    """An ERROR below waits until everything above it has answered since."""
    bench = chain()
    bench.all_well()
    bench.now += 1
    assert bench.see("topics", BAD) == {"container", "nodes"}
    assert bench.opened == []
    bench.now += 0.1
    bench.see("container", OK)
    assert bench.opened == []
    bench.see("nodes", OK)
    assert bench.opened == ["topics"]


def test_the_root_alone_is_told_whatever_the_order() -> None:
    """Consequences seen before their cause raise nothing."""
    bench = chain()
    bench.all_well()
    bench.now += 1
    bench.see("topics", BAD)
    bench.see("nodes", BAD)
    bench.see("container", BAD)
    bench.later(10)
    assert bench.opened == ["container"]
    assert bench.blocked_by("nodes") == bench.blocked_by("topics") == "container"
    assert bench.level("topics") is Level.STALE


def test_a_result_of_an_older_run_is_ignored() -> None:
    """An overdue run that comes back late knows less than the one that followed it."""
    bench = chain()
    bench.all_well()
    bench.see("container", BAD, started=bench.now - 5)
    assert bench.opened == []


def test_an_answer_from_before_the_question_does_not_count() -> None:
    """A need's result that began before the dependent failed proves nothing about now."""
    bench = chain()
    bench.all_well()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK, started=bench.now - 0.5)
    assert bench.opened == []


def test_an_open_fault_is_reattributed_when_its_cause_appears_later() -> None:
    """Evidence of the cause that comes late still ends in one open fault, at the cause."""
    bench = chain()
    bench.all_well()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.opened == ["nodes"]
    bench.now += 1
    bench.see("container", BAD)
    assert bench.closed == [("nodes", Outcome.REATTRIBUTED, "container")]
    assert [fault.unit for fault in bench.tracker.open_faults()] == ["container"]


def test_settling_keeps_early_evidence_back() -> None:
    """A topic is silent before its node is known to be dead: settle_s bridges the gap."""
    bench = chain(settle_s=2.0)
    bench.all_well()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    bench.later(1.9)
    assert bench.opened == []
    bench.later(0.2)
    bench.see("nodes", BAD)
    bench.see("container", OK)
    assert bench.opened == ["nodes"]


def test_when_settled_all_are_asked_once_more() -> None:
    """A cause that came to light during settling is found even if its event was lost: nobody is told unasked."""
    bench = chain(settle_s=0.3)
    bench.all_well()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.now += 0.1
    bench.see("container", OK)
    assert bench.later(0.3) == {"nodes", "container"}
    bench.see("container", BAD)
    bench.see("nodes", BAD)
    assert bench.opened == ["container"]


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


def test_settling_starts_anew_after_a_good_result() -> None:
    """A flicker shorter than settle_s is never told."""
    bench = chain(settle_s=2.0)
    bench.all_well()
    for _ in range(5):
        bench.now += 1
        bench.see("nodes", BAD)
        bench.see("container", OK)
        bench.later(1)
        bench.see("nodes", OK)
    assert bench.opened == []


def test_settling_starts_anew_when_it_is_no_worse_than_what_is_told() -> None:
    """A unit that is told as WARN and was ERROR for a moment only is not told as ERROR at its next moment."""
    bench = chain(settle_s=2.0)
    bench.all_well()
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


def test_while_waiting_the_question_is_asked_again() -> None:
    """A need without a period of its own would otherwise answer only at the next pass."""
    bench = chain(settle_s=5.0)
    bench.all_well()
    bench.now += 1
    bench.see("nodes", BAD)
    assert bench.later(1.0) == {"nodes", "container"}


def test_failures_in_a_row_are_counted() -> None:
    """`failures` bad runs it takes; one good run in between starts the count again."""
    bench = Bench([unit("ping", failures=3)])
    bench.all_well()
    for result in (BAD, BAD, OK, BAD, BAD):
        bench.now += 1
        bench.see("ping", result)
    assert bench.opened == []
    bench.see("ping", BAD)
    assert bench.opened == ["ping"]


def test_grace_after_start() -> None:
    """A graph that is still filling is not known yet, and not a fault."""
    bench = Bench([unit("nodes", grace_s=5.0)])
    bench.see("nodes", BAD)
    assert bench.level("nodes") is Level.STALE
    bench.later(4.9)
    assert bench.opened == []
    bench.later(0.2)
    assert bench.opened == ["nodes"]


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


def test_stale_neither_opens_nor_closes() -> None:
    """Not knowing is no fault and no cure."""
    bench = chain()
    bench.all_well()
    bench.see("container", stale("engine silent"))
    assert bench.opened == []
    bench.see("container", BAD)
    bench.see("container", stale("engine silent"))
    assert bench.closed == []
    assert len(bench.tracker.open_faults()) == 1
    bench.see("container", OK)
    assert bench.closed == [("container", Outcome.RESOLVED, "itself")]


def test_a_warning_blocks_nobody_and_opens_no_fault() -> None:
    """WARN is told as a transition; only ERROR can be a cause."""
    bench = chain()
    bench.all_well()
    bench.see("container", warn("nearly", brief="nearly"))
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", warn("nearly", brief="nearly"))
    assert bench.opened == ["nodes"]


def test_an_unchanged_error_is_told_once() -> None:
    """Transitions, not samples, cause things to happen."""
    bench = Bench([unit("disk")])
    for _ in range(5):
        bench.now += 1
        bench.see("disk", BAD)
    assert sum(isinstance(event, Transition) for event in bench.events) == 1


def test_other_words_for_the_same_level_are_told() -> None:
    """Exited, then removed: the same ERROR stands for something else, and recovery must know."""
    bench = Bench([unit("container")])
    bench.see("container", BAD)
    bench.see("container", error("gone", brief="gone", condition="missing"))
    last = bench.events[-1]
    assert isinstance(last, Transition) and last.changed_text
    assert bench.opened == ["container"]
    assert bench.tracker.open_faults()[0].result.condition == "missing"


def holding() -> Bench:
    """A node is dead and its container is about to be restarted."""
    bench = Bench(
        [
            unit("container", target="app"),
            unit("nodes", "container", target="app", grace_s=5.0),
            unit("topics", "nodes", target="app", grace_s=5.0),
        ]
    )
    bench.later(10)
    bench.all_well()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    bench.take(bench.tracker.hold("app", "nodes", "restart", bench.stamp(), 60.0))
    bench.now += 1
    return bench


def test_what_breaks_because_of_the_repair_is_no_fault() -> None:
    """Restarting the container stops it for a moment: the fault under repair is the cause."""
    bench = holding()
    bench.see("container", BAD)
    bench.see("topics", BAD)
    bench.later(3)
    assert bench.opened == ["nodes"]
    assert bench.blocked_by("container") == "nodes"
    assert bench.blocked_by("topics") == "nodes"


def test_a_verified_repair_is_credited_to_the_action() -> None:
    """The fault that the action healed is resolved by it, and nothing else is told."""
    bench = holding()
    bench.see("container", BAD)
    bench.now += 1
    bench.see("container", OK)
    bench.see("nodes", OK)
    bench.take(bench.tracker.release("app", bench.stamp(), worked=True))
    bench.now += 1
    bench.see("topics", BAD)
    bench.later(2)
    bench.see("topics", OK)
    assert bench.closed == [("nodes", Outcome.RESOLVED, "restart")]
    assert bench.opened == ["nodes"]


def test_a_repair_that_did_not_help_gets_no_credit() -> None:
    """What comes back later has healed by itself."""
    bench = holding()
    bench.take(bench.tracker.release("app", bench.stamp(), worked=False))
    bench.later(60)
    bench.see("nodes", OK)
    assert bench.closed == [("nodes", Outcome.RESOLVED, "itself")]


def test_a_hold_ends_even_if_its_owner_has_died() -> None:
    """An executor that vanished must not mute the target for ever."""
    bench = holding()
    bench.later(61)
    bench.see("container", BAD)
    assert [fault.unit for fault in bench.tracker.open_faults()] == ["container"]


def test_a_fault_says_for_how_long_its_unit_was_well() -> None:
    """Without a break, and nothing when it was not known to be well just before."""
    bench = Bench([unit("container")])
    bench.see("container", BAD)
    bench.see("container", OK)
    bench.now += 40
    bench.see("container", OK)
    bench.see("container", BAD)
    bench.see("container", OK)
    bench.see("container", stale("not known"))
    bench.see("container", BAD)
    opened = [event.fault.well_s for event in bench.events if isinstance(event, FaultOpened)]
    assert opened == [0.0, 40.0, 0.0]


def test_an_escalated_fault_is_closed_once_and_not_opened_again() -> None:
    """Giving up is said aloud, once; the unit stays ERROR until it is well."""
    bench = Bench([unit("container")])
    bench.see("container", BAD)
    fault = bench.tracker.open_faults()[0]
    bench.take(bench.tracker.escalate(fault.id, bench.stamp()))
    bench.now += 1
    bench.see("container", BAD)
    assert bench.closed == [("container", Outcome.ESCALATED, "")]
    assert bench.level("container") is Level.ERROR
    bench.see("container", OK)
    bench.see("container", BAD)
    assert bench.opened == ["container", "container"]


def test_independent_faults_are_each_told() -> None:
    """Two causes, two alarms."""
    bench = Bench([unit("a"), unit("b"), unit("c", "a")])
    bench.all_well()
    bench.see("a", BAD)
    bench.see("b", BAD)
    bench.see("c", BAD)
    assert bench.opened == ["a", "b"]


def test_a_fault_lists_what_it_blocks() -> None:
    """The cause names its consequences."""
    bench = chain()
    bench.all_well()
    bench.now += 1
    bench.see("container", BAD)
    bench.see("nodes", BAD)
    bench.see("topics", BAD)
    assert bench.tracker.open_faults()[0].blocks == ("nodes", "topics")


def test_a_fault_names_its_consequences_when_it_opens() -> None:
    """Which checks cannot be well follows from the graph, in slot order, before any of them has been seen bad."""
    rates = Tracked(Unit("rates/t"), "rates", Slot.RATES, Layer.ROS, needs=("topics/t",))
    topics = Tracked(Unit("topics/t"), "topics", Slot.TOPICS, Layer.ROS, needs=("nodes/a", "nodes/b"))
    nodes = [Tracked(Unit(f"nodes/{n}"), "nodes", Slot.NODES, Layer.ROS, needs=("container",)) for n in "ab"]
    bench = Bench([rates, topics, *nodes, unit("container"), unit("files")])
    bench.see("container", BAD)
    [event] = [event for event in bench.events if isinstance(event, FaultOpened)]
    assert event.fault.consequences == ("nodes", "topics", "rates")
    assert event.fault.blocks == ()


def test_events_come_in_the_order_in_which_they_are_told() -> None:
    """An alarm opens before its transition; an end follows its own, and precedes that of who is reattributed."""
    bench = chain()
    bench.all_well()
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


def test_a_suspect_is_named_and_blocks_nobody() -> None:
    """A full disk can be behind a dead node but need not be: the fault is told, with the disk as a hint."""
    disk = Tracked(Unit("host/disk", suspect=True), "host", Slot.HOST, Layer.COMPANION)
    bench = Bench([disk, unit("nodes")])
    bench.all_well()
    bench.see("host/disk", warn("nearly full", brief="disk 90%"))
    bench.see("nodes", BAD)
    bench.see("nodes", OK)
    bench.see("host/disk", BAD)
    bench.see("nodes", BAD)
    assert bench.opened == ["nodes", "host/disk", "nodes"]
    opened = [event.fault for event in bench.events if isinstance(event, FaultOpened)]
    assert [fault.suspects for fault in opened] == [(), (), ("host/disk",)]


def test_what_goes_before_its_stopped_container_is_no_fault() -> None:
    """`docker stop`: nodes say goodbye before the container has exited, and the container alone is told."""
    bench = Bench([unit("container", target="app"), unit("nodes", "container", target="app", settle_s=0.3)])
    bench.all_well()
    bench.take(bench.tracker.expect_end("app", bench.stamp(), 11.0))
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
    bench.take(bench.tracker.expect_end("app", bench.stamp(), 11.0))
    bench.see("nodes", BAD)
    for _ in range(12):
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", BAD)
    assert bench.opened == ["nodes"]


def test_a_need_that_is_not_known_gets_time_to_be_known() -> None:
    """A topic is silent while the graph is still being learned: its dead node is told, not the topic."""
    bench = chain()
    bench.all_well()
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


def test_a_need_that_stays_unknown_does_not_hide_a_fault_for_ever() -> None:
    """A check that never comes to a verdict costs ten seconds, not the alarm."""
    bench = chain()
    bench.all_well()
    bench.now += 1
    bench.see("nodes", stale("the graph is young"))
    bench.see("topics", BAD)
    for _ in range(11):
        bench.later(1.0)
        bench.see("container", OK)
        bench.see("nodes", stale("the graph is young"))
    assert bench.opened == ["topics"]


def repairing() -> Bench:
    """The container's network was lost; a repair that must be proven is under way."""
    bench = Bench([unit("network", target="app"), unit("nodes", "network", target="app", grace_s=8.0)])
    bench.later(10)
    bench.all_well()
    bench.now += 1
    bench.see("network", BAD)
    bench.take(bench.tracker.hold("app", "network", "reconnect", bench.stamp(), 60.0, proving=True))
    bench.now += 1
    return bench


def test_a_repair_is_not_believed_before_it_is_proven() -> None:
    """The network is back, its nodes are not: the fault stays open until the repair is said to have worked."""
    bench = repairing()
    done = bench.now
    bench.see("network", OK)
    bench.see("nodes", BAD)
    bench.later(1.0)
    assert bench.closed == []
    assert bench.tracker.found_well("network", done)
    assert bench.tracker.suffering("network", done) == ("nodes",)
    bench.see("nodes", OK)
    assert bench.tracker.suffering("network", done) == ()
    bench.take(bench.tracker.release("app", bench.stamp(), worked=True))
    assert bench.closed == [("network", Outcome.RESOLVED, "reconnect")]
    assert bench.opened == ["network"]


def test_a_repair_that_did_not_bring_all_back_leaves_the_fault_to_the_next_action() -> None:
    """One cause, one fault: the restart that follows the reconnection heals the same fault."""
    bench = repairing()
    bench.see("network", OK)
    bench.see("nodes", BAD)
    bench.take(bench.tracker.release("app", bench.stamp(), worked=False))
    bench.later(1.0)
    assert bench.closed == []
    bench.take(bench.tracker.hold("app", "network", "restart", bench.stamp(), 60.0, proving=True))
    bench.see("network", OK)
    bench.see("nodes", OK)
    bench.take(bench.tracker.release("app", bench.stamp(), worked=True))
    assert bench.closed == [("network", Outcome.RESOLVED, "restart")]
    assert bench.opened == ["network"]


def test_an_unproven_repair_is_believed_in_the_end() -> None:
    """When nothing more is done, a unit that is well does not stay ERROR for ever."""
    bench = repairing()
    bench.see("network", OK)
    bench.take(bench.tracker.release("app", bench.stamp(), worked=False))
    for _ in range(31):
        bench.later(1.0)
        bench.see("network", OK)
    assert [outcome for _, outcome, _ in bench.closed] == [Outcome.RESOLVED]
