"""Starvation is a cause: one alarm at the pressure unit, its symptoms STALE, everything else unchanged."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from phm import testing
from phm.api import Level, PeerFact, Result, error, ok, stale, warn
from phm.core.model import Evidence, Outcome, Transition
from phm.tracker.starvation import BEFORE_PRESSURE_S, EXPLAINED, RECOVERY_S, UNKNOWN_PRESSURE_S, UNREAD_S, WARN_WAIT_S
from phm_checks.peers import SWARM, Peers
from tests.fakes.tracker_bench import OK, Bench, unit

HOST = ("host/cpu",)
BOTH = ("pressure/app", *HOST)
THROTTLED = error(
    "app throttled 97 % of the time by its limit of 0.03 CPUs: raise it",
    brief="app throttled",
    condition="cpu_throttled",
)
WAITS = error("app waits for a core", brief="app waits", condition="cpu_starved")
OVERLOADED = error("CPU at 100 %", brief="CPU 100 %", condition="cpu_high")
SLOW = error("topic /x at 3 Hz, expected 10", brief="3 Hz", condition="rate_low")
HUNG = error("node hangs", brief="hung", condition="node_hung")
GONE = error("node is gone", brief="dead", condition="node_missing").with_evidence(Evidence(conclusive=True))
EXITED = error("app exited", brief="exited", condition="exited")
MISFIT = error("QoS mismatch", brief="QoS mismatch", condition="qos_mismatch").with_evidence(Evidence(conclusive=True))


def bench(**more: float) -> Bench:
    """A container with a node and its topic, the container's pressure and the host's."""
    made = Bench(
        [
            unit("host/cpu"),
            unit("container/app"),
            unit("pressure/app", "container/app", starved_by=HOST),
            unit("nodes/n", "container/app", starved_by=BOTH, **more),
            unit("rates/x", "nodes/n", starved_by=BOTH, **more),
        ]
    )
    made.all_healthy()
    made.later(3.0)
    made.all_healthy()
    return made


def answered(made: Bench, *pressure: str, result: Result = OK) -> None:
    """Return a bench whose pressure units have been checked."""
    for name in pressure:
        made.see(name, result)


def over(made: Bench, *pressure: str) -> None:
    answered(made, *pressure)


def test_a_symptom_is_blocked_by_the_pressure_unit_that_explains_it() -> None:
    """One alarm at the cause; the symptom is STALE and says what it follows from."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    made.see("rates/x", SLOW)
    assert made.opened == ["pressure/app"]
    assert made.blocked_by("rates/x") == "pressure/app"
    state = made.tracker.state("rates/x")
    assert state.result.summary == "blocked by pressure/app: topic /x at 3 Hz, expected 10"
    assert made.tracker.open_faults()[0].blocks == ("rates/x",)


def test_a_symptom_waits_until_the_pressure_units_have_answered_since() -> None:
    """They are queried when the symptom is seen; their answer decides, so the order of evidence does not."""
    made = bench()
    made.later(0.1)
    asked = made.see("rates/x", SLOW)
    assert asked >= set(BOTH)
    made.see("nodes/n", OK)
    made.see("container/app", OK)
    made.later(0.1)
    assert made.level("rates/x") is Level.OK
    made.see("pressure/app", THROTTLED)
    made.see("container/app", OK)
    assert made.opened == ["pressure/app"]
    assert made.blocked_by("rates/x") == "pressure/app"


def test_a_symptom_without_starvation_is_published_once_they_have_answered() -> None:
    """If pressure units are OK, the symptom is a separate fault."""
    made = bench()
    made.later(0.1)
    made.see("rates/x", SLOW)
    for name in ("container/app", "nodes/n", *BOTH):
        made.see(name, OK)
    assert made.opened == ["rates/x"]


def test_a_pressure_unit_that_cannot_tell_explains_nothing_and_delays_nothing() -> None:
    """STALE is an answer."""
    made = bench()
    made.later(0.1)
    made.see("rates/x", SLOW)
    answered(made, "container/app", "nodes/n", "host/cpu")
    made.see("pressure/app", stale("no figures"))
    assert made.opened == ["rates/x"]


