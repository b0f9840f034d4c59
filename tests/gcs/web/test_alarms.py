"""Silence of the bell: for one agent, and for all."""

from __future__ import annotations

import pytest

from phm.gcs.web.alarms import AlarmList


@pytest.fixture
def alarms() -> AlarmList:
    """All agents are silenced from 100 s to 1900 s."""
    made = AlarmList()
    made.control({"do": "silence", "agent": None, "for_s": 1800}, 100.0)
    return made


def silent_until(alarms: AlarmList, name: str, now: float) -> float | None:
    row = alarms.row(name, now)
    return None if row is None else row["silent_until"]


def test_the_page_can_show_and_end_the_silence_of_all(alarms: AlarmList) -> None:
    """Also while nothing is to be acknowledged; its end is that of each agent's silence, too."""
    alarms.control({"do": "silence", "agent": "A14", "for_s": 3600}, 100.0)
    assert (alarms.silent_until(100.0), silent_until(alarms, "A15", 100.0)) == (1900.0, 1900.0)
    alarms.control({"do": "unsilence", "agent": None}, 101.0)
    assert (alarms.silent_until(101.0), silent_until(alarms, "A14", 101.0)) == (None, None)


def test_the_silence_of_all_ends_by_itself(alarms: AlarmList) -> None:
    """After its time it is not shown any more."""
    assert (alarms.silent_until(1899.0), alarms.silent_until(1900.0)) == (1900.0, None)


def test_one_agent_does_not_end_the_silence_of_all(alarms: AlarmList) -> None:
    """Its row then has the same time as all: so the page can say whose silence it is."""
    alarms.control({"do": "silence", "agent": "A14", "for_s": 3600}, 100.0)
    assert silent_until(alarms, "A14", 100.0) == 3700.0
    alarms.control({"do": "unsilence", "agent": "A14"}, 101.0)
    assert silent_until(alarms, "A14", 101.0) == alarms.silent_until(101.0) == 1900.0
