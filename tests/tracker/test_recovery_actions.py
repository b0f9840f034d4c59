"""Holds and verification: a failure caused by a repair is not a fault; a repair counts once it is verified."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm.api import Level, error, stale, warn
from phm.core.model import Evidence, FaultOpened, Outcome
from phm_checks.pressure import KILL_SETTLE_S
from tests.fakes.tracker_bench import BAD, OK, Bench, unit


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
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes", BAD)
    bench.see("container", OK)
    bench.take(bench.tracker.begin_action("app", "nodes", "restart", bench.stamp(), 60.0))
    bench.now += 1
    return bench


def test_a_failure_caused_by_the_repair_is_not_a_fault() -> None:
    """Restarting the container stops it for a moment: the cause is the fault under repair."""
    bench = holding()
    bench.see("container", BAD)
    bench.see("topics", BAD)
    bench.later(3)
    assert bench.opened == ["nodes"]
    assert bench.blocked_by("container") == "nodes"
    assert bench.blocked_by("topics") == "nodes"


def test_a_node_that_was_killed_for_lack_of_memory_is_one_fault() -> None:
    """The kernel's counter may be read before the list of processes. In a campaign two of four such kills raised two alarms."""
    killed = replace(BAD, condition="memory_pressure", settle_s=KILL_SETTLE_S)
    gone = error("process ended", brief="dead", condition="node_missing").with_evidence(Evidence(certain=True))
    bench = Bench(
        [unit("container", target="app"), *(unit(name, "container", target="app") for name in ("pressure", "nodes"))]
    )
    bench.later(10)
    bench.all_healthy()
    bench.see("pressure", killed)
    bench.later(0.4)
    bench.see("container", OK)
    bench.see("nodes", gone)
    bench.see("container", OK)
    assert bench.opened == ["nodes"]
    bench.take(bench.tracker.begin_action("app", "nodes", "restart", bench.stamp(), 60.0))
    for _ in range(3):
        bench.later(1)
        bench.see("pressure", killed)
        bench.see("container", OK)
    assert bench.opened == ["nodes"]
    assert bench.blocked_by("pressure") == "nodes"


def test_an_open_fault_is_not_a_consequence_of_the_repair_of_another() -> None:
    """A check without a target needs the container that is restarted for another fault: its fault stays open, and is not reported again."""
    bench = Bench(
        [unit("container", target="app"), unit("pump", "container", target="app"), unit("alone", "container")]
    )
    bench.later(10)
    bench.all_healthy()
    bench.see("alone", BAD)
    bench.see("pump", BAD)
    bench.take(bench.tracker.begin_action("app", "pump", "restart", bench.stamp(), 60.0))
    bench.now += 1
    bench.see("container", BAD)
    bench.see("alone", BAD)
    bench.later(2)
    bench.see("container", OK)
    bench.see("pump", OK)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=True))
    bench.now += 10
    bench.see("alone", BAD)
    assert bench.opened == ["alone", "pump"]
    assert [unit for unit, *_ in bench.closed] == ["pump"]


def test_a_verified_repair_is_credited_to_the_action() -> None:
    """The fault that the action repaired is resolved by it, and nothing else is published."""
    bench = holding()
    bench.see("container", BAD)
    bench.now += 1
    bench.see("container", OK)
    bench.see("nodes", OK)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=True))
    bench.now += 1
    bench.see("topics", BAD)
    bench.later(2)
    bench.see("topics", OK)
    assert bench.closed == [("nodes", Outcome.RESOLVED, "restart")]
    assert bench.opened == ["nodes"]


def test_an_ineffective_repair_gets_no_credit() -> None:
    """A later recovery is spontaneous."""
    bench = holding()
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=False))
    bench.later(60)
    bench.see("nodes", OK)
    assert bench.closed == [("nodes", Outcome.RESOLVED, "itself")]


def test_what_still_fails_after_an_action_is_not_credited_to_it() -> None:
    """Another fault of the container, which a restart cannot repair, ends an hour later: somebody plugged the device in again."""
    bench = Bench([unit("nodes", target="app"), unit("devices", target="app", grace_s=5.0)])
    bench.later(10)
    bench.all_healthy()
    bench.see("devices", BAD)
    bench.see("nodes", BAD)
    bench.take(bench.tracker.begin_action("app", "nodes", "restart", bench.stamp(), 60.0))
    bench.later(2)
    bench.see("nodes", OK)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=True))
    bench.see("devices", BAD)
    bench.later(10)
    bench.see("devices", BAD)
    bench.later(3600)
    bench.see("devices", OK)
    assert bench.closed == [("nodes", Outcome.RESOLVED, "restart"), ("devices", Outcome.RESOLVED, "itself")]


