"""Scoring: what belongs to a fault in time, and what is evidence of it."""

from __future__ import annotations

from typing import Any

import pytest

from sitl.campaign.event_collector import note
from sitl.campaign.fault_catalog import EXPLAINS, explained
from sitl.campaign.fault_rows import rare, remarks
from sitl.campaign.groups import groups
from sitl.campaign.metrics import figures
from sitl.campaign.scoring import judge
from sitl.campaign.table import beyond, endings, left_out, paper_comparison
from sitl.campaign.targets import short
from sitl.campaign.trial import Act, Cost, Injection, Load, RaisedWarning, Start, Trial
from sitl.campaign.verdict import ACTION, PHM, Verdict
from sitl.faults import all_faults
from tests.fakes.campaign_trials import NODE, T0, alarm, injection, line, started, trial, verified

POSSIBLE = "Self-resolved: largest share that the injected faults allow"


def only(made: Trial) -> Verdict:
    (verdict,) = judge(made).verdicts
    return verdict


def container() -> Injection:
    return injection(fault="container_killed", unit="container/ros_app", condition="exited", group="container")


def unhealthy() -> Injection:
    return injection(fault="unhealthy", unit="health/ros_app", condition="unhealthy", group="health")


def row(rows: list[tuple[str, ...]], name: str) -> str:
    (found,) = [each[1] for each in rows if each[0] == name]
    return found


def test_the_line_of_another_fault_does_not_report_this_one() -> None:
    """Engine, container and health checks share slot 2: a line counts from the detection, with its text."""
    alarms = [
        alarm(0.2, "container/ros_app", slot=2, conditions=["exited"], brief="ros_app exited 137"),
        alarm(15.3, "health/ros_app", slot=2, conditions=["unhealthy"], brief="ros_app unhealthy"),
    ]
    lines = [
        line(0.4, "A03 FAIL 2 ros_app exited 137"),
        line(15.4, "A03 FAIL 10111111 2 ros_app exited 137 +1"),
        line(15.9, "A03 FAIL 2 ros_app unhealthy"),
    ]
    first, second = judge(trial(injections=[container(), unhealthy()], alarms=alarms, lines=lines)).verdicts
    assert (first.response_s, second.response_s) == (pytest.approx(0.4), pytest.approx(15.9))
    lone = trial(injections=[unhealthy()], alarms=[alarm(15.3, "health/ros_app", slot=2)], lines=lines[:1])
    assert only(lone).response_s is None, "a line before the detection"


def test_a_line_may_be_cut_and_its_value_may_change() -> None:
    """A long text is cut in its middle, the refresh has a newer value, and GAVE UP has the number of the fault."""
    disk = injection(unit="host/disk", condition="disk_full", group="host")
    raised = alarm(0.7, "host/disk", slot=9, conditions=["disk_full"], brief="disk /tmp 97 %")
    lines = [line(1.0, "A03 FAIL 11111111 9 CPU 100 % +1"), line(2.0, "A03 FAIL 11111111 9 disk /tmp 98 % +1")]
    assert only(trial(injections=[disk], alarms=[raised], lines=lines)).response_s == pytest.approx(2.0)
    brief = "ros_app not connected to a-network-with-a-long-name"
    cut = [
        alarm(0.2, "container/ros_app", slot=2, brief="ros_app exited 137"),
        alarm(0.5, "health/ros_app", slot=2, conditions=["unhealthy"], brief=brief),
    ]
    lines = [line(1.0, "A03 FAIL 2 ros_app exited 137"), line(3.0, "A03 GAVE UP 2 ros_app not co..a-long-name #17")]
    assert only(trial(injections=[unhealthy()], alarms=cut, lines=lines)).response_s == pytest.approx(3.0)


def test_another_agent_may_report_a_fault_first() -> None:
    """The peers' own line about a lost one counts since the injection, its own only since its detection."""
    gone = injection(unit="peers/swarm", others="peers/A03", condition="all_peers_lost", layer="link", group="link")
    alarms = [alarm(10.0, "peers/swarm", slot=12, conditions=["all_peers_lost"]), alarm(8.0, "peers/A03", 1, slot=12)]
    lines = [line(5.0, "A03 FAIL 12 alone"), line(8.5, "A01 FAIL 12 A03 lost", 1)]
    assert only(trial(injections=[gone], alarms=alarms, lines=lines)).response_s == pytest.approx(8.5)


