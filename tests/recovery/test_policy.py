"""The decisions of recovery; no action is executed here."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import ANY

import pytest

from phm.core.model import Evidence, Fault, Layer, Level, Result, Slot, Stamp
from phm.core.settings import ContainerSettings, RecoverySettings
from phm.recovery.base import Target
from phm.recovery.fault_cases import AttemptRecord, History
from phm.recovery.policy import Act, Advise, GiveUp, Skip, Wait, decide, patience_s

APP = Target.of(ContainerSettings(name="app", recover=True))
RULES = RecoverySettings()


def fault(condition: str = "unhealthy", opened: float = 1000.0, ok_s: float = 0.0) -> Fault:
    result = Result(Level.ERROR, "it is broken", "broken", condition, "app")
    return Fault("F1", "health/app", Slot.CONTAINER, Layer.DOCKER, result, Stamp(0.0, opened), ok_s=ok_s)


def attempts(*at: float, worked: bool = False, condition: str = "unhealthy") -> History:
    return History([AttemptRecord(when, "health/app", condition, "restart", worked) for when in at])


def say(history: History | None = None, now: float = 1000.0, *, forbidden: str = "", **more: object) -> object:
    given: dict[str, object] = {"target": APP, "settings": RULES, "fault": fault(), **more}
    return decide(given.pop("fault"), history or History(), now, forbids=lambda action: forbidden, **given)  # type: ignore[arg-type]


def test_the_first_attempt_is_made_immediately() -> None:
    """A wait before the first attempt would only prolong the failure."""
    assert say() == Act("restart", 1)


def test_a_container_that_has_not_opted_in_is_never_touched() -> None:
    """Opt-in by name; a tool that acted on `all` once restarted a backup of cve-search."""
    assert isinstance(say(target=Target.of(ContainerSettings(name="app"))), Skip)


def test_mode_off_does_nothing_and_advise_only_advises() -> None:
    """`recovery.mode`."""
    assert isinstance(say(settings=RecoverySettings(mode="off")), Skip)
    assert isinstance(say(settings=RecoverySettings(mode="advise")), Advise)


def test_a_condition_without_a_ladder_is_left_alone() -> None:
    """A restart fixes neither a missing device nor a blocked transport; a crash loop is the engine's own."""
    for condition in ("device_missing", "not_received", "restarting"):
        assert isinstance(say(fault=fault(condition)), Skip)


def test_steps_that_do_not_apply_are_left_out_of_the_ladder() -> None:
    """Without a relaunch command: restart immediately, which is not a failed attempt; without any step: leave it alone."""
    missing = fault("node_missing")
    assert say(fault=missing, usable=frozenset({"restart"})) == Act("restart", 1)
    assert say(fault=missing, usable=frozenset({"relaunch", "restart"})) == Act("relaunch", 1)
    assert isinstance(say(fault=fault("file_missing"), usable=frozenset()), Skip)


@pytest.mark.parametrize("condition", ["topic_silent", "rate_low"])
def test_a_topic_that_pauses_is_given_time(condition: str) -> None:
    """Nothing is done or advised before the fault has lasted `recovery.patience`."""
    for mode in ("act", "advise"):
        rules = replace_rules(patience=10.0, mode=mode)
        early = say(fault=fault(condition), now=1009.0, settings=rules)
        assert early == Wait(1010.0, "it may come back by itself")
    assert say(fault=fault(condition), now=1010.0) == Act("relaunch", 1)
    assert say(fault=fault("node_missing"), now=1000.0) == Act("relaunch", 1)


