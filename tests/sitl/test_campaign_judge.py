"""How a trial's record is judged: each rule of docs/development/campaign.md by name."""

from __future__ import annotations

import pytest

from sitl.campaign.scoring import Verdict, judge, reports
from sitl.campaign.trial import OFF, Start, Trial, Warned
from tests.fakes.campaign_trials import NODE, T0, alarm, injection, line, trial, verified


def only(made: Trial) -> Verdict:
    (verdict,) = judge(made).verdicts
    return verdict


def test_times_count_from_the_injection() -> None:
    """Logged, received at the ground, proven: each minus the injector's moment."""
    verdict = only(trial())
    assert verdict.detected_s == pytest.approx(0.4)
    assert verdict.response_s == pytest.approx(0.9)
    assert verdict.healed_s == pytest.approx(4.0)
    assert (verdict.by, verdict.count, verdict.right, verdict.missed) == ("restart", 1, True, False)


def test_what_is_never_told_is_missed() -> None:
    """No alarm of its own: missed, and neither right nor healed."""
    verdict = only(trial(alarms=[], acts=[], lines=[]))
    assert (verdict.missed, verdict.right, verdict.healed_s) == (True, False, None)


def test_an_alarm_before_the_injection_is_false() -> None:
    """What was told before the fault was there cannot be about it."""
    judged = judge(trial(alarms=[alarm(-0.5), alarm(0.4)]))
    assert [each.mono for each in judged.false] == [T0 - 0.5]


def test_what_the_injector_does_on_the_way_belongs_to_its_fault() -> None:
    """A restart that is needed to cause a fault may be told before the fault is there: that is no false alarm, but a wrong cause."""
    late = injection(asked=T0 - 2)
    judged = judge(trial(injections=[late], alarms=[alarm(-0.5, "container/ros_app"), alarm(0.4)]))
    assert (judged.false, judged.verdicts[0].count) == ([], 2)
    assert judged.verdicts[0].wrong == f"reported at container/ros_app first, then at {NODE}"


def test_what_clearing_breaks_is_not_the_faults() -> None:
    """A restart by which a fault is cleared may be told: listed, and counted for neither the fault nor as false."""
    judged = judge(trial(alarms=[alarm(0.4), alarm(20.5, "container/ros_app")]))
    assert (judged.verdicts[0].count, judged.false, [each.unit for each in judged.clearing]) == (
        1,
        [],
        ["container/ros_app"],
    )


def test_an_alarm_aboard_another_agent_is_false() -> None:
    """Where nothing was injected there is nothing to tell."""
    judged = judge(trial(alarms=[alarm(0.4), alarm(0.5, "rates/agent_4/topic_1", 4)]))
    assert [each.agent for each in judged.false] == [4]
    assert judged.verdicts[0].count == 1


def test_the_load_of_the_machine_is_nobodys_fault() -> None:
    """host/* is told by whoever sees it, unless it is what was injected."""
    judged = judge(trial(alarms=[alarm(0.4), alarm(1.0, "host/cpu", 5)]))
    assert (len(judged.beside), judged.false) == (1, [])
    hog = injection(unit="host/cpu", condition="cpu_busy", group="host")
    judged = judge(trial(injections=[hog], alarms=[alarm(1.0, "host/cpu", conditions=["cpu_busy"])]))
    assert (judged.beside, judged.verdicts[0].right) == ([], True)


def test_a_chain_is_counted_and_wrong_where_it_began() -> None:
    """A second alarm aboard the victim belongs to the fault; one before the cause makes the cause wrong."""
    topic = alarm(0.2, "rates/agent_3/topic_1")
    verdict = only(trial(alarms=[alarm(0.4), topic]))
    assert verdict.count == 2
    assert verdict.wrong == f"reported at rates/agent_3/topic_1 first, then at {NODE}"
    later = only(trial(alarms=[alarm(0.4), alarm(0.6, "rates/agent_3/topic_1")]))
    assert (later.count, later.wrong) == (2, "")


