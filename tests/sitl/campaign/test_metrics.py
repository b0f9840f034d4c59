"""Figures, uptime and targets, for hand-written and for drawn trials."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from phm.core.settings import RosSettings
from phm_checks import _graph_evidence, _node_activity
from sitl.campaign import uptime
from sitl.campaign.evidence import EXPLANATIONS, READ_S, SNAPSHOTS_S, UNEXPLAINED, compared
from sitl.campaign.fault_catalog import explained
from sitl.campaign.fault_rows import unexplained
from sitl.campaign.groups import groups
from sitl.campaign.metrics import figures
from sitl.campaign.sections import problems
from sitl.campaign.stats import estimate, rank, stats
from sitl.campaign.table import beyond, outside
from sitl.campaign.targets import METRICS, Result, evaluated, short
from sitl.campaign.trial import NOMINAL, OFF, Cost, Load, RaisedWarning, Start, Trial
from sitl.campaign.verdict import ACTION, FLOOR_S, ITSELF
from sitl.faults import all_faults
from tests.fakes.campaign_trials import T0, alarm, injection, trial

TIMES = st.lists(st.floats(0, 1000, allow_nan=False), min_size=1, max_size=50)
SPANS = st.lists(st.tuples(st.floats(-50, 150), st.floats(-50, 150)), max_size=6)


@given(TIMES)
def test_statistics_are_measured_values(values: list[float]) -> None:
    """p50 and p95 are values of the list, in order, and the mean lies within the bounds."""
    found = stats([*values, None])
    assert found.n == len(values)
    assert {found.p50, found.p95, found.max} <= set(values)
    assert found.p50 is not None and found.p95 is not None and found.max is not None and found.mean is not None
    assert min(values) <= found.p50 <= found.p95 <= found.max == max(values)
    assert found.mean == pytest.approx(math.fsum(values) / len(values))


def test_percentiles_by_nearest_rank() -> None:
    """The 95th of 20 values is the 19th; of one value it is that value."""
    ordered = [float(value) for value in range(1, 21)]
    assert (rank(ordered, 0.5), rank(ordered, 0.95), rank([7.0], 0.95)) == (10.0, 19.0, 7.0)
    assert stats([]).mean is None


@given(st.lists(st.floats(0, 100), max_size=40), st.floats(0.5, 5))
def test_gaps_are_the_overdue_time(heartbeats: list[float], period: float) -> None:
    """Overdue time begins one period after a heartbeat, ends with the next, and never overlaps."""
    found = uptime.gaps(heartbeats, period, 100.0)
    for start, end in found:
        assert any(math.isclose(start - period, heartbeat, abs_tol=1e-9) for heartbeat in heartbeats)
        assert end > start
    assert all(first[1] <= second[0] for first, second in pairwise(found))


def test_a_late_heartbeat_is_not_a_gap_and_a_lost_one_is() -> None:
    """Up to a tenth of a period is jitter; an overdue heartbeat counts from its due time."""
    assert uptime.gaps([0.0, 2.0, 4.15, 6.0], 2.0, 8.0) == []
    assert uptime.gaps([0.0, 2.0, 4.9, 7.0], 2.0, 8.0) == [(4.0, 4.9)]
    assert uptime.gaps([0.0, 2.0, 6.0], 2.0, 7.0) == [(4.0, 6.0)]
    assert uptime.gaps([0.0, 2.0], 2.0, 20.0) == [(4.0, 20.0)]


def test_an_outage_between_two_heartbeats_is_seen() -> None:
    """PHM killed and back within one period: down from the injection until its next heartbeat; a start that nothing
    explains: from the heartbeat before.
    """
    made = quiet(injections=[injection(agent=3, phm=True, moment=40.5, unit="")], starts=[Start(3, 41.2, 41.8)])
    assert uptime.of_agent(made, 3) == (pytest.approx(100), pytest.approx(1.5))
    crashed = quiet(starts=[Start(3, 41.2, 41.8)])
    assert uptime.of_agent(crashed, 3) == (pytest.approx(100), pytest.approx(2.0))
    assert uptime.of_agent(crashed, 4) == (pytest.approx(100), pytest.approx(0))


@given(SPANS, st.floats(0, 100), st.floats(0, 100))
def test_excluded_spans_are_subtracted_once(holes: list[tuple[float, float]], one: float, other: float) -> None:
    """The rest lies in the span and in no excluded span; its length is the span minus the union of the excluded ones."""
    span = (min(one, other), max(one, other))
    left = uptime.without(span, holes)
    covered = sorted((max(a, span[0]), min(b, span[1])) for a, b in holes if b > a)
    union, reached = 0.0, span[0]
    for start, end in covered:
        union += max(0.0, end - max(start, reached)) if end > reached else 0.0
        reached = max(reached, end)
    assert uptime.length(left) == pytest.approx(span[1] - span[0] - union, abs=1e-6)
    for start, end in left:
        assert not any(a < (start + end) / 2 < b for a, b in holes)


def quiet(kind: str = NOMINAL, seconds: float = 100.0, **more: object) -> Trial:
    heartbeats = {agent: [-2.0 + 2 * number for number in range(53)] for agent in range(1, 9)}
    made = Trial(kind, 1, 8, 0.0, 1.7e9, seconds, heartbeats=heartbeats, healthy_after=0.0)
    for name, value in more.items():
        setattr(made, name, value)
    return made


def test_uptime_of_a_killed_phm() -> None:
    """One of eight agents, silent for 8 s of 100 s, is down for the 6 s after its heartbeat was due."""
    made = quiet()
    made.heartbeats[3] = [heartbeat for heartbeat in made.heartbeats[3] if not 40 < heartbeat < 48]
    assert uptime.of_agent(made, 3) == (pytest.approx(100), pytest.approx(6))
    assert uptime.share([made]) == pytest.approx(1 - 6 / 800)


def test_a_cut_radio_does_not_count_as_a_dead_phm() -> None:
    """While the injector cuts an agent from the ground, its uptime is not measured; `received` counts it as silence."""
    made = quiet(blind=[(3, 40.5, 60.0)])
    made.heartbeats[3] = [heartbeat for heartbeat in made.heartbeats[3] if not 40 < heartbeat < 61]
    assert uptime.of_agent(made, 3) == (pytest.approx(100 - 21.5), pytest.approx(0))
    assert uptime.share([made]) == 1.0
    received_share = uptime.share([made], net=False)
    assert received_share is not None and received_share < 1.0


def test_an_agent_that_was_never_received_was_down() -> None:
    """No heartbeat at all means no uptime, and no measured time means no figure."""
    made = quiet()
    made.heartbeats = {}
    assert uptime.share([made]) == 0.0
    assert uptime.share([]) is None


def results(*trials: Trial) -> dict[str, Result]:
    """The metrics of the only group by name."""
    (group,) = groups(trials)
    return {each.metric.name: each for each in evaluated(group, [group])}


def test_the_figures_of_a_good_trial() -> None:
    """One fault, reported once, correctly, and recovered: every target that can be met is met."""
    costs = [Cost(agent, 100.0, 2.0, 70.0, 60.0, 90.0) for agent in range(1, 9)]
    made = [quiet(cost=costs, received=dict.fromkeys(range(1, 9), 2000)), quiet(OFF), trial()]
    found = figures(made)
    assert (found.injected, found.trials, found.missed, found.false, found.nominal_alarms) == (1, 1, 0, 0, 0)
    assert (found.alarms_per_fault, found.right, found.by_action, found.by_action_healable) == (1.0, 1.0, 1.0, 1.0)
    assert (found.cpu_nominal, found.bytes_nominal) == (pytest.approx(2.0), pytest.approx(20.0))
    assert (found.rss_mb, found.pss_mb, found.peak_mb, found.without_cost) == (70.0, 60.0, 90.0, 16)
    assert short(groups(made)) == []
    (one,) = found.classes
    assert (one.fault, one.by_action, one.alarms) == ("node_killed", 1, 1.0)


def test_missed_targets_are_reported() -> None:
    """Missed faults, chains, false alarms and changes with recovery off each miss a target."""
    missed = trial(number=2, alarms=[], acts=[], lines=[])
    chain = trial(alarms=[alarm(0.4), alarm(0.6, "rates/agent_3/topic_1")])
    lone = quiet(alarms=[alarm(5.0, "rates/agent_4/topic_1", 4)], ended=T0 + 40)
    found = results(lone, quiet(OFF, changed=["agent 1: restarted"]), missed, chain)
    names = {name for name, each in found.items() if each.met is False}
    assert {"Missed", "False alarms", "Cause reported correctly", "Changed with recovery off"} <= names
    assert {"By action, of the healable", "Self-resolved: by action, of all injected"} <= names
    assert found["Alarms per fault"].value == pytest.approx(2.0), "a missed fault does not make up for a chain"
    assert "Alarms per fault" in names


def test_only_a_confirmed_action_is_self_resolved() -> None:
    """Faults that something else has ended, and claims that nothing confirms, are in the denominator alone."""
    itself = [alarm(0.4, closed=T0 + 3, outcome="resolved", by="itself")]
    found = figures(
        [
            trial(number=1),
            trial(number=2, acts=[], alarms=itself),
            trial(number=3, injections=[injection(world_seen=False, world=None)]),
            trial(number=4, injections=[injection(healable=False)], acts=[], alarms=[alarm(0.4)]),
            trial(number=5, injections=[injection(moment=None)], alarms=[]),
        ]
    )
    assert (found.injected, found.not_injected, found.by_action, found.unconfirmed) == (4, 1, 0.25, 1)
    assert found.by_action_healable == pytest.approx(1 / 3)
    assert (found.endings[ACTION], found.endings[ITSELF], found.recovery.n, found.recovery_other.n) == (2, 1, 1, 2)


def test_the_targets_depend_on_profile_and_load() -> None:
    """As found: only a slower p95; busy: no more than twice the times of the same profile on a quiet machine."""

    def made(profile: str, load: str, after: float) -> Trial:
        setting = {"profile": profile, "load": load, "seed": 1}
        return trial(alarms=[alarm(after, closed=T0 + 4, outcome="resolved", by="restart")], setting=setting)

    found = groups([made("shipped", "busy", 0.9), made("as-found", "quiet", 5.0), made("shipped", "quiet", 0.4)])
    assert [group.name for group in found] == ["shipped, quiet", "as-found, quiet", "shipped, busy"]
    aims = [{each.metric.name: (each.aim, each.met) for each in evaluated(group, found)} for group in found]
    name = "Fault detection, p95"
    assert [each[name] for each in aims] == [
        ("<= 3.50 s", True),
        ("<= 6.00 s", True),
        ("<= twice quiet, by class (1 in both): 0.90 s of 0.80 s", False),
    ]
    assert aims[0]["Alarms per fault"] == ("1.00", True)
    assert aims[2]["Alarms per fault"] == ("<= 1.05", True)
    assert short(found) == [
        "shipped, busy: Fault detection, mean: 0.90 s, aim <= twice quiet, by class (1 in both): 0.90 s of 0.80 s",
        "shipped, busy: Fault detection, p95: 0.90 s, aim <= twice quiet, by class (1 in both): 0.90 s of 0.80 s",
    ]


def test_figures_over_seeds_have_an_interval() -> None:
    """The mean of the seeds' means, not of all faults, with Student's t; one seed has no interval."""
    seeds = [
        trial(number=number, alarms=[alarm(after)], setting={"seed": seed})
        for number, (seed, after) in enumerate([(1, 1.0), (1, 1.0), (1, 1.0), (2, 3.0)])
    ]
    (group,) = groups(seeds)
    found = group.mean(lambda each: each.detection.mean)
    assert found is not None
    assert (found.n, found.mean, found.least, found.most) == (2, pytest.approx(2.0), 1.0, 3.0)
    assert found.half == pytest.approx(12.706 * math.sqrt(2) / math.sqrt(2), rel=1e-3)
    single = estimate([2.0, None])
    assert single is not None
    assert (single.n, single.mean, single.half) == (1, 2.0, None)
    assert estimate([None]) is None


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30))
def test_the_interval_contains_the_mean_of_the_seeds(values: list[float]) -> None:
    """The mean lies between the smallest and the largest value; the width follows their deviation."""
    found = estimate(values)
    assert found is not None and found.half is not None and found.deviation is not None
    assert found.half >= 0
    assert min(values) - 1e-6 <= found.mean <= max(values) + 1e-6
    assert found.half <= 12.706 * found.deviation


def test_an_empty_campaign_meets_no_target() -> None:
    """Without trials there is no evidence."""
    assert groups([]) == []
    (group,) = groups([quiet()])
    rows = evaluated(group, [group])
    assert len(rows) == len(METRICS)
    assert {row.metric.name for row in rows if row.met is not None} == {"PHM uptime", "False alarms"}


def test_the_paper_would_not_meet_our_targets() -> None:
    """Each target is better than the figure of the paper's Table 2."""
    paper = trial(alarms=[alarm(5.2)], acts=[], lines=[], injections=[injection(healable=False)])
    names = {name for name, row in results(paper).items() if row.met is False}
    assert {"Fault detection, mean", "Self-resolved: by action, of all injected"} <= names