def test_an_action_that_was_not_needed_is_not_credited() -> None:
    """For no fault of its container; a fault of another container, and the action on that one, are not affected."""
    bench = Bench([unit("one", target="a"), unit("more", target="a"), unit("two", target="b")])
    bench.later(10)
    bench.all_healthy()
    for name in ("one", "more", "two"):
        bench.see(name, BAD)
    for name, target in (("one", "a"), ("two", "b")):
        bench.take(bench.tracker.begin_action(target, name, "restart", bench.stamp(), 60.0))
    bench.take(bench.tracker.action_not_needed("a"))
    bench.take(bench.tracker.end_action("a", bench.stamp(), worked=True))
    bench.later(1)
    for name in ("one", "more", "two"):
        bench.see(name, OK)
    assert [by for _, _, by in bench.closed] == ["itself", "itself", "restart"]


def test_a_failed_action_takes_no_credit_from_that_of_another_container() -> None:
    """Both are restarted at the same time."""
    bench = Bench([unit("one", target="a"), unit("two", target="b")])
    bench.later(10)
    bench.all_healthy()
    for name, target in (("one", "a"), ("two", "b")):
        bench.see(name, BAD)
        bench.take(bench.tracker.begin_action(target, name, "restart", bench.stamp(), 60.0))
    bench.take(bench.tracker.end_action("a", bench.stamp(), worked=False))
    bench.later(1)
    bench.see("one", OK)
    bench.see("two", OK)
    assert bench.closed == [("one", Outcome.RESOLVED, "itself"), ("two", Outcome.RESOLVED, "restart")]


def test_a_hold_ends_even_if_its_owner_has_died() -> None:
    """A crashed executor must not mask its target permanently."""
    bench = holding()
    bench.later(61)
    bench.see("container", BAD)
    assert [fault.unit for fault in bench.tracker.open_faults()] == ["container"]


def test_a_fault_states_how_long_its_unit_was_ok() -> None:
    """Without interruption; nothing when the unit was not known to be OK just before."""
    bench = Bench([unit("container")])
    bench.see("container", BAD)
    bench.see("container", OK)
    bench.now += 40
    bench.see("container", OK)
    bench.see("container", BAD)
    bench.see("container", OK)
    bench.see("container", stale("not known"))
    bench.see("container", BAD)
    opened = [event.fault.ok_s for event in bench.events if isinstance(event, FaultOpened)]
    assert opened == [0.0, 40.0, 0.0]


def test_a_period_as_ok_that_ended_as_unknown_counts_once() -> None:
    """An operator has repaired it; then it is unknown or a warning for a moment, and fails again. Counted for that fault only."""
    bench = Bench([unit("container")])
    for seconds, result in ((0, OK), (40, stale("not known")), (1, OK), (2, warn("slow", brief="slow")), (1, BAD)):
        bench.now += seconds
        bench.see("container", result)
    (fault,) = bench.tracker.open_faults()
    assert fault.ok_s == 40.0
    for result in (OK, stale("not known"), BAD):
        bench.see("container", result)
    (fault,) = bench.tracker.open_faults()
    assert fault.ok_s == 0.0


def test_a_period_as_ok_before_a_start_of_the_container_does_not_count() -> None:
    """Restarts that helped no other fault come after it: they count for this one, too."""
    bench = Bench([unit("container", target="app"), unit("nodes", target="app")])
    bench.later(10)
    bench.all_healthy()
    bench.now += 40
    bench.take(bench.tracker.container_started("app", bench.stamp()))
    bench.now += 1
    for result in (stale("starting"), BAD):
        bench.see("nodes", result)
    (fault,) = bench.tracker.open_faults()
    assert fault.ok_s == 1.0


def test_an_escalated_fault_is_closed_once_and_not_opened_again() -> None:
    """Giving up is published once; the unit stays ERROR until it is OK."""
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


def repairing() -> Bench:
    """The container's network was lost; a repair that needs verification is running."""
    bench = Bench([unit("network", target="app"), unit("nodes", "network", target="app", grace_s=8.0)])
    bench.later(10)
    bench.all_healthy()
    bench.now += 1
    bench.see("network", BAD)
    bench.take(bench.tracker.begin_action("app", "network", "reconnect", bench.stamp(), 60.0, verifying=True))
    bench.now += 1
    return bench


