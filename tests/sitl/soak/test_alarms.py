"""Alarms of a soak per agent hour."""

from __future__ import annotations

import pytest

from sitl.campaign.trial import ABORTED
from sitl.soak.alarms import count
from tests.fakes.campaign_trials import alarm, injection, trial
from tests.fakes.soak_samples import quiet


def test_false_alarms_are_counted_per_agent_hour() -> None:
    """All alarms of quiet runs, of interrupted ones too; those of injected faults are not false."""
    one = alarm(50.0, "nodes/x", agent=2)
    cut = quiet(900, kind=ABORTED, alarms=[one])
    found = count([quiet(1800), cut, trial(injections=[injection()])])
    hours = (8 * 2700 + trial().agents * trial().seconds) / 3600
    assert (found.false, found.injected, found.not_seen) == (1, 1, ())
    assert found.per_agent_hour == pytest.approx(1 / hours)
    assert found.low < 1 / hours < found.high
    assert "A02 nodes/x" in found.listed[0] and "nothing injected" in found.listed[0]


def test_a_fault_that_an_interrupt_cut_short_is_not_missed() -> None:
    """Its run is observed time, but it says nothing about detection."""
    cut = trial(kind=ABORTED, injections=[injection()], alarms=[])
    assert count([trial(injections=[injection()], alarms=[])]).missed == 1
    found = count([cut])
    assert (found.injected, found.missed, found.agent_hours > 0) == (0, 0, True)


def test_few_hours_without_an_alarm_have_an_upper_limit() -> None:
    """The upper limit is that of Poisson's distribution: 3.69 events when none was seen."""
    found = count([quiet(3600)])
    assert (found.false, found.low) == (0, 0.0) and found.high == pytest.approx(3.689 / 8, rel=0.001)
    assert count([]).per_agent_hour is None
