"""Scoring of a trial's record: each rule of docs/development/campaign.md by name."""

from __future__ import annotations

from typing import Any

import pytest

from sitl.campaign.attempts import attempts
from sitl.campaign.scoring import judge
from sitl.campaign.statustext import by_others, own
from sitl.campaign.trial import OFF, Act, Broken, Load, RaisedWarning, Start, Summary, Trial
from sitl.campaign.verdict import ACTION, DOCKER, INJECTOR, ITSELF, PHM, Verdict
from tests.fakes.campaign_trials import NODE, T0, alarm, injection, line, started, trial, verified


def only(made: Trial) -> Verdict:
    (verdict,) = judge(made).verdicts
    return verdict


def test_times_count_from_the_injection() -> None:
    """Logged, received on the ground, verified: each relative to the time of injection."""
    verdict = only(trial())
    assert verdict.detected_s == pytest.approx(0.4)
    assert verdict.response_s == pytest.approx(0.9)
    assert verdict.claimed_s == pytest.approx(4.0)
    assert (verdict.by, verdict.count, verdict.right, verdict.missed) == ("restart", 1, True, False)


def test_a_verified_action_that_phm_does_not_credit_ended_nothing() -> None:
    """E.g. `reopen` while the autopilot rebooted: it is OK again, and the record names the reboot."""
    raised = alarm(0.4, closed=T0 + 7, outcome="resolved", by="reboot")
    verdict = only(trial(alarms=[raised], acts=[verified(6.9, action="reopen")]))
    assert (verdict.by, verdict.claimed_s) == ("reboot", pytest.approx(7.0))


def test_a_fault_without_an_alarm_is_missed() -> None:
    """Without its own alarm it is missed, and neither correct nor recovered."""
    verdict = only(trial(alarms=[], acts=[], lines=[]))
    assert (verdict.missed, verdict.right, verdict.claimed_s) == (True, False, None)


def test_an_alarm_before_the_injection_is_false() -> None:
    """An alarm from before the fault cannot be about it."""
    judged = judge(trial(alarms=[alarm(-0.5), alarm(0.4)]))
    assert [each.mono for each in judged.false] == [T0 - 0.5]


def test_a_side_effect_of_the_injector_belongs_to_its_fault() -> None:
    """A restart that is needed to cause a fault may raise an alarm before the fault exists: not a false alarm, but a
    wrong cause.
    """
    late = injection(asked=T0 - 2)
    judged = judge(trial(injections=[late], alarms=[alarm(-0.5, "container/ros_app"), alarm(0.4)]))
    assert (judged.false, judged.verdicts[0].count) == ([], 2)
    assert judged.verdicts[0].wrong == f"reported at container/ros_app first, then at {NODE}"


def test_a_side_effect_of_clearing_is_not_counted() -> None:
    """A restart that clears a fault may raise an alarm: listed, but counted neither for the fault nor as false."""
    judged = judge(trial(injections=[injection(renewed=True)], alarms=[alarm(0.4), alarm(20.5, "container/ros_app")]))
    assert (judged.verdicts[0].count, judged.false, [each.unit for each in judged.clearing]) == (
        1,
        [],
        ["container/ros_app"],
    )


def test_an_alarm_on_another_agent_is_false() -> None:
    """An agent without an injected fault has nothing to report."""
    judged = judge(trial(alarms=[alarm(0.4), alarm(0.5, "rates/agent_4/topic_1", 4)]))
    assert [each.agent for each in judged.false] == [4]
    assert judged.verdicts[0].count == 1