def test_detection_is_compared_with_its_evidence() -> None:
    """Mean detection divided by the limit; a class above twice its limit has an explanation or is listed."""
    node = injection(fault="not_explained", evidence="process event", evidence_s=0.0)
    slow = injection(fault="topic_silent", title="topic silent", evidence="missed period", evidence_s=0.1)
    unstated = injection(fault="other", title="other")
    alarms = [alarm(0.5)]
    made = [trial(number=n, injections=[each], alarms=alarms) for n, each in enumerate((node, slow, unstated))]
    (group,) = groups(made)
    rows = {each.title: each for each in compared(group.all)}
    assert rows["node killed"].ratio == pytest.approx(5.0), "a limit of zero counts as 0.1 s"
    assert rows["node killed"].words == UNEXPLAINED
    assert rows["topic silent"].words.startswith(EXPLANATIONS["topic_silent"].words)
    assert (rows["other"].ratio, rows["other"].words) == (None, "")
    (line,) = unexplained(group)
    assert "node killed is detected after 5.0 times its limit" in line


def test_periodic_evidence_counts_with_its_average() -> None:
    """It happens half a period earlier than at the latest, on average."""
    found = injection(fault="made_up", evidence="heartbeat", evidence_s=3.2, evidence_period_s=3.0)
    (group,) = groups([trial(injections=[found], alarms=[alarm(3.4)])])
    (row,) = compared(group.all)
    assert (row.latest_s, row.limit_s, row.ratio) == (3.2, pytest.approx(1.7), pytest.approx(2.0))