def test_a_pressure_unit_that_never_answers_delays_a_symptom_for_a_limited_time() -> None:
    """A hanging check gets as much time as an unknown dependency."""
    made = bench()
    made.later(0.1)
    made.see("rates/x", SLOW)
    answered(made, "container/app", "nodes/n", "host/cpu")
    made.later(9.8)
    assert made.opened == []
    made.later(0.3)
    assert made.opened == ["rates/x"]


def test_a_warning_of_pressure_explains_nothing_but_is_waited_for() -> None:
    """It raises no alarm, so a symptom blocked by it would have none; but it may become ERROR soon."""
    made = bench()
    made.see("pressure/app", warn("app throttled 20 %", brief="throttled", condition="cpu_throttled"))
    made.later(0.1)
    made.see("rates/x", SLOW)
    answered(made, "container/app", "nodes/n", "host/cpu")
    warned = warn("app throttled 30 %", brief="throttled", condition="cpu_throttled")
    made.see("pressure/app", warned)
    assert made.opened == []
    made.later(WARN_WAIT_S)
    made.see("pressure/app", warned)
    assert made.opened == ["rates/x"]


def test_a_measurement_above_the_limit_delays_a_symptom_before_there_is_a_warning() -> None:
    """An overload shows in rates before it has lasted long enough to be reported: one alarm, at the cause."""
    made = bench()
    rising = OK.with_evidence(Evidence(rising=True))
    made.later(0.1)
    made.see("rates/x", SLOW)
    answered(made, "container/app", "nodes/n", "pressure/app")
    made.see("host/cpu", rising)
    assert made.opened == []
    made.later(1.0)
    made.see("host/cpu", OVERLOADED)
    made.see("pressure/app", OK)
    assert made.opened == ["host/cpu"]
    assert made.blocked_by("rates/x") == "host/cpu"


@pytest.mark.parametrize("condition", ["memory_high", "memory_filling"])
def test_a_warning_that_explains_nothing_delays_nothing(condition: str) -> None:
    """Memory that is used up is not waited for: on a small computer such a warning may last for the entire flight."""
    made = Bench([unit("host/memory"), unit("rates/x", starved_by=("host/memory",))])
    made.all_healthy()
    full = warn("memory at 86 %", brief="memory 86 %", condition=condition)
    made.see("host/memory", full)
    made.later(0.1)
    made.see("rates/x", SLOW)
    made.see("host/memory", full)
    assert made.opened == ["rates/x"]


@pytest.mark.parametrize("condition", ["memory_pressure", "io_pressure"])
def test_a_container_waits_for_the_host_only_while_that_is_rising(condition: str) -> None:
    """The computer waits for the same resource: one alarm, there. Where it does not, the container is the cause, immediately."""
    of_app = error("app waits", brief="app waits", condition=condition)
    made = Bench([unit("host/x"), unit("pressure/app", starved_by=("host/x",))])
    made.all_healthy()
    made.later(0.1)
    made.see("pressure/app", of_app)
    made.see("host/x", OK.with_evidence(Evidence(rising=True)))
    made.later(WARN_WAIT_S - 0.5)
    assert made.opened == []
    made.see("host/x", OK)
    assert made.opened == ["pressure/app"]


def test_a_measurement_above_the_limit_delays_no_longer_than_a_warning() -> None:
    """A symptom waits WARN_WAIT_S for its cause, then it is a separate fault."""
    made = bench()
    rising = OK.with_evidence(Evidence(rising=True))
    made.later(0.1)
    made.see("rates/x", SLOW)
    answered(made, "container/app", "nodes/n", "pressure/app", result=OK)
    made.see("host/cpu", rising)
    made.later(WARN_WAIT_S)
    made.see("host/cpu", rising)
    assert made.opened == ["rates/x"]


@pytest.mark.parametrize(
    "result",
    [
        EXITED,
        GONE,
        MISFIT,
        error("left out", brief="left out", condition="node_missing").with_evidence(Evidence(certain=True)),
    ],
    ids=["exited", "process gone", "qos", "certain"],
)
def test_a_failure_that_starvation_does_not_explain_is_published_immediately(result: Result) -> None:
    """Also during starvation: an ended process has ended."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    made.later(0.1)
    made.see("nodes/n", result)
    answered(made, "container/app")
    assert made.opened == ["pressure/app", "nodes/n"]


def test_a_real_fault_blocks_before_starvation_does() -> None:
    """Consequences of an exit are attributed to it also during starvation, and an older attribution is corrected."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    made.see("rates/x", SLOW)
    made.see("container/app", EXITED)
    assert made.blocked_by("rates/x") == "container/app"
    assert made.opened == ["pressure/app", "container/app"]