@pytest.mark.parametrize(
    ("unit", "loads", "confirmed"),
    [
        ("host/cpu", [99.0, 99.0, 99.0], True),
        ("host/cpu", [99.0, 50.0, 99.0], False),
        ("host/cpu", [99.0], False),
        ("host/cpu", [], False),
        ("host/memory", [99.0, 99.0], False),
        ("host/temperature", [99.0, 99.0], False),
    ],
)
def test_only_measured_host_load_confirms_an_alarm(unit: str, loads: list[float], confirmed: bool) -> None:
    """An alarm about the shared machine is false unless the campaign's own samples show that load at that time."""
    samples = [Load(T0 - 2 + second, cpu=cpu, memory=50.0, disk=50.0) for second, cpu in enumerate(loads)]
    judged = judge(trial(alarms=[alarm(0.4), alarm(1.0, unit, 5)], machine=samples))
    assert (len(judged.beside), len(judged.false)) == ((1, 0) if confirmed else (0, 1))
    late = judge(trial(alarms=[alarm(0.4), alarm(19.0, unit, 5)], machine=samples))
    assert (late.beside, len(late.false)) == ([], 1), "the load was long over"


@pytest.mark.parametrize(
    ("unit", "agent", "began_s", "ended_s", "real"),
    [
        ("consensus", 5, -5.0, 2.0, True),
        ("nodes/agent_5/node_1", 5, -5.0, 2.0, True),
        ("consensus", 5, -3.0, 2.0, False),  # for too short a time
        ("consensus", 5, -9.0, 0.9, False),  # over before the alarm
        ("consensus", 4, -9.0, 2.0, False),  # another agent
        ("network/ros_app", 5, -9.0, 2.0, False),  # not what was observed
    ],
)
def test_an_application_that_was_observed_not_to_work_confirms_an_alarm(
    unit: str, agent: int, began_s: float, ended_s: float, real: bool
) -> None:
    """An alarm about an agent without a fault is apart from the false ones if its application did not work for 5 s before it."""
    broken = [Broken(agent, T0 + began_s, T0 + ended_s)]
    judged = judge(trial(alarms=[alarm(0.4), alarm(1.0, unit, 5)], broken=broken))
    assert (len(judged.app_broken), len(judged.false)) == ((1, 0) if real else (0, 1))


def test_an_injected_host_load_keeps_its_alarms() -> None:
    """Where the machine's load is the fault, its alarm is neither false nor confirmed."""
    hog = injection(unit="host/cpu", condition="cpu_busy", group="host")
    judged = judge(trial(injections=[hog], alarms=[alarm(1.0, "host/cpu", conditions=["cpu_busy"])]))
    assert (judged.beside, judged.false, judged.verdicts[0].right) == ([], [], True)


def test_a_chain_is_counted_and_wrong_if_it_began_elsewhere() -> None:
    """A second alarm on the victim belongs to the fault; one before the cause makes the cause wrong."""
    topic = alarm(0.2, "rates/agent_3/topic_1")
    verdict = only(trial(alarms=[alarm(0.4), topic]))
    assert verdict.count == 2
    assert verdict.wrong == f"reported at rates/agent_3/topic_1 first, then at {NODE}"
    later = only(trial(alarms=[alarm(0.4), alarm(0.6, "rates/agent_3/topic_1")]))
    assert (later.count, later.wrong) == (2, "")


def test_an_alarm_only_elsewhere_is_a_wrong_cause_and_not_missed() -> None:
    """PHM raised an alarm, but not at the cause."""
    verdict = only(trial(alarms=[alarm(0.4, "network/ros_app")]))
    assert (verdict.missed, verdict.detected_s) == (False, None)
    assert verdict.wrong == f"reported at network/ros_app, expected at {NODE}"


def test_the_condition_must_be_the_expected_one() -> None:
    """The right unit with the wrong condition is a wrong cause, unless the condition becomes right while the fault
    lasts.
    """
    assert (
        only(trial(alarms=[alarm(0.4, conditions=["node_hung"])])).wrong == "known as node_hung, expected node_missing"
    )
    assert only(trial(alarms=[alarm(0.4, conditions=["node_hung", "node_missing"])])).right