def test_a_repair_counts_only_after_verification() -> None:
    """The network is back, its nodes are not: the fault stays open until the repair is verified."""
    bench = repairing()
    done = bench.now
    bench.see("network", OK)
    bench.see("nodes", BAD)
    bench.later(1.0)
    assert bench.closed == []
    assert bench.tracker.found_ok("network", done)
    assert bench.tracker.failing_dependents("network", done) == ("nodes",)
    bench.see("nodes", OK)
    assert bench.tracker.failing_dependents("network", done) == ()
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=True))
    assert bench.closed == [("network", Outcome.RESOLVED, "reconnect")]
    assert bench.opened == ["network"]


def test_a_unit_without_a_target_waits_for_verification_too() -> None:
    """The consensus about nodes in two containers: only its results name the one that is restarted."""
    bench = Bench([unit("consensus")])
    bench.later(10)
    bench.all_healthy()
    bench.see("consensus", BAD)
    bench.take(bench.tracker.begin_action("app", "consensus", "restart", bench.stamp(), 60.0, verifying=True))
    bench.now += 1
    bench.see("consensus", OK)
    assert bench.closed == []
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=True))
    assert bench.closed == [("consensus", Outcome.RESOLVED, "restart")]


def test_a_dependent_counts_as_unknown_if_it_was_ok_before() -> None:
    """A unit that was never OK since its container started proves nothing by staying unknown."""
    bench = Bench(
        [unit("network", target="app"), *(unit(name, "network", target="app") for name in ("nodes", "topic"))]
    )
    bench.later(10)
    bench.see("network", OK)
    bench.see("nodes", OK)
    bench.see("topic", stale("no message type known"))
    bench.now += 1
    bench.see("network", BAD)
    bench.take(bench.tracker.begin_action("app", "network", "reconnect", bench.stamp(), 60.0, verifying=True))
    bench.now += 1
    done = bench.now
    bench.see("network", OK)
    assert bench.tracker.unknown_dependents("network", done) == ()
    bench.see("nodes", stale("the ROS child is starting"))
    bench.see("topic", stale("the ROS child is starting"))
    assert bench.tracker.unknown_dependents("network", done) == ("nodes",)
    bench.see("nodes", OK)
    assert bench.tracker.unknown_dependents("network", done) == ()


def test_a_partial_repair_leaves_the_fault_to_the_next_action() -> None:
    """One cause, one fault: the restart after the reconnection resolves the same fault."""
    bench = repairing()
    bench.see("network", OK)
    bench.see("nodes", BAD)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=False))
    bench.later(1.0)
    assert bench.closed == []
    bench.take(bench.tracker.begin_action("app", "network", "restart", bench.stamp(), 60.0, verifying=True))
    bench.see("network", OK)
    bench.see("nodes", OK)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=True))
    assert bench.closed == [("network", Outcome.RESOLVED, "restart")]
    assert bench.opened == ["network"]


def test_a_partial_repair_with_a_forecast_leaves_the_fault_to_the_next_action() -> None:
    """A forecast is an end of the failure like OK: a dependent that still fails confirms the fault."""
    forecast = warn("4 restarts", brief="4 restarts", condition="restarts_rising").with_evidence(
        Evidence(forecast=True)
    )
    bench = repairing()
    bench.see("network", forecast)
    bench.see("nodes", BAD)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=False))
    bench.later(1.0)
    bench.see("network", forecast)
    bench.see("nodes", BAD)
    assert bench.closed == []
    assert bench.tracker.confirmed_bad("network", bench.now)


def test_an_unverified_repair_counts_once_all_dependents_are_back() -> None:
    """Late, as on a busy machine: nothing is left to wait for, so the fault closes."""
    bench = repairing()
    bench.see("network", OK)
    bench.see("nodes", BAD)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=False))
    bench.later(1.0)
    bench.see("network", OK)
    assert bench.closed == []
    bench.later(1.0)
    bench.see("nodes", OK)
    bench.later(0.1)
    assert bench.closed == [("network", Outcome.RESOLVED, "itself")]


def test_a_late_repair_without_dependents_counts_as_soon_as_the_unit_is_ok() -> None:
    """A topic that flows again after its repair failed verification is no longer a fault."""
    bench = Bench([unit("topics", target="app")])
    bench.later(10)
    bench.all_healthy()
    bench.see("topics", BAD)
    bench.take(bench.tracker.begin_action("app", "topics", "restart", bench.stamp(), 60.0, verifying=True))
    bench.later(12.0)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=False))
    bench.later(1.0)
    bench.see("topics", OK)
    assert bench.closed == [("topics", Outcome.RESOLVED, "itself")]