def test_a_starved_dependency_does_not_hide_conclusive_evidence() -> None:
    """A node delayed by starvation does not explain its topic's QoS mismatch; it blocks everything else as usual."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    made.see("nodes/n", HUNG)
    made.see("rates/x", error("odd", brief="odd", condition="own_condition"))
    assert made.blocked_by("rates/x") == "nodes/n"
    made.later(0.1)
    made.see("nodes/n", HUNG)
    made.see("container/app", OK)
    made.see("rates/x", MISFIT)
    made.see("container/app", OK)
    made.see("nodes/n", HUNG)
    assert made.opened == ["pressure/app", "rates/x"]


def test_a_symptom_published_just_before_is_reattributed() -> None:
    """Pressure figures take a moment to rise; in the end there is one open fault, at the cause."""
    made = bench()
    made.later(0.1)
    made.see("rates/x", SLOW)
    answered(made, "container/app", "nodes/n", *BOTH)
    made.later(BEFORE_PRESSURE_S - 0.5)
    made.see("pressure/app", THROTTLED)
    assert made.closed == [("rates/x", Outcome.REATTRIBUTED, "pressure/app")]
    assert made.blocked_by("rates/x") == "pressure/app"


def test_a_fault_from_before_starvation_stays_open_and_is_left_alone() -> None:
    """It has another cause, but cannot be judged or repaired during starvation: recovery is asked to leave it alone."""
    made = bench()
    made.later(0.1)
    made.see("rates/x", SLOW)
    answered(made, "container/app", "nodes/n", *BOTH)
    assert made.tracker.starved_by("rates/x", made.stamp()) == ""
    made.later(BEFORE_PRESSURE_S + 0.5)
    made.see("pressure/app", THROTTLED)
    made.see("rates/x", SLOW)
    assert made.level("rates/x") is Level.ERROR
    assert made.closed == []
    assert made.tracker.starved_by("rates/x", made.stamp()) == "pressure/app"
    over(made, "pressure/app")
    assert made.tracker.starved_by("rates/x", made.stamp()) == "pressure/app"
    made.later(RECOVERY_S + 0.1)
    made.see("rates/x", SLOW)
    assert made.tracker.starved_by("rates/x", made.stamp()) == ""
    assert made.level("rates/x") is Level.ERROR


def test_a_symptom_gets_time_to_clear_after_starvation() -> None:
    """It is unknown at first; OK closes it without an alarm."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    made.see("rates/x", SLOW)
    made.later(1.0)
    over(made, "pressure/app")
    made.see("rates/x", SLOW)
    assert made.level("rates/x") is Level.STALE
    assert made.blocked_by("rates/x") == ""
    made.later(1.0)
    made.see("rates/x", OK)
    assert made.level("rates/x") is Level.OK
    assert made.opened == ["pressure/app"]


def test_a_symptom_that_persists_after_starvation_is_a_separate_fault() -> None:
    """Nothing stays STALE permanently."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    made.see("rates/x", SLOW)
    made.later(1.0)
    over(made, "pressure/app")
    made.later(RECOVERY_S + 0.1)
    made.see("rates/x", SLOW)
    answered(made, "container/app", "nodes/n", *BOTH)
    assert made.opened == ["pressure/app", "rates/x"]


def test_after_starvation_old_evidence_proves_nothing() -> None:
    """A health probe that failed during starvation counts only when a later one fails, too."""
    made = Bench([unit("pressure/app"), unit("health/app", starved_by=("pressure/app",))])
    made.all_healthy()
    unhealthy = error("unhealthy", brief="unhealthy", condition="unhealthy")
    made.see("pressure/app", THROTTLED)
    made.see("health/app", unhealthy)
    made.later(1.0)
    over(made, "pressure/app")
    made.later(20.0)
    made.see("health/app", Result(Level.ERROR, "unhealthy", "unhealthy", "unhealthy", age_s=25.0))
    over(made, "pressure/app")
    assert made.opened == ["pressure/app"]
    assert made.level("health/app") is Level.STALE
    made.see("health/app", Result(Level.ERROR, "unhealthy", "unhealthy", "unhealthy", age_s=1.0))
    over(made, "pressure/app")
    assert made.opened == ["pressure/app", "health/app"]


def test_an_unexplained_failure_gets_no_grace_after_starvation() -> None:
    """A process that ends just after starvation is reported as quickly as usual."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    made.see("nodes/n", HUNG)
    made.later(1.0)
    over(made, "pressure/app")
    made.later(0.1)
    made.see("nodes/n", GONE)
    answered(made, "container/app", *BOTH)
    assert made.opened == ["pressure/app", "nodes/n"]