def test_a_fault_is_recovered_only_before_it_is_cleared() -> None:
    """A fault that the injector cleared was not recovered by PHM; closed as resolved counts if no verification was
    needed.
    """
    assert only(trial(acts=[verified(25.0)], alarms=[alarm(0.4)])).claimed_s is None
    itself = alarm(0.4, closed=T0 + 3, outcome="resolved", by="itself")
    verdict = only(trial(acts=[], alarms=[itself]))
    assert (verdict.claimed_s, verdict.by) == (pytest.approx(3.0), "itself")
    assert only(trial(acts=[], alarms=[alarm(0.4, closed=T0 + 3, outcome="reattributed")])).claimed_s is None


def test_a_running_trial_can_be_scored() -> None:
    """While nothing is cleared and the end is unknown, a recovered fault counts as recovered."""
    assert only(trial(injections=[injection(cleared=None)], ended=0.0)).claimed_s == pytest.approx(4.0)


def test_nothing_is_recovered_with_recovery_off() -> None:
    """In that run, only changes are scored."""
    made = trial()
    made.kind = OFF
    assert only(made).claimed_s is None


def test_several_units_need_several_alarms() -> None:
    """A fault that breaks two independent units needs two alarms, and is recovered when both units are."""
    both = injection(also=["files/ros_app"])
    verdict = only(trial(injections=[both], alarms=[alarm(0.4), alarm(2.0, "files/ros_app")]))
    assert (verdict.expected, verdict.count, verdict.claimed_s) == (2, 2, None)
    acts = [verified(4.0), verified(5.0, "files/ros_app", action="restore_file")]
    verdict = only(trial(injections=[both], alarms=[alarm(0.4), alarm(2.0, "files/ros_app")], acts=acts))
    assert (verdict.claimed_s, verdict.by) == (pytest.approx(5.0), "restart, restore_file")


def test_compound_faults_each_keep_their_own_alarms() -> None:
    """An alarm belongs to the fault on its agent; for several faults on one agent, to the fault of its group."""
    file = injection(fault="file_deleted", unit="files/ros_app", condition="file_missing", group="files")
    other = injection(agent=5, unit="container/ros_app", condition="exited", group="app")
    alarms = [
        alarm(0.4),
        alarm(1.0, "files/ros_app", conditions=["file_missing"]),
        alarm(0.2, "container/ros_app", 5, conditions=["exited"]),
        alarm(3.0, "health/ros_app", 5),
    ]
    verdicts = judge(trial(injections=[injection(), file, other], alarms=alarms)).verdicts
    assert [(each.kind, each.count, each.right) for each in verdicts] == [
        ("compound", count, True) for count in (1, 1, 2)
    ]


def test_a_lost_peer_reported_by_all_is_one_alarm() -> None:
    """Seven agents that miss the same peer count once, beside the peer's own alarm; twice from one agent counts twice."""
    gone = injection(
        unit="peers/swarm", others="peers/A03", condition="all_peers_lost", layer="link", group="link", healable=False
    )
    alone = alarm(10.0, "peers/swarm", slot=12, conditions=["all_peers_lost"])
    by_peers = [alarm(10.0 + agent / 10, "peers/A03", agent, slot=12, conditions=["peer_lost"]) for agent in (1, 2, 4)]
    made = trial(injections=[gone], alarms=[alone, *by_peers], acts=[], lines=[line(11.0, "A01 FAIL 12 A03 lost", 1)])
    verdict = only(made)
    assert (verdict.expected, verdict.count, verdict.right, judge(made).false) == (2, 2, True, [])
    assert (verdict.detected_s, verdict.response_s) == (pytest.approx(10.0), pytest.approx(11.0))
    made.alarms.append(alarm(19.0, "peers/A03", 1))
    assert only(made).count == 3


def test_a_lost_peer_without_a_link_fault_is_false() -> None:
    """A killed node does not disconnect a peer."""
    assert len(judge(trial(alarms=[alarm(0.4), alarm(5.0, "peers/A03", 1)])).false) == 1


