"""Figures, uptime and targets, for hand-written and for drawn trials."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from sitl.campaign import uptime
from sitl.campaign.metrics import figures, rank, stats
from sitl.campaign.targets import AIMS, judged, short
from sitl.campaign.trial import NOMINAL, OFF, Cost, Trial
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
    """Up to 1.5 periods is jitter; a lost heartbeat counts from its due time."""
    assert uptime.gaps([0.0, 2.0, 4.9, 7.0], 2.0, 8.0) == []
    assert uptime.gaps([0.0, 2.0, 6.0], 2.0, 7.0) == [(4.0, 6.0)]
    assert uptime.gaps([0.0, 2.0], 2.0, 20.0) == [(4.0, 20.0)]


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
    made = Trial(kind, 1, 8, 0.0, 1.7e9, seconds, heartbeats=heartbeats, well_after=0.0)
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
    """While the injector cuts an agent from the ground, its uptime is not measured; `heard` counts it as silence."""
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


def test_the_figures_of_a_good_trial() -> None:
    """One fault, reported once, correctly, and recovered: every target that can be met is met."""
    costs = [Cost(agent, 100.0, 2.0, 70.0) for agent in range(1, 9)]
    found = figures([quiet(cost=costs, received=dict.fromkeys(range(1, 9), 2000)), quiet(OFF), trial()])
    assert (found.injected, found.trials, found.missed, found.false, found.nominal_alarms) == (1, 1, 0, 0, 0)
    assert (found.alarms_per_fault, found.right, found.resolved, found.resolved_healable) == (1.0, 1.0, 1.0, 1.0)
    assert (found.cpu_nominal, found.bytes_nominal, found.rss_mb) == (pytest.approx(2.0), pytest.approx(20.0), 70.0)
    assert short(found) == []
    (one,) = found.classes
    assert (one.fault, one.resolved, one.alarms) == ("node_killed", 1, 1.0)


def test_missed_targets_are_reported() -> None:
    """Missed faults, chains, false alarms and changes with recovery off each miss a target."""
    missed = trial(alarms=[], acts=[], lines=[])
    chain = trial(alarms=[alarm(0.4), alarm(0.6, "rates/agent_3/topic_1")])
    lone = quiet(alarms=[alarm(5.0, "rates/agent_4/topic_1", 4)], ended=T0 + 40)
    found = figures([lone, quiet(OFF, changed=["agent 1: restarted"]), missed, chain])
    names = {row.name for row in judged(found) if row.met is False}
    assert {"Missed", "False alarms", "Cause reported correctly", "Changed with recovery off"} <= names
    assert {"Self-resolved, of the healable", "Self-resolved, of all"} <= names
    assert found.alarms_per_fault == pytest.approx(2.0), "a missed fault does not make up for a chain"
    assert "Alarms per fault" in names


def test_an_empty_campaign_meets_no_target() -> None:
    """Without trials there is no evidence."""
    rows = judged(figures([]))
    assert len(rows) == len(AIMS)
    assert [row.met for row in rows if row.name != "False alarms"] == [None] * (len(AIMS) - 1)


def test_the_paper_would_not_meet_our_targets() -> None:
    """Each target is better than the figure of the paper's Table 2."""
    paper = trial(alarms=[alarm(5.2)], acts=[], lines=[], injections=[injection(healable=False)])
    names = {row.name for row in judged(figures([paper])) if row.met is False}
    assert {"Average fault detection", "Self-resolved, of all"} <= names