def test_an_outage_of_the_engine_hides_the_evidence_of_a_container() -> None:
    """Nothing on board can know what its files are before the engine is back. That it has ended shows in its cgroup."""
    alone = injection(fault="file_removed", agent=1, unit="files/a", group="files", evidence_s=0.1)
    beside = replace(alone, agent=3)
    ended = replace(beside, unit="container/a", group="container", condition="exited")
    away = injection(
        fault="engine_restarted", title="away", unit="engine", group="engine", evidence_s=0.3, outage_s=15.0
    )
    elsewhere = replace(away, agent=2)
    explained([alone, elsewhere, beside, ended, away])
    assert [each.hidden_s for each in (alone, beside, ended, away)] == [0.0, 15.0, 0.0, 0.0]
    made = [
        trial(number=1, injections=[alone], alarms=[alarm(0.2, unit="files/a", agent=1)]),
        trial(number=2, injections=[beside], alarms=[alarm(16.61, unit="files/a")]),
    ]
    (group,) = groups(made)
    (row,) = compared(group.all)
    assert row.ratio == pytest.approx((2.0 + 16.61 / 15.0) / 2), "its own limit is before the end of the outage"


def test_an_explanation_holds_up_to_its_ratio() -> None:
    """A class that is detected later than its explanation says is unexplained."""
    up_to = EXPLANATIONS["node_killed"].up_to
    for after, words in ((up_to / 10 - 0.01, str(EXPLANATIONS["node_killed"])), (up_to / 10 + 0.01, UNEXPLAINED)):
        found = injection(evidence="process event", evidence_s=0.1)
        (group,) = groups([trial(injections=[found], alarms=[alarm(after)])])
        assert compared(group.all)[0].words.endswith(words)
        assert len(unexplained(group)) == (words == UNEXPLAINED)