@pytest.mark.parametrize(
    ("ok_s", "pause_s", "expected"),
    [(29.0, 0.0, 10.0), (30.0, 0.0, 2.0), (30.0, 0.9, 2.0), (30.0, 3.0, 6.0), (30.0, 8.0, 10.0)],
)
def test_patience_follows_the_pauses_that_a_topic_has_had(ok_s: float, pause_s: float, expected: float) -> None:
    """Short only after the topic was OK for `verify` in this run of the container; at least twice its longest pause."""
    rules = replace_rules(patience=10.0, patience_min=2.0, verify=30.0)
    known = replace(fault("topic_silent"), ok_since_start_s=ok_s, pause_s=pause_s)
    assert patience_s(known, rules) == expected
    assert isinstance(say(fault=known, now=1000.0 + expected - 0.1, settings=rules), Wait)
    assert say(fault=known, now=1000.0 + expected, settings=rules) == Act("relaunch", 1)
    assert patience_s(replace(known, result=fault("data_frozen").result), rules) == expected
    assert patience_s(replace(known, result=fault("node_duplicate").result), rules) == 10.0
    assert patience_s(replace(known, result=fault("node_missing").result), rules) == 0.0


def test_evidence_that_may_end_by_itself_is_given_time() -> None:
    """A transport that seems blocked because topics are silent; beacons do not pause."""
    known = was_ok("transport_blocked", 60.0)
    by_topics = replace(known, result=replace(known.result, evidence=Evidence(patient=True)))
    rules = replace_rules(patience=10.0)
    assert (patience_s(known, rules), patience_s(by_topics, rules)) == (0.0, 10.0)
    assert isinstance(say(fault=replace(by_topics, opened=replace(by_topics.opened, mono=991.0)), settings=rules), Wait)
    assert say(fault=by_topics, settings=rules) == Act("restart", 1)


ONCE = ("transport_blocked", "qos_mismatch", "node_duplicate", "data_frozen", "data_stamp", "not_ready")


def was_ok(condition: str, seconds: float) -> Fault:
    """A fault that opened long ago, so that patience is over."""
    return replace(fault(condition, opened=900.0), ok_since_start_s=seconds, start_seen=True)


@pytest.mark.parametrize("condition", ONCE)
def test_a_failure_in_this_life_of_the_container_is_tried_once(condition: str) -> None:
    """A restart restores the state after the start; when that did not help, it is not the solution."""
    before = was_ok(condition, 60.0)
    assert say(fault=before) == Act("restart", 1)
    assert isinstance(say(attempts(950.0, condition=condition), fault=before), GiveUp)


@pytest.mark.parametrize("condition", ONCE)
def test_a_unit_never_ok_in_this_life_is_left_alone(condition: str) -> None:
    """Its cause is in the start itself: code, a launch file, no shared memory. A brief OK may be left over from before."""
    for seconds in (0.0, 9.0):
        assert isinstance(say(fault=was_ok(condition, seconds)), Skip)
    assert isinstance(say(fault=was_ok(condition, 9.0), start_s=6.0), Act)


@pytest.mark.parametrize("never", [None, True])
@pytest.mark.parametrize("condition", [*ONCE, "publisher_not_received", "quorum_dead"])
def test_what_phms_own_restart_broke_is_restored_once(condition: str, never: bool | None) -> None:
    """It was OK in the run before, which PHM ended: a restart in an overload left nodes that never found each other."""
    known = was_ok(condition, 0.0)
    known = replace(known, result=replace(known.result, evidence=Evidence(never_ok=never)))
    assert isinstance(say(fault=replace(known, ok_in_run_before_s=9.0)), Skip)
    before = replace(known, ok_in_run_before_s=10.0)
    assert say(fault=before) == Act("restart", 1)
    assert isinstance(say(attempts(950.0, condition=condition), fault=before), GiveUp)


@pytest.mark.parametrize(("seconds", "expected"), [(4.0, Skip), (6.0, Act)])
def test_a_container_that_ran_before_phm_needs_no_grace(seconds: float, expected: type) -> None:
    """A restarted PHM need not wait for the grace of a start that was long ago."""
    assert isinstance(say(fault=replace(was_ok("node_duplicate", seconds), start_seen=False)), expected)