def test_phm_is_back_when_it_reports() -> None:
    """A fault without an alarm: PHM's next run begins with a line, and is complete with the first report."""
    gone = injection(unit="", condition="", layer="companion", group="phm", phm=True)
    back = {"starts": [Start(3, T0 + 1.5, T0 + 3.0)], "lines": [line(3.5, "A03 OK 11111111")], "alarms": [], "acts": []}
    verdict = only(trial(injections=[gone], **back))
    assert (verdict.detected_s, verdict.response_s, verdict.claimed_s) == (1.5, 3.5, 3.0)
    assert (verdict.expected, verdict.count, verdict.missed, verdict.right) == (0, 0, False, True)
    assert only(trial(injections=[gone], alarms=[], acts=[], lines=[])).missed


def test_a_warning_counts_as_detection_of_a_warning_fault() -> None:
    """Faults with level WARN open no fault; the transition counts."""
    slow = injection(unit="radio/ground", condition="radio_lossy", layer="link", group="link", level="WARN")
    warned = [RaisedWarning(3, "radio/ground", 11, T0 + 2.0, ["radio_lossy"], "it loses 40 %")]
    verdict = only(
        trial(injections=[slow], alarms=[], acts=[], warned=warned, lines=[line(2.5, "A03 WARN 11 radio loss")])
    )
    assert (verdict.detected_s, verdict.response_s, verdict.right, verdict.missed) == (2.0, 2.5, True, False)
    assert (verdict.expected, verdict.claimed_s) == (0, None)
    warned[0].ended = T0 + 5
    assert only(trial(injections=[slow], alarms=[], acts=[], warned=warned)).claimed_s == pytest.approx(5.0)


def test_a_stopped_phm_is_recovered_when_it_reports_the_suspension() -> None:
    """It reports that it was suspended: by then its watchdog has resumed it."""
    stopped = injection(
        unit="companion", condition="phm_suspended", layer="companion", group="phm", phm=True, level="WARN"
    )
    warned = [RaisedWarning(3, "companion", 1, T0 + 3.0, ["phm_suspended"], "it was suspended for 3 s")]
    verdict = only(trial(injections=[stopped], warned=warned, alarms=[], acts=[]))
    assert (verdict.claimed_s, verdict.by) == (3.0, "its own guard")
    assert verdict.ended_by == PHM


def test_a_problem_of_phm_that_lasts_is_not_over_with_its_report() -> None:
    """A log that cannot be written is reported while it lasts."""
    broken = injection(
        unit="companion", condition="phm_problem", layer="companion", group="companion", phm=True, level="WARN"
    )
    warned = [RaisedWarning(3, "companion", 1, T0 + 3.0, ["phm_problem"], "cannot write")]
    verdict = only(trial(injections=[broken], warned=warned, alarms=[], acts=[]))
    assert (verdict.detected_s, verdict.claimed_s) == (3.0, None)


def test_a_killed_phm_is_recovered_when_it_reports_again() -> None:
    """Its next run warns of the crash of the previous one; the first complete report counts as recovery, not the end of
    the warning.
    """
    gone = injection(
        unit="companion", condition="phm_restarted", layer="companion", group="phm", phm=True, level="WARN"
    )
    warned = [RaisedWarning(3, "companion", 1, T0 + 2.0, ["phm_restarted"], "it had ended without a word")]
    verdict = only(trial(injections=[gone], warned=warned, starts=[Start(3, T0 + 1.5, T0 + 3.0)], alarms=[], acts=[]))
    assert (verdict.detected_s, verdict.claimed_s, verdict.by, verdict.right) == (2.0, 3.0, "its own restart", True)


def test_a_failed_injection_is_not_scored() -> None:
    """Without a time of injection there is no verdict."""
    assert judge(trial(injections=[injection(moment=None, error="no such container")], alarms=[])).verdicts == []


