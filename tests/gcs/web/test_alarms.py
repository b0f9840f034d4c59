"""Silence of the bell, for one agent and for all, and which alarms are kept of more agents than there is room for."""

from __future__ import annotations

import pytest

from phm.core.model import Stamp
from phm.gcs.alarms import MAX_AGENTS
from phm.gcs.events import GcsEvent
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


def critical(at: float) -> GcsEvent:
    return GcsEvent(Stamp(at, at), "text", {"phm": True, "repeat": False, "severity": 2})


def flood(alarms: AlarmList, begin: float, names: str = "A250") -> None:
    """A CRITICAL line of each of MAX_AGENTS invented agents, one a second."""
    for number in range(MAX_AGENTS):
        alarms.take(critical(begin + number), f"{names}/{number}")


def count(alarms: AlarmList, name: str) -> int | None:
    row = alarms.row(name, 10_000.0)
    return None if row is None else row["count"]


def test_acknowledged_alarms_make_room_for_new_ones() -> None:
    """The agents that had them may be invented; one that is silenced stays silenced."""
    alarms = AlarmList()
    flood(alarms, 0.0)
    alarms.control({"do": "silence", "agent": "A250/0", "for_s": 86_400}, 700.0)
    alarms.control({"do": "acknowledge", "agent": None}, 700.0)
    alarms.take(critical(701.0), "A07")
    assert count(alarms, "A07") == 1
    assert silent_until(alarms, "A250/0", 702.0) == 87_100.0
    assert alarms.left_out == 0


def test_a_flood_of_alarms_leaves_those_of_expected_agents() -> None:
    """Also those that came before it. The oldest ones of others are left out, and counted until all are acknowledged."""
    alarms = AlarmList(["A07", "A08"])
    alarms.take(critical(0.0), "A07")
    flood(alarms, 1.0)
    alarms.take(critical(1000.0), "A08")
    assert (count(alarms, "A07"), count(alarms, "A08")) == (1, 1)
    assert (count(alarms, "A250/1"), count(alarms, "A250/2"), alarms.left_out) == (None, 1, 2)
    alarms.control({"do": "acknowledge", "agent": None}, 1001.0)
    assert alarms.left_out == 0


def test_an_agent_can_be_silenced_during_a_flood() -> None:
    """There is always room for what the operator wants."""
    alarms = AlarmList()
    flood(alarms, 0.0)
    alarms.control({"do": "silence", "agent": "A07", "for_s": 3600}, 1000.0)
    assert silent_until(alarms, "A07", 1001.0) == 4600.0
    flood(alarms, 1001.0, "A249")
    assert count(alarms, "A249/0") == 1