def test_told_elsewhere_alone_is_a_wrong_cause_and_not_missed() -> None:
    """PHM said something, but not where the cause is."""
    verdict = only(trial(alarms=[alarm(0.4, "network/ros_app")]))
    assert (verdict.missed, verdict.detected_s) == (False, None)
    assert verdict.wrong == f"reported at network/ros_app, expected at {NODE}"


def test_the_condition_must_have_been_known() -> None:
    """The right unit for the wrong reason is a wrong cause; it may become the right one while the fault lasts."""
    assert (
        only(trial(alarms=[alarm(0.4, conditions=["node_hung"])])).wrong == "known as node_hung, expected node_missing"
    )
    assert only(trial(alarms=[alarm(0.4, conditions=["node_hung", "node_missing"])])).right


def test_healed_only_before_it_was_cleared() -> None:
    """What the injector undid is not what PHM healed; closed as resolved counts where no proof was needed."""
    assert only(trial(acts=[verified(25.0)], alarms=[alarm(0.4)])).healed_s is None
    itself = alarm(0.4, closed=T0 + 3, outcome="resolved", by="itself")
    verdict = only(trial(acts=[], alarms=[itself]))
    assert (verdict.healed_s, verdict.by) == (pytest.approx(3.0), "itself")
    assert only(trial(acts=[], alarms=[alarm(0.4, closed=T0 + 3, outcome="reattributed")])).healed_s is None


def test_a_trial_that_still_runs_can_be_judged() -> None:
    """While nothing is cleared and the end is not known, what is healed is healed."""
    assert only(trial(injections=[injection(cleared=None)], ended=0.0)).healed_s == pytest.approx(4.0)


def test_nothing_is_healed_with_recovery_off() -> None:
    """In that run the only question is whether anything changed."""
    made = trial()
    made.kind = OFF
    assert only(made).healed_s is None


def test_several_units_are_several_alarms() -> None:
    """A fault that breaks two independent things is due two alarms, and healed when both are."""
    both = injection(also=["files/ros_app"])
    verdict = only(trial(injections=[both], alarms=[alarm(0.4), alarm(2.0, "files/ros_app")]))
    assert (verdict.expected, verdict.count, verdict.healed_s) == (2, 2, None)
    acts = [verified(4.0), verified(5.0, "files/ros_app", action="restore_file")]
    verdict = only(trial(injections=[both], alarms=[alarm(0.4), alarm(2.0, "files/ros_app")], acts=acts))
    assert (verdict.healed_s, verdict.by) == (pytest.approx(5.0), "restart, restore_file")


def test_compound_faults_each_keep_their_own_alarms() -> None:
    """Alarms go to the fault aboard their agent; on one agent to the one of their group."""
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


def test_a_lost_peer_is_one_alarm_though_all_tell_it() -> None:
    """Seven agents that miss the same one say one thing, beside what it says itself; said twice by one of them it is two."""
    gone = injection(
        unit="peers/swarm", others="peers/A03", condition="alone", layer="link", group="link", healable=False
    )
    alone = alarm(10.0, "peers/swarm", slot=12, conditions=["alone"])
    told = [alarm(10.0 + agent / 10, "peers/A03", agent, slot=12, conditions=["peer_lost"]) for agent in (1, 2, 4)]
    made = trial(injections=[gone], alarms=[alone, *told], acts=[], lines=[line(11.0, "A01 FAIL 12 A03 lost", 1)])
    verdict = only(made)
    assert (verdict.expected, verdict.count, verdict.right, judge(made).false) == (2, 2, True, [])
    assert (verdict.detected_s, verdict.response_s) == (pytest.approx(10.0), pytest.approx(11.0))
    made.alarms.append(alarm(19.0, "peers/A03", 1))
    assert only(made).count == 3