def test_nothing_after_clearing_is_a_detection_or_a_response() -> None:
    """A WARN, a start of PHM and a line after the fault was cleared are consequences of clearing."""
    slow = injection(unit="radio/ground", condition="radio_lossy", layer="link", group="link", level="WARN")
    warned = [RaisedWarning(3, "radio/ground", 11, T0 + 20.5, ["radio_lossy"], "it loses 40 %")]
    judged = judge(trial(injections=[slow], alarms=[], acts=[], warned=warned, lines=[]))
    assert (judged.verdicts[0].missed, judged.verdicts[0].detected_s) == (True, None)
    assert [each.unit for each in judged.clearing] == ["radio/ground"]
    (group,) = groups([judged.trial])
    assert row(left_out([group]), "alarms and warnings: caused by clearing") == "1"
    gone = injection(unit="", condition="", layer="companion", group="companion", phm=True)
    late = only(trial(injections=[gone], alarms=[], acts=[], starts=[Start(3, T0 + 21, T0 + 22)]))
    assert (late.missed, late.detected_s, late.claimed_s) == (True, None, None)
    back = only(trial(injections=[gone], alarms=[], acts=[], starts=[Start(3, T0 + 2)], lines=[line(20.5, "A03 OK 1")]))
    assert (back.detected_s, back.response_s) == (2.0, None)
    assert only(trial(lines=[line(20.5, "A03 FAIL 6 node_1 dead")])).response_s is None


def test_a_world_never_seen_broken_confirms_nothing() -> None:
    """It was as before in every observation, so it shows no recovery: not self-resolved, and counted apart."""
    unseen = trial(injections=[injection(world_broken=None, world=T0 + 0.2)])
    verdict = only(unseen)
    assert (verdict.ended_by, verdict.by_action, verdict.recovered_s) == (ACTION, False, None)
    found = figures([unseen])
    assert (found.by_action, found.unconfirmed, found.never_broken) == (0.0, 1, 1)
    (group,) = groups([unseen])
    assert row(endings([group]), "of these, the world was never seen broken") == "1 (100.0 %)"


def test_a_warning_does_not_report_an_error() -> None:
    """A fault that must be ERROR and was WARN only is missed."""
    warned = [RaisedWarning(3, NODE, 6, T0 + 2.0, ["node_missing"], "late")]
    verdict = only(trial(alarms=[], acts=[], warned=warned, lines=[line(2.5, "A03 WARN 6 node_1 late")]))
    assert (verdict.missed, verdict.right, verdict.detected_s) == (True, False, None)
    assert figures([trial(number=1), trial(number=2, alarms=[], acts=[], warned=warned)]).alarms_per_fault == 1.0


def test_a_missing_alarm_does_not_compensate_for_one_too_many() -> None:
    """The excess is of each fault; alarms that were not raised have a row and a separate remark."""
    both = injection(also=["files/ros_app"])
    lacking = trial(number=1, injections=[both])
    chain = trial(number=2, alarms=[alarm(0.4), alarm(0.6, "rates/agent_3/topic_1")])
    found = figures([lacking, chain])
    assert found.alarms_per_fault == pytest.approx((2 + 1 + 1) / 3)
    assert found.lacking == 1
    judged = judge(lacking)
    assert "no alarm at files/ros_app" in remarks(judged, judged.verdicts[0])
    (group,) = groups([lacking, chain])
    assert row(beyond([group]), "Faults with fewer alarms than expected") == "1"


def test_a_lost_peer_without_a_report_of_others_lacks_an_alarm() -> None:
    """The other agents have to report it, too."""
    gone = injection(unit="peers/swarm", others="peers/A03", condition="all_peers_lost", layer="link", group="link")
    judged = judge(
        trial(injections=[gone], alarms=[alarm(10.0, "peers/swarm", conditions=["all_peers_lost"])], acts=[])
    )
    (verdict,) = judged.verdicts
    assert verdict.lacking == ["peers/A03"]
    assert "no alarm at peers/A03" in remarks(judged, verdict)