def test_an_unverified_repair_counts_eventually() -> None:
    """When no further action follows, a unit that is OK does not stay ERROR permanently."""
    bench = repairing()
    bench.see("network", OK)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=False))
    for _ in range(31):
        bench.later(1.0)
        bench.see("network", OK)
    assert [outcome for _, outcome, _ in bench.closed] == [Outcome.RESOLVED]


def test_a_unit_behind_another_target_waits_for_verification() -> None:
    """A radio's link is reopened and the radio answers; the ground station behind it sends one heartbeat per second:
    its grace starts when the repair is verified, and it raises no alarm before.
    """
    bench = Bench([unit("radio", target="link"), unit("gcs", "radio", grace_s=5.0)])
    bench.later(10)
    bench.all_healthy()
    bench.see("radio", BAD)
    bench.take(bench.tracker.begin_action("link", "radio", "reopen", bench.stamp(), 60.0, verifying=True))
    bench.see("gcs", BAD)
    bench.see("radio", OK)
    bench.see("gcs", BAD)
    bench.later(1)
    bench.see("gcs", BAD)
    bench.see("radio", OK)
    assert bench.blocked_by("gcs") == "radio"
    bench.take(bench.tracker.end_action("link", bench.stamp(), worked=True))
    bench.see("gcs", BAD)
    bench.later(1)
    bench.see("gcs", OK)
    assert bench.opened == ["radio"]


def test_the_restart_of_a_dependent_takes_no_credit_from_the_action_that_it_is_part_of() -> None:
    """The container was started; the containers that depend on it were restarted after that."""
    bench = Bench([unit("container", target="app"), unit("other", target="dependent")])
    bench.later(10)
    bench.all_healthy()
    bench.now += 1
    bench.see("container", BAD)
    bench.see("other", BAD)
    bench.take(bench.tracker.begin_action("app", "container", "start", bench.stamp(), 60.0, verifying=True))
    bench.take(bench.tracker.begin_action("dependent", "container", "restart", bench.stamp(), 60.0))
    bench.take(bench.tracker.end_action("dependent", bench.stamp(), worked=True))
    bench.now += 1
    bench.see("container", OK)
    bench.see("other", OK)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=True))
    assert bench.closed == [("other", Outcome.RESOLVED, "restart"), ("container", Outcome.RESOLVED, "start")]


OFF_NETWORK = error("not on net", brief="not on net", condition="disconnected").with_evidence(Evidence(conclusive=True))
ON_NETWORK = [
    unit("container/app", target="app"),
    unit("network/app", "container/app", target="app", grace_s=3.0),
    unit("nodes/n", "container/app", "network/app", target="app", grace_s=8.0),
]


@pytest.mark.parametrize(("action", "opened"), [("restart", ["nodes/n", "network/app"]), ("reconnect", ["nodes/n"])])
def test_a_detached_network_is_reported_while_its_container_is_restarted(action: str, opened: list[str]) -> None:
    """The engine no longer lists the running container on its network, and a restart for a node does not do that; a reconnection does."""
    bench = Bench(ON_NETWORK)
    bench.later(10)
    bench.all_healthy()
    bench.see("nodes/n", BAD)
    bench.see("container/app", OK)
    bench.see("network/app", OK)
    bench.take(bench.tracker.begin_action("app", "nodes/n", action, bench.stamp(), 60.0))
    bench.now += 1
    bench.take(bench.tracker.container_started("app", bench.stamp()))
    bench.see("network/app", OFF_NETWORK)
    assert bench.opened == ["nodes/n"], "it may be connected right after the start"
    bench.later(3.1)
    for name, result in (
        ("network/app", OFF_NETWORK),
        ("container/app", OK),
        ("nodes/n", BAD),
        ("network/app", OFF_NETWORK),
    ):
        bench.see(name, result)
    assert bench.opened == opened


def test_a_network_is_detached_although_the_start_of_its_container_is_not_verified_yet() -> None:
    """The container runs, so it explains nothing; and its start does not wait for the network, nor for what needs that."""
    bench = Bench([*ON_NETWORK, unit("health/app", "container/app", target="app")])
    bench.later(10)
    bench.all_healthy()
    bench.see("container/app", BAD)
    bench.take(bench.tracker.begin_action("app", "container/app", "start", bench.stamp(), 60.0, verifying=True))
    bench.take(bench.tracker.container_started("app", bench.stamp()))
    bench.later(3.1)
    results = {"container/app": OK, "network/app": OFF_NETWORK, "nodes/n": BAD, "health/app": BAD}
    for name in (*results, "network/app"):
        bench.see(name, results[name])
    assert bench.opened == ["container/app", "network/app"]
    assert bench.tracker.failing_dependents("container/app", bench.now) == ("health/app",)