@pytest.mark.parametrize(("never", "seconds", "expected"), [(True, 60.0, Skip), (False, 0.0, Act)])
def test_evidence_of_a_check_overrides_the_published_state(never: bool, seconds: float, expected: type) -> None:
    """A network is OK before the check has waited for data on it."""
    known = was_ok("transport_blocked", seconds)
    known = replace(known, result=replace(known.result, evidence=Evidence(never_ok=never)))
    assert isinstance(say(fault=known), expected)


@pytest.mark.parametrize(("never", "seconds"), [(True, 60.0), (None, 0.0), (None, 9.0)])
def test_an_address_that_never_responded_is_left_alone(never: bool | None, seconds: float) -> None:
    """PHM may not reach the network of a healthy container: nothing is done or advised."""
    known = was_ok("address_silent", seconds)
    known = replace(known, result=replace(known.result, evidence=Evidence(never_ok=never)))
    assert isinstance(say(fault=known), Skip)
    rules = RecoverySettings(ladders={"address_silent": ["restart"]})
    assert say(fault=known, settings=rules) == Act("restart", 1)


@pytest.mark.parametrize(("never", "seconds"), [(False, 0.0), (None, 60.0)])
def test_an_address_that_responded_before_gets_every_step(never: bool | None, seconds: float) -> None:
    """It responded in this run of PHM, or of the container. A restart follows when a reconnection has not helped, and so on."""
    known = was_ok("address_silent", seconds)
    known = replace(known, result=replace(known.result, evidence=Evidence(never_ok=never)))
    assert say(fault=known) == Act("reconnect", 1)
    assert say(attempts(950.0, condition="address_silent"), fault=known) == Act("restart", 2)
    assert say(attempts(900.0, 950.0, condition="address_silent"), fault=known) == Act("restart", 3)


def test_a_failed_restart_is_reported_although_the_unit_was_never_ok_after_it() -> None:
    """That it was never OK since then is the failure: a restart that says nothing is repeated. A start by others does not count."""
    known = was_ok("transport_blocked", 60.0)
    known = replace(known, result=replace(known.result, evidence=Evidence(never_ok=True)))
    failed = attempts(950.0, condition="transport_blocked")
    assert isinstance(say(failed, fault=known), GiveUp)
    assert say(marked(failed, not_counted=True), fault=known) == Act("restart", 1)
    assert isinstance(say(marked(failed, backoff_reset=True, not_counted=True), fault=known), Skip)
    assert isinstance(say(attempts(950.0), fault=known), Skip), "it was for another condition"


@pytest.mark.parametrize("condition", ["data_gaps", "data_range"])
def test_a_restart_for_wrong_values_is_only_advised(condition: str) -> None:
    """Messages still arrive, and the sensor behind the node may be the cause. An operator may approve it, and a configured
    ladder is carried out.
    """
    lasting = fault(condition, opened=900.0)
    assert isinstance(say(fault=lasting), Advise)
    assert say(fault=lasting, approved=True) == Act("restart", 1)
    assert say(fault=lasting, settings=RecoverySettings(ladders={condition: ["restart"]})) == Act("restart", 1)
    assert isinstance(say(fault=lasting, settings=RecoverySettings(ladders={condition: []})), Skip)
    assert isinstance(say(fault=fault(condition), now=1001.0), Wait)


def test_a_configured_ladder_applies_whether_or_not_the_unit_was_ok() -> None:
    """A user who names the condition has decided, and gets all attempts."""
    rules = RecoverySettings(ladders={"qos_mismatch": ["restart"]})
    assert say(attempts(950.0, condition="qos_mismatch"), fault=was_ok("qos_mismatch", 0.0), settings=rules) == Act(
        "restart", 2
    )


@pytest.mark.parametrize("condition", ["qos_mismatch", "node_duplicate", "not_ready"])
def test_possibly_transient_failures_are_given_time(condition: str) -> None:
    """A node that replaces another overlaps with it for a moment."""
    new = replace(fault(condition), ok_since_start_s=20.0)
    assert say(fault=new, now=1009.0) == Wait(1010.0, "it may come back by itself")
    assert say(fault=new, now=1010.0) == Act("restart", 1)