@pytest.mark.parametrize(
    ("world", "closed", "missed"), [(None, True, True), (T0 + 5, True, False), (None, False, False)]
)
def test_an_explained_fault_must_end_with_its_cause(world: float | None, closed: bool, missed: bool) -> None:
    """When the cause is over and the world of the explained fault is not restored, nothing has reported that one."""
    raised = alarm(0.2, "container/ros_app", conditions=["exited"])
    acts = [started(1.0, "container/ros_app"), verified(6.0, "container/ros_app")] if closed else []
    node = injection(explained_by="container_killed", world=world)
    cause = container()
    cause.world = T0 + 5 if closed else None
    explained_one, _ = judge(trial(injections=[node, cause], alarms=[raised], acts=acts)).verdicts
    assert (explained_one.missed, explained_one.right) == (missed, not missed)
    assert explained_one.through_cause is not missed
    assert explained_one.by_action is (closed and not missed)


def test_a_network_does_not_explain_a_dead_node() -> None:
    """The reconnection of a network brings no process back."""
    lost = injection(fault="network_disconnected", unit="network/ros_app", group="network")
    node = injection(group="nodes")
    explained([lost, node])
    assert node.explained_by == ""
    assert EXPLAINS["container"] >= {"nodes", "topics", "health"}


def test_an_alarm_before_the_fault_does_not_detect_it() -> None:
    """A side effect of the injection at the fault's own unit: listed, and neither a detection nor a recovery."""
    late = injection(asked=T0 - 2)
    early = alarm(-0.5, closed=T0 - 0.1, outcome="resolved", by="itself")
    judged = judge(trial(injections=[late], alarms=[early], acts=[]))
    (verdict,) = judged.verdicts
    assert (verdict.detected_s, verdict.claimed_s, verdict.missed) == (None, None, True)
    assert judged.false == []
    assert "before the fault: nodes/agent_3/node_1" in remarks(judged, verdict)
    again = only(trial(injections=[late], alarms=[early, alarm(0.4)], acts=[]))
    assert (again.detected_s, again.claimed_s, again.count) == (pytest.approx(0.4), None, 2)


def test_a_reboot_may_open_a_silent_autopilot_first() -> None:
    """PHM knows the reboot only when the autopilot sends again: one alarm, of either condition."""
    fault = all_faults()["autopilot_reboot"]
    assert (fault.condition, fault.earlier, fault.level) == ("autopilot_rebooted", "autopilot_silent", "WARN")
    given: dict[str, Any] = {"unit": "autopilot", "condition": fault.condition, "earlier": fault.earlier}
    reboot = injection(level="WARN", passes=True, healable=False, layer="link", group="autopilot", **given)
    silent = alarm(3.5, "autopilot", slot=10, conditions=["autopilot_silent"])
    warned = [RaisedWarning(3, "autopilot", 10, T0 + 6.5, ["autopilot_rebooted"], "it has rebooted")]
    judged = judge(trial(injections=[reboot], alarms=[silent], acts=[], warned=warned))
    (verdict,) = judged.verdicts
    assert (verdict.count, verdict.expected, verdict.right, verdict.detected_s) == (1, 1, True, 3.5)
    assert only(trial(injections=[reboot], alarms=[silent], acts=[], warned=[])).right
    at_once = only(trial(injections=[reboot], alarms=[], acts=[], warned=warned))
    assert (at_once.right, at_once.lacking, at_once.detected_s) == (True, [], 6.5)


@pytest.mark.parametrize(("cpu", "beside"), [(92.0, 0), (99.0, 1)])
def test_load_must_reach_the_limit_of_the_alarm(cpu: float, beside: int) -> None:
    """An alarm is an ERROR, so load at the limit for WARN does not confirm it."""
    samples = [Load(T0 - 2 + second, cpu=cpu, memory=50.0, disk=50.0) for second in range(3)]
    judged = judge(trial(alarms=[alarm(0.4), alarm(0.5, "host/cpu", 5)], machine=samples))
    assert (len(judged.beside), len(judged.false)) == (beside, 1 - beside)