@pytest.mark.parametrize(
    ("text", "system", "reported"),
    [
        ("A03 FAIL 6 node_1 dead", 3, True),
        ("A03 FAIL 11111011 6 node_1 dead +2", 3, True),
        ("A03 GAVE UP 6 node_1 dead", 3, True),
        ("A03 WARN 6 node_1 late", 3, False),
        ("A03 FAIL 2 ros_app exited", 3, False),
        ("A03 OK 6 node_1 restarted", 3, False),
        ("A03 OK 11111111", 3, False),
        ("A04 FAIL 6 node_1 dead", 4, False),
        ("A03 no GCS radio, received by A01 A02: 2 ERROR", 1, False),
    ],
)
def test_a_line_is_matched_to_its_fault(text: str, system: int, reported: bool) -> None:
    """By agent, bad level and slot: as a change or in the refresh. A WARN line does not match a fault with level ERROR."""
    made = line(1.0, text, system)
    assert (own(made, injection(), 6) or by_others(made, injection())) is reported


def test_a_lost_radio_is_reported_by_other_agents() -> None:
    """Neighbours report a link fault, since the agent itself cannot."""
    assert by_others(line(1.0, "A03 no GCS radio, received by A01 A02: 2 ERROR", 1), injection(layer="link"))


@pytest.mark.parametrize(
    ("fault", "by", "world", "ended_by"),
    [
        ({}, "restart", 3.5, ACTION),
        ({}, "itself", 3.5, ITSELF),
        ({}, "configuration", 3.5, ITSELF),
        ({"unit": "container/ros_app"}, "itself", 3.5, DOCKER),
        ({"passes": True}, "restart", 3.5, INJECTOR),
        ({}, "restart", 0.5, ITSELF),
        ({"unit": "container/ros_app"}, "restart", 0.5, DOCKER),
        ({"world_broken": T0 + 0.1}, "restart", 3.5, ACTION),
    ],
)
def test_a_fault_is_ended_by_an_action_or_by_its_world(
    fault: dict[str, Any], by: str, world: float, ended_by: str
) -> None:
    """Only an action counts as PHM's, and only if the world was not restored before any action began, and no timer of
    the injector was running.
    """
    one = injection(world=T0 + world, **fault)
    acts = [] if by != "restart" else [started(1.0, one.unit), verified(4.0, one.unit)]
    closed = alarm(0.4, one.unit, closed=T0 + 4, outcome="resolved", by=by)
    verdict = only(trial(injections=[one], alarms=[closed], acts=acts))
    assert (verdict.ended_by, verdict.by_action) == (ended_by, ended_by == ACTION)


def test_a_recovery_counts_when_the_world_confirms_it() -> None:
    """From the later of claim and observation; not without an observation, and not after the fault was cleared."""
    assert only(trial()).recovered_s == pytest.approx(4.0)
    late = only(trial(injections=[injection(world=T0 + 6)]))
    assert (late.recovered_s, late.difference_s, late.claimed_early) == (pytest.approx(6.0), pytest.approx(-2.0), True)
    for unconfirmed in (injection(world_seen=False, world=None), injection(world=None), injection(world=T0 + 21)):
        verdict = only(trial(injections=[unconfirmed]))
        assert (verdict.claimed_s, verdict.recovered_s, verdict.by_action) == (pytest.approx(4.0), None, False)
        assert verdict.ended_by == ACTION


def test_disagreements_in_both_directions() -> None:
    """PHM says that a fault is over and the world does not, or the other way round."""
    assert only(trial(injections=[injection(world=None)])).claimed_wrongly
    assert not only(trial(injections=[injection(world=None, world_seen=False)])).claimed_wrongly
    silent = only(trial(alarms=[alarm(0.4)], acts=[]))
    assert (silent.unnoticed, silent.claimed_wrongly) == (True, False)
    agreed = only(trial())
    assert (agreed.unnoticed, agreed.claimed_wrongly, agreed.claimed_early) == (False, False, False)