def test_the_configuration_may_replace_a_ladder() -> None:
    """Per condition, only the user's ladder counts; an empty one disables recovery."""
    assert say(settings=RecoverySettings(ladders={"unhealthy": ["start"]})) == Act("start", 1)
    assert isinstance(say(settings=RecoverySettings(ladders={"unhealthy": []})), Skip)


def test_the_next_step_follows_a_failed_attempt() -> None:
    """The address is still silent after a reconnection, so the next step is a restart."""
    history = attempts(900.0, condition="address_silent")
    assert say(history, fault=fault("address_silent")) == Act("restart", 2)


def test_a_container_that_is_still_disconnected_is_reconnected_and_not_restarted() -> None:
    """A restart does not connect it; it follows when the container is connected and its nodes have not returned."""
    history = attempts(900.0, condition="disconnected")
    assert say(history, fault=fault("disconnected")) == Act("reconnect", 2)
    partly = History([replace(each, partly=True) for each in history.attempts])
    assert say(partly, fault=fault("disconnected")) == Act("restart", 2)


def test_back_off_doubles_up_to_its_limit() -> None:
    """1, 2, 4 ... seconds after the last attempt, never more than the limit."""
    assert say(attempts(999.5)) == Wait(1000.5, "backing off")
    assert say(attempts(990.0, 999.0)) == Wait(1001.0, "backing off")
    capped = replace_rules(backoff=1.0, backoff_max=3.0, same_failure=50, budget=50)
    assert say(attempts(990.0, 992.0, 994.0, 996.0, 999.0), settings=capped) == Wait(1002.0, "backing off")


def replace_rules(**more: object) -> RecoverySettings:
    return RULES.model_copy(update=more)


def test_ten_minutes_without_attempts_reset_the_back_off() -> None:
    """Old attempts are forgotten."""
    assert say(attempts(100.0, 101.0, 103.0), now=1000.0) == Act("restart", 1)


def test_the_same_failure_three_times_is_given_up() -> None:
    """A tool that retried 1437 times in 14 hours fixed nothing."""
    assert isinstance(say(attempts(900.0, 910.0, 920.0)), GiveUp)


def test_a_lasting_recovery_resets_the_count() -> None:
    """Three recovered faults, minutes apart, are not a reason to give up."""
    assert say(attempts(500.0, 700.0, 900.0, worked=True), fault=fault(opened=1000.0)) == Act("restart", 1)


def test_a_recovery_that_does_not_last_counts_as_a_failure() -> None:
    """A container that starts and ends again is a crash loop, not three successes."""
    history = attempts(980.0, 985.0, 992.0, worked=True)
    assert isinstance(say(history, fault=fault(opened=999.0), now=1010.0), GiveUp)


def test_a_fault_that_an_operator_fixed_is_tried_again() -> None:
    """An operator fixed it after PHM gave up: when it fails minutes later, earlier attempts say nothing about it."""
    history = attempts(900.0, 910.0, 920.0)
    assert say(history, fault=fault(ok_s=RULES.verify + 1)) == Act("restart", 1)
    assert isinstance(say(history, fault=fault(ok_s=RULES.verify - 1)), GiveUp), "it was OK for a moment only"


def test_attempts_on_the_fault_itself_count_however_long_it_was_ok() -> None:
    """Three attempts that did not help are three, also on a unit that had never failed before."""
    history = attempts(1001.0, 1003.0, 1006.0)
    assert isinstance(say(history, fault=fault(ok_s=3600.0), now=1020.0), GiveUp)


def marked(history: History, *, backoff_reset: bool = False, not_counted: bool = False) -> History:
    return History(
        [replace(attempt, backoff_reset=backoff_reset, not_counted=not_counted) for attempt in history.attempts]
    )


def test_uncounted_attempts_are_not_failures_and_use_no_step() -> None:
    """Made while a dependency was down or on an earlier life: the ladder starts again, back-off does not."""
    history = marked(attempts(900.0, 910.0, 998.0, condition="disconnected"), not_counted=True)
    assert say(history, fault=fault("disconnected")) == Wait(1002.0, "backing off")
    assert say(history, fault=fault("disconnected"), now=1002.0) == Act("reconnect", 1)