@pytest.mark.parametrize(
    ("cpu", "beside"),
    [
        ([60.0, 100.0, 96.9, 100.0, 60.0], 1),
        ([60.0, 100.0, 100.0, 96.0, 96.0, 60.0], 0),
        ([100.0, 100.0, *[60.0] * 6], 0),
        ([60.0, *[97.0, 100.0] * 5], 1),
        ([60.0, *[96.0, 99.0] * 5], 0),
    ],
    ids=["between samples", "before the window", "long before", "mean of 10 s", "mean below the limit"],
)
def test_load_is_the_mean_over_the_window_of_the_check(cpu: list[float], beside: int) -> None:
    """`host/cpu` is about the last 2 or 10 s: a sample beside the limit in them does not refute it, and earlier load does not confirm
    it."""
    end = T0 + 0.5
    samples = [Load(end - len(cpu) + 1 + second, used, 50.0, 50.0) for second, used in enumerate(cpu)]
    judged = judge(trial(alarms=[alarm(0.4), alarm(0.5, "host/cpu", 5)], machine=samples))
    assert (len(judged.beside), len(judged.false)) == (beside, 1 - beside)


def cpu_warning(agent: int, begun: float, ended: float | None) -> RaisedWarning:
    return RaisedWarning(
        agent, "host/cpu", 9, T0 + begun, ["cpu_high"], "CPU 92 %", None if ended is None else T0 + ended
    )


def action(unit: str, *phases: tuple[str, float]) -> list[Act]:
    return [Act(3, unit, "restart", phase, T0 + at, "") for phase, at in phases]


@pytest.mark.parametrize(
    ("recorded", "disturbed"),
    [
        ({}, False),
        ({"warned": [cpu_warning(3, 0.2, None)]}, True),
        ({"warned": [cpu_warning(3, -9.0, 0.1)]}, True),
        ({"warned": [cpu_warning(3, -9.0, -0.1)]}, False),
        ({"warned": [cpu_warning(3, 0.5, 9.0)]}, False),
        ({"warned": [cpu_warning(5, 0.2, None)]}, False),
        ({"alarms": [alarm(0.4), alarm(0.2, unit="engine")]}, True),
        ({"alarms": [alarm(0.4), alarm(0.2, unit="files/app")]}, False),
        ({"acts": action("container/app", ("started", -1.0), ("done", -0.5), ("verified", 0.1))}, True),
        ({"acts": action("container/app", ("started", -9.0), ("done", -8.0), ("failed", -0.1))}, False),
        ({"acts": action(NODE, ("started", 0.5), ("verified", 2.0))}, False),
    ],
)
def test_a_fault_is_disturbed_by_what_its_agent_did_before_the_detection(
    recorded: dict[str, Any], disturbed: bool
) -> None:
    """A busy CPU or no engine as PHM of that agent reported it, or an action there for another fault, after the injection and before the
    alarm."""
    assert only(trial(**{"alarms": [alarm(0.4)], "acts": [], **recorded})).disturbed is disturbed


def test_a_class_that_could_not_be_injected_is_listed() -> None:
    """It was injected fewer than three times: never."""
    failed = injection(fault="disk_full", title="disk full", moment=None, error="no such disk")
    (group,) = groups([trial(), trial(number=2, injections=[failed], alarms=[], acts=[])])
    assert [(each.title, each.injected) for each in group.all.classes] == [("disk full", 0), ("node killed", 1)]
    assert "campaign: disk full: 0" in rare([group])


def test_the_largest_possible_share_is_beside_the_self_resolved() -> None:
    """Faults that no action can end are in the denominator: of PHM, ended by a timer, and those left to an operator."""
    gone = injection(unit="", condition="", phm=True)
    faults = [injection(), injection(healable=False), injection(passes=True), gone]
    (group,) = groups([trial(number=number, injections=[each]) for number, each in enumerate(faults)])
    assert group.all.by_action_possible == 0.25
    names = [each[0] for each in paper_comparison([group])]
    assert names.index(POSSIBLE) == names.index("Self-resolved: by action, of all injected") + 1


def test_the_aims_of_the_cost_are_those_of_the_project() -> None:
    """2.5 % of a core, and a proportional share of 75 MB, where it was measured."""
    cost = [Cost(agent, 100.0, 2.7, 70.0, 80.0, 90.0) for agent in range(1, 9)]
    assert {"Sidecar, CPU of one core, all runs: 2.70 %, aim <= 2.5 %", "Sidecar, PSS, mean: 80 MB, aim <= 75 MB"} <= {
        each.removeprefix("campaign: ") for each in short(groups([trial(cost=cost)]))
    }
    unknown = [Cost(agent, 100.0, 2.0, 70.0) for agent in range(1, 9)]
    assert not any("PSS" in each for each in short(groups([trial(cost=unknown)])))