def test_the_machine_is_the_cause_of_a_container_that_waits_for_its_cores() -> None:
    """One alarm at the host; the container's own limit would be a different cause."""
    made = bench()
    made.see("pressure/app", WAITS)
    made.see("rates/x", SLOW)
    made.later(1.0)
    made.see("host/cpu", OVERLOADED)
    made.later(3.0)
    made.see("pressure/app", WAITS)
    assert made.opened == ["host/cpu"]
    assert made.blocked_by("pressure/app") == made.blocked_by("rates/x") == "host/cpu"
    made.see("pressure/app", THROTTLED)
    answered(made, "container/app", "host/cpu", result=OVERLOADED)
    made.see("container/app", OK)
    made.see("pressure/app", THROTTLED)
    assert made.blocked_by("pressure/app") == ""


@pytest.mark.parametrize("condition", ["memory_pressure", "io_pressure"])
def test_an_overloaded_cpu_explains_neither_low_memory_nor_a_slow_disk(condition: str) -> None:
    """A container short of memory or disk is a separate cause, also while all cores are busy."""
    made = bench()
    made.see("host/cpu", OVERLOADED)
    made.see("pressure/app", error("app waits", brief="app waits", condition=condition))
    made.later(WARN_WAIT_S)
    made.see("host/cpu", OVERLOADED)
    made.see("pressure/app", error("app waits", brief="app waits", condition=condition))
    made.see("container/app", OK)
    assert made.opened == ["host/cpu", "pressure/app"]


def test_a_container_that_waits_while_the_machine_is_not_overloaded_is_the_cause() -> None:
    """Its own cores may be busy (cpuset), or the machine's figures are not available."""
    made = bench()
    made.see("pressure/app", WAITS)
    made.see("rates/x", SLOW)
    made.later(WARN_WAIT_S + 0.1)
    answered(made, "container/app", "host/cpu")
    made.see("pressure/app", WAITS)
    answered(made, "container/app", "host/cpu")
    assert made.opened == ["pressure/app"]
    assert made.blocked_by("rates/x") == "pressure/app"