def test_attempts_with_reset_backoff_count_as_failures() -> None:
    """The target's dependency has recovered: the next attempt may be made immediately."""
    assert say(marked(attempts(990.0, 999.5), backoff_reset=True)) == Act("restart", 3)
    assert isinstance(say(marked(attempts(900.0, 910.0, 920.0), backoff_reset=True)), GiveUp)


def test_the_budget_includes_uncounted_attempts() -> None:
    """However many attempts are not counted, a container is not restarted more often than that."""
    history = marked(attempts(900.0, 910.0, 920.0, 930.0, 940.0), backoff_reset=True, not_counted=True)
    assert say(history) == Wait(1510.0, KEPT_BACK, report=True)


def test_a_lasting_recovery_resets_the_count_even_when_not_counted() -> None:
    """Attempts from before a lasting recovery stay forgotten."""
    helped = AttemptRecord(900.0, "health/app", "unhealthy", "restart", worked=True, not_counted=True)
    history = History([*attempts(700.0, 710.0, 720.0).attempts, helped])
    assert say(history, settings=replace_rules(reserve=0)) == Act("restart", 1)


def test_an_attempt_lasted_from_when_it_was_verified() -> None:
    """A stop of 40 s and a start of 8 s are not a recovery of 48 s: what fails 5 s later is failing still."""
    slow = [AttemptRecord(at, "health/app", "unhealthy", "restart", True, took_s=48.0) for at in (840.0, 893.0, 946.0)]
    assert isinstance(say(History(slow), settings=replace_rules(verify=30.0)), GiveUp)
    assert say(History(slow[:2]), now=1100.0, fault=fault(opened=1100.0)) == Act("restart", 1)


def test_attempts_during_an_outage_are_not_counted() -> None:
    """All attempts on dependents have their back-off reset; only those made during the outage are not counted."""
    history = History(
        [AttemptRecord(at, unit, "x", "restart", worked=False) for at in (10.0, 20.0) for unit in ("a", "b")]
    )
    assert history.reset_backoff({"a"}, 15.0) == {"a"}
    assert [(each.unit, each.backoff_reset, each.not_counted) for each in history.attempts] == [
        ("a", True, False),
        ("b", False, False),
        ("a", True, True),
        ("b", False, False),
    ]
    assert history.reset_backoff({"a"}, 25.0) == frozenset()
    assert [each.not_counted for each in history.attempts] == [False, False, True, False]


def test_a_new_life_discounts_earlier_attempts() -> None:
    """Once: a second reset has no effect."""
    history = attempts(10.0, 20.0)
    assert history.discount_before(15.0)
    assert [(each.backoff_reset, each.not_counted) for each in history.attempts] == [(True, True), (False, False)]
    assert not history.discount_before(15.0)


KEPT_BACK = "budget of 4 actions used up, 1 kept for a container that is down"


def test_the_budget_counts_all_actions_on_the_target() -> None:
    """Different faults share one budget; the wait is published."""
    history = History([AttemptRecord(900.0 + n, f"unit{n}", "x", "restart", True) for n in range(4)])
    assert say(history) == Wait(1500.0, KEPT_BACK, report=True)
    assert say(history, settings=replace_rules(reserve=0)) == Act("restart", 1)


def test_part_of_the_budget_is_reserved_for_a_container_that_is_down() -> None:
    """Restarts because of degraded units must not be the reason that an ended container stays down."""
    history = History([AttemptRecord(900.0 + n, f"unit{n}", "x", "restart", False) for n in range(4)])
    assert say(history, fault=fault("exited")) == Act("start", 1)