def test_a_lost_peer_where_no_link_was_touched_is_false() -> None:
    """A killed node takes no peer away."""
    assert len(judge(trial(alarms=[alarm(0.4), alarm(5.0, "peers/A03", 1)])).false) == 1


def test_phm_itself_is_back_when_it_says_so() -> None:
    """A fault told nowhere: its next life begins with a line, and is whole with the first report."""
    gone = injection(unit="", condition="", layer="companion", group="phm", phm=True)
    back = {"starts": [Start(3, T0 + 1.5, T0 + 3.0)], "lines": [line(3.5, "A03 OK 11111111")], "alarms": [], "acts": []}
    verdict = only(trial(injections=[gone], **back))
    assert (verdict.detected_s, verdict.response_s, verdict.healed_s) == (1.5, 3.5, 3.0)
    assert (verdict.expected, verdict.count, verdict.missed, verdict.right) == (0, 0, False, True)
    assert only(trial(injections=[gone], alarms=[], acts=[], lines=[])).missed


def test_a_warning_is_a_detection_where_a_warning_is_due() -> None:
    """Faults that are WARN open no fault; the transition counts."""
    slow = injection(unit="radio/ground", condition="radio_lossy", layer="link", group="link", level="WARN")
    warned = [Warned(3, "radio/ground", 11, T0 + 2.0, ["radio_lossy"], "it loses 40 %")]
    verdict = only(
        trial(injections=[slow], alarms=[], acts=[], warned=warned, lines=[line(2.5, "A03 WARN 11 radio loss")])
    )
    assert (verdict.detected_s, verdict.response_s, verdict.right, verdict.missed) == (2.0, 2.5, True, False)
    assert (verdict.expected, verdict.healed_s) == (0, None)
    warned[0].ended = T0 + 5
    assert only(trial(injections=[slow], alarms=[], acts=[], warned=warned)).healed_s == pytest.approx(5.0)


def test_a_stopped_phm_is_healed_when_it_can_say_so() -> None:
    """What it tells is that it had stood still: by then its guard has let it go on."""
    stopped = injection(
        unit="companion", condition="phm_suspended", layer="companion", group="phm", phm=True, level="WARN"
    )
    warned = [Warned(3, "companion", 1, T0 + 3.0, ["phm_suspended"], "it had stood still for 3 s")]
    verdict = only(trial(injections=[stopped], warned=warned, alarms=[], acts=[]))
    assert (verdict.healed_s, verdict.by) == (3.0, "its own guard")


def test_a_killed_phm_is_healed_when_it_reports_again() -> None:
    """Its next life warns of the death of the one before; healed is the first complete report, not the end of the warning."""
    gone = injection(
        unit="companion", condition="phm_restarted", layer="companion", group="phm", phm=True, level="WARN"
    )
    warned = [Warned(3, "companion", 1, T0 + 2.0, ["phm_restarted"], "it had ended without a word")]
    verdict = only(trial(injections=[gone], warned=warned, starts=[Start(3, T0 + 1.5, T0 + 3.0)], alarms=[], acts=[]))
    assert (verdict.detected_s, verdict.healed_s, verdict.by, verdict.right) == (2.0, 3.0, "its own restart", True)


def test_what_could_not_be_injected_is_not_judged() -> None:
    """No moment, no verdict."""
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
        ("A03 no GCS radio, heard by A01 A02: 2 ERROR", 1, False),
    ],
)
def test_which_lines_tell_of_a_fault(text: str, system: int, reported: bool) -> None:
    """Its agent, a bad word, its slot: as a change or in the refresh. A warning tells of no fault that is an error."""
    assert reports(line(1.0, text, system), injection(), 6) is reported


def test_who_has_lost_its_radio_is_told_by_others() -> None:
    """Of a link fault the neighbours may tell, since the agent cannot."""
    assert reports(line(1.0, "A03 no GCS radio, heard by A01 A02: 2 ERROR", 1), injection(layer="link"), 1)