def test_the_definitions_of_the_paper() -> None:
    """Detection ends with the last step of the response in the log; response with the next periodic report."""
    reports_made = [
        Summary(3, T0 - 1, [NODE], T0 + 0.3),
        Summary(4, T0 + 1, [NODE], T0 + 1.2),
        Summary(3, T0 + 1, [], T0 + 1.5),
        Summary(3, T0 + 2, [NODE], T0 + 2.5),
    ]
    verdict = only(trial(summaries=reports_made))
    assert (verdict.detected_s, verdict.logged_s) == (pytest.approx(0.4), pytest.approx(4.0))
    assert (verdict.response_s, verdict.published_s) == (pytest.approx(0.9), pytest.approx(1.5))
    assert (verdict.published_due, verdict.listed_s) == (False, pytest.approx(2.5))
    reported_only = only(trial(acts=[], alarms=[alarm(0.4)]))
    assert (reported_only.logged_s, reported_only.published_s) == (pytest.approx(0.4), None)


def test_the_response_of_a_phm_that_was_killed_meanwhile_ends_with_its_claim() -> None:
    """The new process does not verify the action of the old one, so the log has no such step."""
    before = only(trial())
    interrupted = only(trial(acts=[started(0.5)]))
    assert interrupted.ended_by == before.ended_by == ACTION
    assert interrupted.logged_s == interrupted.claimed_s


def test_a_report_after_the_trial_counts_when_it_was_due() -> None:
    """Leaving it out would make the mean too small: only early reports would be in it."""
    before = [Summary(3, T0 - 6, [], T0 - 5)]
    verdict = only(trial(summaries=before, setting={"interval_s": 20.0}))
    assert (verdict.published_s, verdict.published_due, verdict.listed_s) == (pytest.approx(15.0), True, None)
    overdue = only(trial(summaries=[Summary(3, T0 - 31, [], T0 - 30)], setting={"interval_s": 20.0}))
    assert overdue.published_s == overdue.detected_s


def test_a_fault_explained_by_another_counts_as_reported() -> None:
    """One alarm at the cause reports both faults of an agent, and the explained one ends with it; its own alarm is one
    too many.
    """
    killed = injection(fault="container_killed", unit="container/ros_app", condition="exited")
    node = injection(explained_by="container_killed")
    raised = alarm(0.2, killed.unit, conditions=["exited"], closed=T0 + 5, outcome="resolved", by="start")
    made = trial(injections=[node, killed], alarms=[raised], acts=[verified(5.0, killed.unit, action="start")])
    explained, cause = judge(made).verdicts
    assert (explained.expected, explained.count, explained.missed, explained.right) == (0, 0, False, True)
    assert (explained.detected_s, explained.through_cause) == (None, True)
    assert (explained.claimed_s, explained.ended_by, explained.by_action) == (pytest.approx(5.0), ACTION, True)
    assert (cause.expected, cause.count, cause.through_cause) == (1, 1, False)
    made.alarms.append(alarm(0.4))
    explained, _ = judge(made).verdicts
    assert (explained.expected, explained.count) == (0, 1)
    made.alarms.clear()
    assert [each.missed for each in judge(made).verdicts] == [True, True]


def test_an_action_that_did_not_help_is_counted() -> None:
    """Verified: it helped. Followed by the next one, or failed: it did not. Ended by the campaign: neither."""

    def outcomes(*acts: Act) -> list[bool | None]:
        return [attempt.helped for attempt in attempts(trial(acts=list(acts)))]

    assert outcomes(started(1.0), verified(4.0)) == [True]
    assert outcomes(started(1.0), started(2.0), verified(4.0)) == [False, True]
    assert outcomes(started(1.0), Act(3, NODE, "restart", "failed", T0 + 2, "")) == [False]
    assert outcomes(started(1.0)) == [None]
    assert outcomes(started(1.0), verified(21.0)) == [None], "the campaign has cleared the fault before"
    assert outcomes(started(1.0), started(1.5, "network/ros_app"), verified(4.0)) == [True, None]