@pytest.mark.parametrize("condition", ["exited", "oom", "created"])
def test_a_container_that_is_down_is_started_after_the_budget_is_used_up(condition: str) -> None:
    """Once per maximum back-off: a start of a container that is down does no harm."""
    history = History([AttemptRecord(900.0 + n, f"unit{n}", "x", "restart", False) for n in range(5)])
    decision = say(history, fault=fault(condition), now=950.0)
    assert isinstance(decision, Wait) and decision.until == 904.0 + RULES.backoff_max and decision.report
    assert say(history, fault=fault(condition), now=964.0) == Act("start", 1, alone=True)


def test_a_start_without_budget_is_only_a_start() -> None:
    """Once a minute, so it restarts no dependents, whatever step would be next."""
    others = History([AttemptRecord(900.0 + n, f"unit{n}", "x", "restart", False) for n in range(5)])
    failed = History([*others.attempts, AttemptRecord(906.0, "health/app", "exited", "start", False)])
    assert say(failed, fault=fault("exited"), now=966.0) == Act("start", 2, alone=True)
    assert say(failed, fault=fault("exited"), now=966.0, forbidden="armed") == Advise("start", "armed", again_at=968.0)


def test_a_configured_ladder_without_a_start_keeps_to_the_budget() -> None:
    """Only a start does no harm to the containers that depend on it."""
    history = History([AttemptRecord(900.0 + n, f"unit{n}", "x", "restart", False) for n in range(5)])
    rules = RecoverySettings(ladders={"exited": ["restart"]})
    assert say(history, fault=fault("exited"), settings=rules) == Wait(1500.0, ANY, report=True)


def test_a_container_given_up_while_down_is_started_occasionally() -> None:
    """By the first step of its ladder, once per maximum back-off, with the same permissions as before."""
    history = attempts(900.0, 910.0, 920.0, condition="exited")
    down = fault("exited")
    assert isinstance(say(history, fault=down), GiveUp)
    assert say(history, fault=down, now=979.0, given_up=True) == Wait(980.0, ANY, report=False)
    assert say(history, fault=down, now=980.0, given_up=True) == Act("start", 4, alone=True)
    assert isinstance(say(history, fault=down, given_up=True, forbidden="armed"), Advise)
    assert isinstance(say(history, fault=down, given_up=True, target=Target.of(ContainerSettings(name="app"))), Skip)


def other_attempts(*at: float, worked: bool = False, action: str = "restart") -> History:
    """Attempts for other faults of the same container."""
    return History([AttemptRecord(when, f"rate/{when:g}", "rate_low", action, worked) for when in at])


SHARED = frozenset({"restart"})


def test_an_action_ineffective_for_one_fault_is_not_repeated_for_another() -> None:
    """Three ineffective restarts of the container are three, whichever of its faults they were for."""
    assert say(other_attempts(900.0, 950.0), container_wide=SHARED) == Act("restart", 1)
    decision = say(other_attempts(900.0, 910.0, 950.0), container_wide=SHARED)
    assert isinstance(decision, GiveUp) and "not repeated for health/app" in decision.why
    assert say(other_attempts(900.0, 910.0, 950.0), container_wide=frozenset()) == Act("restart", 1)


def test_back_off_follows_the_action_and_not_the_fault() -> None:
    """Other faults of the container also wait after a recently failed restart."""
    assert say(other_attempts(999.5), container_wide=SHARED) == Wait(1000.5, "backing off")


def test_effective_and_old_attempts_do_not_count() -> None:
    """An effective restart for another fault speaks for the action; a unit that was OK for long has a new fault."""
    helped = History([*other_attempts(900.0, 910.0).attempts, *other_attempts(950.0, worked=True).attempts])
    assert say(helped, container_wide=SHARED, settings=replace_rules(same_failure=2)) == Act("restart", 1)
    fresh = fault(ok_s=RULES.verify + 1)
    assert say(other_attempts(900.0, 910.0, 950.0), fault=fresh, container_wide=SHARED) == Act("restart", 1)