@pytest.mark.parametrize(
    ("alone_s", "words"),
    [
        (0.19, "1 of 2 disturbed, the others 1.9"),
        (0.5, f"1 of 2 disturbed, the others 5.0: {EXPLANATIONS['node_killed']}"),
        (0.9, UNEXPLAINED),
    ],
)
def test_what_disturbed_a_detection_explains_that_one_alone(alone_s: float, words: str) -> None:
    """The others must be within twice their limit, or within the explanation of their class."""
    found = [injection(evidence="process event", evidence_s=0.1) for _ in range(2)]
    busy = RaisedWarning(3, "host/cpu", 9, T0 + 1.0, ["cpu_high"], "CPU 92 %")
    made = [
        trial(number=1, injections=[found[0]], alarms=[alarm(9.0)], warned=[busy]),
        trial(number=2, injections=[found[1]], alarms=[alarm(alone_s)]),
    ]
    (group,) = groups(made)
    assert compared(group.all)[0].words == words


def test_a_class_that_was_only_disturbed_is_unexplained() -> None:
    """There is no other detection that shows what the class needs by itself."""
    found = injection(evidence="process event", evidence_s=0.1)
    busy = RaisedWarning(3, "host/cpu", 9, T0 + 1.0, ["cpu_high"], "CPU 92 %")
    (group,) = groups([trial(injections=[found], alarms=[alarm(9.0)], warned=[busy])])
    assert compared(group.all)[0].words == UNEXPLAINED