def test_the_text_of_a_line_is_in_the_record() -> None:
    """Alarms and warnings have the text of their STATUSTEXT: the check's, or else the unit."""
    made = trial(alarms=[], acts=[])
    event = {"unit": NODE, "slot": 6, "fault": "f", "mono": T0 + 1, "condition": "node_missing", "summary": "dead"}
    note(made, 3, {**event, "event": "fault_opened", "brief": "node_1 dead"})
    note(made, 3, {**event, "event": "transition", "old": "OK", "level": "WARN", "brief": ""})
    assert [each.brief for each in made.alarms] == ["node_1 dead"]
    assert [each.brief for each in made.warned] == [NODE]


def test_a_phm_that_came_back_unreported_is_back() -> None:
    """It did not warn of its own end, so the fault is missed; its complete report still ends it."""
    gone = injection(unit="companion", condition="phm_restarted", layer="companion", phm=True, level="WARN")
    verdict = only(trial(injections=[gone], alarms=[], acts=[], starts=[Start(3, T0 + 1.5, T0 + 3)]))
    assert (verdict.missed, verdict.claimed_s, verdict.ended_by) == (True, 3.0, PHM)


@pytest.mark.parametrize("renewed", [False, None])
def test_an_alarm_after_a_clearing_that_changed_nothing_counts(renewed: bool | None) -> None:
    """The fault was over, so it is damage of the recovery: one alarm too many, and neither a detection nor false."""
    faults = [injection(renewed=renewed)]
    judged = judge(trial(injections=faults, alarms=[alarm(0.4), alarm(26.0, "consensus")]))
    (verdict,) = judged.verdicts
    assert (judged.clearing, judged.false, verdict.excess, verdict.detected_s) == ([], [], 1, pytest.approx(0.4))
    assert any("after it was cleared" in each and "consensus" in each for each in remarks(judged, verdict))
    assert figures([judged.trial]).alarms_per_fault == 2.0
    again = judge(trial(injections=faults, alarms=[alarm(0.4), alarm(26.0)]))
    assert (again.clearing, again.verdicts[0].excess) == ([], 1), "its own unit, where the world was restored before"
    missed = only(trial(injections=faults, alarms=[alarm(26.0, "consensus")], acts=[]))
    assert (missed.missed, missed.excess) == (True, 1)
    assert figures([trial(injections=faults, alarms=[alarm(26.0)], acts=[]), trial(number=2)]).alarms_per_fault == 2.0


def test_what_clearing_has_ended_may_be_reported_at_its_own_unit() -> None:
    """E.g. a clock that is set back steps again: the world was not restored before."""
    judged = judge(trial(injections=[injection(world=None)], alarms=[alarm(0.4), alarm(21.0)]))
    assert ([each.unit for each in judged.clearing], judged.verdicts[0].excess) == ([NODE], 0)


@pytest.mark.parametrize("last", [False, True])
def test_an_alarm_belongs_to_the_fault_that_causes_it(last: bool) -> None:
    """A blocked network silences topics, a missing file does not, whichever was injected first (as found, seed 4, trial 5)."""
    file = injection(fault="file_deleted", unit="files/ros_app", condition="file_missing", group="files")
    blocked = injection(
        fault="transport_blocked", unit="network/ros_app", condition="transport_blocked", group="network"
    )
    silent = [alarm(3.5, f"rates/agent_3/topic_{number}", conditions=["topic_silent"]) for number in (1, 2, 3)]
    alarms = [alarm(0.5, "files/ros_app", conditions=["file_missing"]), *silent]
    judged = judge(trial(injections=[file, blocked] if last else [blocked, file], alarms=alarms, acts=[]))
    found = {each.injection.fault: each for each in judged.verdicts}
    assert (found["file_deleted"].excess, found["file_deleted"].right) == (0, True)
    assert (found["transport_blocked"].missed, found["transport_blocked"].count) == (False, 3)
    assert found["transport_blocked"].wrong.startswith("reported at rates/agent_3/topic_1")