def test_the_last_result_of_a_pressure_unit_stays_valid_for_a_limited_time() -> None:
    """An overloaded Docker Engine provides no figures for a moment: starvation continues, but not without limit."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    made.see("rates/x", SLOW)
    made.later(1.0)
    made.see("pressure/app", stale("the engine does not answer"))
    made.later(UNKNOWN_PRESSURE_S - 1.5)
    assert made.blocked_by("rates/x") == "pressure/app"
    made.later(1.5)
    made.see("rates/x", SLOW)
    assert made.blocked_by("rates/x") == ""


def test_full_memory_without_stalls_explains_nothing() -> None:
    """A high level is not starvation: it delays nothing."""
    made = Bench([unit("host/memory"), unit("rates/x", starved_by=("host/memory",))])
    made.all_healthy()
    made.see("host/memory", error("memory at 97 %", brief="memory 97 %", condition="memory_high"))
    made.see("rates/x", SLOW)
    made.see("host/memory", error("memory at 97 %", brief="memory 97 %", condition="memory_high"))
    assert made.opened == ["host/memory", "rates/x"]


def test_a_limit_of_processes_explains_a_probe_that_cannot_start_and_no_slow_topic() -> None:
    """Each symptom lists the conditions of its causes."""
    limit = error("app has reached its limit of 20 processes", brief="app pids", condition="pids_limit")
    by = ("pressure/app",)
    made = Bench([unit("pressure/app"), unit("health/app", starved_by=by), unit("rates/x", starved_by=by)])
    made.all_healthy()
    made.see("pressure/app", limit)
    made.see("health/app", error("unhealthy", brief="unhealthy", condition="unhealthy"))
    made.see("rates/x", SLOW)
    made.see("pressure/app", limit)
    assert made.blocked_by("health/app") == "pressure/app"
    assert made.opened == ["pressure/app", "rates/x"]


def test_a_fault_that_was_given_up_stays_visible_while_starved() -> None:
    """It is older than the starvation, and in ERROR until it is OK."""
    made = bench()
    made.later(0.1)
    made.see("rates/x", SLOW)
    answered(made, "container/app", "nodes/n", *BOTH)
    made.take(made.tracker.escalate(made.tracker.open_faults()[0].id, made.stamp()))
    made.see("pressure/app", THROTTLED)
    made.see("rates/x", SLOW)
    assert made.level("rates/x") is Level.ERROR
    assert [fault.unit for fault in made.tracker.given_up()] == ["rates/x"]


def test_starvation_does_not_affect_units_that_are_ok() -> None:
    """It blocks symptoms, not units."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    made.see("nodes/n", OK)
    made.see("rates/x", ok("10 Hz"))
    assert made.level("nodes/n") is made.level("rates/x") is Level.OK
    assert [e.unit for e in made.events if isinstance(e, Transition)] == ["pressure/app"]


def test_the_documented_table_is_that_of_the_code() -> None:
    """Each condition is listed with the evidence that starvation can produce it."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "development" / "architecture.md").read_text()
    table = page.partition("<!-- explained: begin")[2].partition("<!-- explained: end")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[3:]]
    documented = {condition: row[1] for row in rows for condition in re.findall(r"`(\w+)`", row[0])}
    assert documented == {condition: entry.evidence for condition, entry in EXPLAINED.items()}


def split_swarm() -> Result:
    """Two peers lost together, as seen by an agent that receives no other one."""
    lost = PeerFact("lost", 20.0, (), (1,))
    peers = {2: lost, 3: lost, 4: PeerFact("never seen", None)}
    return Peers((2, 3, 4)).run(testing.world(swarm=testing.FakeSwarm(peers=peers, split=(2, 3))))[SWARM]


LOST = error("autopilot silent for 4 s", brief="silent", condition="autopilot_silent")


@pytest.mark.parametrize("lost", [LOST, split_swarm()], ids=lambda result: result.condition)
def test_a_link_silent_for_longer_than_phm_was_late_is_lost(lost: Result) -> None:
    """PHM subtracts its own lateness: a silence longer than UNREAD_S is not lateness. The alarm then stays."""
    made = Bench([unit("host/cpu"), unit("link/a", starved_by=HOST)])
    made.all_healthy()
    made.later(3.0)
    made.all_healthy()
    made.see("host/cpu", OVERLOADED)
    made.see("link/a", lost)
    assert made.blocked_by("link/a") == "host/cpu"
    made.later(UNREAD_S - 1.0)
    made.see("host/cpu", OVERLOADED)
    made.see("link/a", lost)
    assert made.opened == ["host/cpu"]
    for _ in range(3):
        made.later(2.0)
        made.see("host/cpu", OVERLOADED)
        made.see("link/a", lost)
    assert made.opened == ["host/cpu", "link/a"]
    assert made.level("link/a") is Level.ERROR


def test_only_published_starvation_discounts_attempts() -> None:
    """A load burst at a start, suppressed by the pressure unit's own grace, is not starvation."""
    made = bench()
    made.see("pressure/app", THROTTLED)
    assert made.tracker.active_pressure("nodes/n") == "pressure/app"
    over(made, "pressure/app")
    assert made.tracker.active_pressure("nodes/n") == ""


def test_a_repair_is_verified_regardless_of_its_containers_pressure() -> None:
    """A container that is up again and still starved was restarted successfully."""
    made = Bench([unit("container/app", target="app"), unit("pressure/app", "container/app", target="app")])
    made.all_healthy()
    made.later(3.0)
    made.see("pressure/app", THROTTLED)
    assert made.tracker.failing_dependents("container/app", 0.0) == ()