def test_the_earliest_possible_detection_is_that_of_the_detected_faults() -> None:
    """On average half a period before its latest moment; a fault that was missed has no part in it."""
    found = [
        injection(fault="made_up", evidence="beat", evidence_s=2.0, evidence_period_s=2.0),
        injection(fault="made_up", evidence="event", evidence_s=0.1),
        injection(fault="made_up", evidence="probe", evidence_s=30.0),
    ]
    made = [
        trial(number=number, injections=[each], alarms=[alarm(3.0)] if number < 3 else [])
        for number, each in enumerate(found, 1)
    ]
    (group,) = groups(made)
    assert group.all.evidence.mean == pytest.approx((1.0 + 0.1) / 2)


def test_the_load_of_the_machine_is_that_of_the_time_of_the_runs() -> None:
    loads = [
        Load(T0 - 2.0, 99.0, 1.0, 1.0, 0.0),
        Load(T0 + 1.0, 40.0, 1.0, 1.0, 0.0),
        Load(T0 + 2.0, 60.0, 1.0, 1.0, 0.0),
    ]
    (group,) = groups([trial(machine=loads)])
    (row,) = (row for row in beyond([group]) if row[0].startswith("Machine"))
    assert row[1] == "- / 50 %"


def test_interruptions_that_were_not_counted_are_no_zero() -> None:
    """Records of before 2026-11-25 do not have them."""

    def shown(*counts: int | None) -> str:
        made = [injection(interruptions=count, interrupted_s=0.5 * (count or 0)) for count in counts]
        (group,) = groups([trial(number=number, injections=[each]) for number, each in enumerate(made, 1)])
        (row,) = (row for row in outside([group]) if row[0].startswith("a restored world"))
        return row[1]

    assert [shown(None, None), shown(0, 0), shown(2, None, 1)] == ["not measured", "0, 0, 0.0", "2, 3, 1.5"]


def test_a_topic_may_pause_for_as_long_as_the_shipped_configuration_allows() -> None:
    """The explanation of its detection holds as long as that, two snapshots of the graph and the limit."""
    allowed_s = RosSettings().silence + SNAPSHOTS_S
    assert EXPLANATIONS["topic_silent"].up_to == pytest.approx((0.1 + allowed_s) / 0.1)


@pytest.mark.parametrize(
    ("fault", "measured_s"),
    [
        ("container_paused", 0.05),
        ("file_altered", 0.30),
        ("file_deleted", 0.26),
        ("file_not_executable", 0.29),
        ("memory_full", 0.4),
        ("network_disconnected", 0.07),
        ("network_lost_together", 0.2),
        ("power_loss", 3.1),
        ("radio_saturated", 0.8),
        ("sidecar_disconnected", 0.08),
        ("unhealthy", 1.94),
    ],
)
def test_no_limit_is_above_what_phm_measures(fault: str, measured_s: float) -> None:
    """PHM cannot know of a fault before the first evidence. A shorter limit than 0.1 s counts as that."""
    each = all_faults()[fault]
    assert each.evidence_s is not None
    assert each.evidence_s - each.evidence_period_s / 2 <= max(measured_s, FLOOR_S)


def test_the_loss_of_power_has_the_evidence_of_a_killed_phm() -> None:
    """Both end PHM at that moment."""
    lost, killed = all_faults()["power_loss"], all_faults()["phm_killed"]
    assert (lost.evidence, lost.evidence_s) == (killed.evidence, killed.evidence_s)


def test_a_hung_executor_is_explained_by_the_wait_that_applies_to_it() -> None:
    """It is reported as blocked before it is hung. The longer wait is for a busy machine; such a detection counts as disturbed."""
    longest_s = _node_activity.TURN_S + _graph_evidence.LATE_S + READ_S
    assert EXPLANATIONS["executor_deadlocked"].up_to == pytest.approx((0.1 + longest_s) / 0.1)


def test_what_is_unexplained_is_listed_for_every_profile_and_load() -> None:
    """The table of limits is of the first alone."""
    late = injection(evidence="process event", evidence_s=0.1)
    made = [
        trial(number=number, injections=[late], alarms=[alarm(9.0)], setting={"profile": profile, "load": "quiet"})
        for number, profile in enumerate(("shipped", "as-found"), 1)
    ]
    found = [line for line in problems(groups(made)) if line.endswith(UNEXPLAINED)]
    assert [line.split(":")[0] for line in found] == ["shipped, quiet", "as-found, quiet"]


def test_explanations_are_of_existing_faults() -> None:
    """A class that was renamed loses no explanation."""
    assert EXPLANATIONS.keys() <= all_faults().keys()