def test_ineffective_restarts_do_not_prevent_the_restart_of_an_ended_container() -> None:
    """A degraded container and an ended one are different failures."""
    history = History([*other_attempts(900.0, 910.0, 920.0).attempts, *attempts(950.0, condition="exited").attempts])
    assert say(history, fault=fault("exited"), container_wide=SHARED) == Act("restart", 2)


def test_an_action_not_permitted_in_flight_is_only_advised() -> None:
    """With the reason, and decided again soon, since landing causes no event."""
    decision = say(forbidden="flight-critical, and the autopilot is armed")
    assert isinstance(decision, Advise) and decision.again_at is not None
    assert decision.why == "flight-critical, and the autopilot is armed"


@pytest.mark.parametrize("mode", ["act", "advise", "off"])
def test_phms_own_steps_need_neither_opt_in_nor_mode(mode: str) -> None:
    """Joining a network affects only PHM, and without it PHM sees nothing."""
    decision = say(
        fault=fault("sidecar_disconnected"),
        target=Target.of(ContainerSettings(name="app")),
        unrestricted=frozenset({"join_network"}),
        settings=RecoverySettings(mode=mode),  # type: ignore[arg-type]
    )
    assert decision == Act("join_network", 1)


def test_giving_up_does_not_depend_on_the_armed_state() -> None:
    """An action that was given up is not advised again."""
    assert isinstance(say(attempts(900.0, 910.0, 920.0), settings=replace_rules(budget=2)), GiveUp)


def test_an_approved_action_is_done_in_advise_mode_and_while_armed() -> None:
    """The approval replaces PHM's restrictions, and nothing else: budget and opt-in still apply."""
    assert say(forbidden="flight-critical, and the autopilot is armed", approved=True) == Act("restart", 1)
    assert say(settings=RecoverySettings(mode="advise"), approved=True) == Act("restart", 1)
    assert isinstance(say(settings=RecoverySettings(mode="off"), approved=True), Skip)
    assert isinstance(say(target=Target.of(ContainerSettings(name="app")), approved=True), Skip)


def test_a_symptom_of_starvation_causes_no_restart() -> None:
    """A fault that was open before is left alone meanwhile, which is published; a container that is down is not a
    symptom.
    """
    decision = say(starved="pressure/app")
    assert isinstance(decision, Wait) and decision.report and "pressure/app is the cause" in decision.why
    assert say(starved="") == Act("restart", 1)


def test_only_a_start_is_tried_again_after_giving_up() -> None:
    """A configured ladder without a start ends with giving up."""
    rules = RecoverySettings(ladders={"exited": ["restart"]})
    assert isinstance(say(fault=fault("exited"), given_up=True, settings=rules), Skip)


def test_lowering_a_cpu_weight_uses_no_budget() -> None:
    """It disturbs no container, so it must not be the reason that one is not restarted."""
    lowered = History([AttemptRecord(900.0 + n, "pressure/app", "cpu_starved", "relieve", True) for n in range(6)])
    assert say(lowered) == Act("restart", 1)
    spent = History([AttemptRecord(900.0 + n, f"unit{n}", "x", "restart", True) for n in range(5)])
    assert say(spent, fault=fault("cpu_starved")) == Act("relieve", 1)


def test_what_phm_does_to_itself_has_a_separate_budget() -> None:
    """PHM without its networks sees nothing; and how often it joins them must not be the reason for leaving a container down."""
    own = frozenset({"join_network"})
    restarts = History([AttemptRecord(900.0 + n, f"unit{n}", "x", "restart", True) for n in range(5)])
    assert say(restarts, fault=fault("sidecar_disconnected"), unrestricted=own) == Act("join_network", 1)
    joins = History([AttemptRecord(900.0 + n, "network/app", "x", "join_network", True) for n in range(5)])
    assert say(joins, unrestricted=own) == Act("restart", 1)
    assert say(joins, fault=fault("exited"), unrestricted=own) == Act("start", 1)
    spent = say(joins, fault=fault("sidecar_disconnected"), unrestricted=own)
    assert spent == Wait(1500.0, "budget of 5 actions used up", report=True)
