"""How the record of an agent is assigned to a trial, and when its units are as before."""

from __future__ import annotations

from typing import Any

import pytest

from sitl.campaign.event_collector import Levels, note
from tests.fakes.campaign_trials import trial


def event(kind: str, mono: float, **more: Any) -> dict[str, Any]:
    return {"event": kind, "mono": mono, "fault": "", "unit": "nodes/a", "slot": 6, **more}


def test_a_fault_is_tracked_to_its_end() -> None:
    """Opened, changed to a second condition, closed; the end of an earlier fault is not part of it."""
    made = trial(alarms=[], acts=[], lines=[])
    for each in (
        event("fault_closed", 1.0, fault="f0", outcome="resolved", by="itself"),
        event("fault_opened", 2.0, fault="f1", condition="node_hung", summary="it hangs"),
        event(
            "transition", 3.0, fault="f1", level="ERROR", old="ERROR", condition="node_missing", summary="it is dead"
        ),
        event("action", 3.5, action="restart", phase="started", detail=""),
        event("fault_closed", 4.0, fault="f1", outcome="resolved", by="restart"),
    ):
        note(made, 3, each)
    (alarm,) = made.alarms
    assert (alarm.mono, alarm.conditions, alarm.closed, alarm.by) == (
        2.0,
        ["node_hung", "node_missing"],
        4.0,
        "restart",
    )
    assert [act.phase for act in made.acts] == ["started"]


def test_a_warning_is_tracked_to_its_end() -> None:
    """From the transition to WARN until OK; a changed summary is not a second warning."""
    made = trial(alarms=[], acts=[], lines=[])
    changes = (
        (1.0, "WARN", "OK", "radio_errors"),
        (2.0, "WARN", "WARN", "radio_weak"),
        (3.0, "OK", "WARN", ""),
        (9.0, "OK", "OK", ""),
    )
    for mono, level, old, condition in changes:
        note(made, 3, event("transition", mono, level=level, old=old, condition=condition, summary="it loses much"))
    assert [(each.mono, each.ended, each.conditions) for each in made.warned] == [
        (1.0, 3.0, ["radio_errors", "radio_weak"])
    ]


def test_a_restarted_phm_is_complete_with_its_first_report() -> None:
    """Its start, and the first report after it."""
    made = trial(alarms=[], acts=[], lines=[])
    for each in (event("report", 1.0), event("start", 2.0), event("report", 3.0), event("report", 4.0)):
        note(made, 3, each)
    assert [(start.mono, start.report) for start in made.starts] == [(2.0, 3.0)]


def test_an_agent_has_recovered_when_its_units_are_as_before() -> None:
    """Not before the first report; not with a fault open; units that were never known and the host's load do not count."""
    levels = Levels()
    assert levels.not_ok({}) == ["no report yet"]
    for unit, level in (("nodes/a", "OK"), ("gcs", "STALE"), ("host/cpu", "ERROR")):
        levels.take(event("unit", 1.0, unit=unit, level=level))
    levels.take(event("report", 1.0))
    usual = levels.as_usual()
    assert levels.not_ok(usual) == []
    levels.take(event("fault_opened", 2.0, fault="f1"))
    levels.take(event("transition", 2.0, level="ERROR"))
    assert levels.not_ok(usual) == ["nodes/a is faulty", "nodes/a is ERROR"]
    assert (levels.bad("nodes/a"), levels.bad("gcs")) == (True, False)
    levels.take(event("fault_closed", 3.0, fault="f1"))
    levels.take(event("transition", 3.0, level="OK"))
    assert levels.not_ok(usual) == []
    levels.take(event("transition", 3.5, unit="companion", level="WARN"))
    assert levels.not_ok(usual) == [], "PHM says for a while that it had ended"
    levels.take(event("start", 4.0))
    assert levels.not_ok(usual) == ["no report yet"]
    assert levels.since == 4.0


def test_on_a_busy_machine_a_unit_may_be_stale_for_that() -> None:
    """With the load that the campaign makes, a unit that PHM cannot judge for want of a processor does not delay it."""
    for busy, found in ((True, []), (False, ["nodes/a is STALE"])):
        levels = Levels(busy=busy)
        levels.take(event("unit", 1.0, level="OK"))
        levels.take(event("report", 1.0))
        levels.take(event("transition", 2.0, level="STALE", blocked_by="host/cpu"))
        assert levels.not_ok({"nodes/a": "OK"}) == found
        levels.take(event("transition", 3.0, level="STALE", blocked_by="container/a"))
        assert levels.not_ok({"nodes/a": "OK"}) == ["nodes/a is STALE"]


@pytest.mark.parametrize(
    ("unit", "level", "more", "undecided"),
    [
        ("consensus", "STALE", {}, True),
        ("consensus", "WARN", {}, True),
        ("consensus", "OK", {}, False),
        ("consensus", "ERROR", {}, False),  # it has an alarm
        ("consensus", "STALE", {"blocked_by": "container/ros_app"}, False),
        ("consensus", "STALE", {"blocked_by": "host/cpu"}, True),
        ("nodes/a", "WARN", {}, False),  # of the fault itself
        ("host/memory", "WARN", {}, False),
        ("companion", "WARN", {}, False),  # PHM remembers its restart
    ],
)
def test_a_unit_that_may_become_a_fault_is_undecided(
    unit: str, level: str, more: dict[str, str], undecided: bool
) -> None:
    """Not what is OK, has its alarm, belongs to the fault or waits for the end of one."""
    levels = Levels()
    assert levels.undecided({}, (), 9.0) == ["no report yet"]
    levels.take({"event": "report", "mono": 1.0})
    levels.take({"event": "unit", "mono": 2.0, "unit": unit, "level": level, **more})
    assert bool(levels.undecided({}, {"nodes/a"}, 9.0)) is undecided
    assert not levels.undecided({unit: level}, {"nodes/a"}, 9.0), "it is usual"


def test_for_a_while_after_a_busy_cpu_all_is_undecided() -> None:
    """Unless the machine is meant to be busy."""
    for busy in (False, True):
        levels = Levels(busy=busy)
        levels.take({"event": "report", "mono": 1.0})
        for mono, level in ((2.0, "WARN"), (30.0, "OK"), (50.0, "OK")):
            levels.take({"event": "transition", "mono": mono, "unit": "host/cpu", "level": level})
        assert [bool(levels.undecided({}, (), now)) for now in (60.0, 76.0)] == [not busy, False]
