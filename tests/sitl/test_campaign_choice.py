"""Which faults are drawn, and how the record of an agent is assigned to a trial."""

from __future__ import annotations

from typing import Any

import pytest

from sitl.campaign.collect import Levels, note
from sitl.campaign.fault_catalog import CHANGES, LEFT_ALONE, OFF, chosen, class_of, unsuitable_because
from sitl.campaign.main import main
from sitl.campaign.plan import plan
from sitl.campaign.report import BEGIN, END
from sitl.campaign.trial import append
from sitl.faults import all_faults
from sitl.harness.compose_stack import ROOT
from sitl.harness.config_overrides import overridden
from tests.fakes.campaign_trials import trial


def test_every_fault_is_drawn_or_excluded_with_a_reason() -> None:
    """With eight agents and emulated links, the only excluded faults are double faults and starvation."""
    faults = all_faults()
    left = {name for name, fault in faults.items() if unsuitable_because(fault, 8, air=True)}
    assert left == {name for name, fault in faults.items() if fault.also or "starvation" in fault.needs}
    assert {class_of(fault).layer for fault in faults.values()} == {"companion", "container", "ros", "link"}
    drawn = {
        draw.fault
        for each in plan(1, 8, 80, [class_of(fault) for fault in chosen(faults, (), 8, air=True).values()])
        for draw in each.draws
    }
    assert drawn == faults.keys() - left


def test_phm_is_among_the_victims() -> None:
    """Twenty trials of any seed kill or stop PHM, and inject faults of every layer."""
    faults = chosen(all_faults(), (), 8, air=True)
    for seed in range(20):
        drawn = {
            draw.fault
            for each in plan(seed, 8, 20, [class_of(fault) for fault in faults.values()])
            for draw in each.draws
        }
        assert drawn & {"phm_killed", "phm_stopped"}
        assert {faults[name].layer for name in drawn} == {"companion", "container", "ros", "link"}


def test_an_unavailable_fault_is_rejected() -> None:
    """A fault that does not exist, or needs more agents, is named in the message."""
    with pytest.raises(ValueError, match="no such fault: nonsense"):
        chosen(all_faults(), ["nonsense"], 8, air=True)
    with pytest.raises(ValueError, match="peer_lost: it needs 3 agents"):
        chosen(all_faults(), ["peer_lost"], 2, air=True)


def test_the_changes_apply_to_the_shipped_configuration() -> None:
    """Each value that a campaign changes exists; every fault of the recovery-off run exists."""
    assert overridden({**CHANGES, **OFF})
    assert set(LEFT_ALONE) <= all_faults().keys()


def test_the_page_of_results_has_the_marks() -> None:
    """docs/development/results.md has each mark once, in order."""
    page = (ROOT / "docs" / "development" / "results.md").read_text("utf-8")
    assert page.count(BEGIN) == page.count(END) == 1
    assert page.index(BEGIN) < page.index(END)


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
    assert levels.unwell({}) == ["no report yet"]
    for unit, level in (("nodes/a", "OK"), ("gcs", "STALE"), ("host/cpu", "ERROR")):
        levels.take(event("unit", 1.0, unit=unit, level=level))
    levels.take(event("report", 1.0))
    usual = levels.as_usual()
    assert levels.unwell(usual) == []
    levels.take(event("fault_opened", 2.0, fault="f1"))
    levels.take(event("transition", 2.0, level="ERROR"))
    assert levels.unwell(usual) == ["nodes/a is faulty", "nodes/a is ERROR"]
    assert (levels.bad("nodes/a"), levels.bad("gcs")) == (True, False)
    levels.take(event("fault_closed", 3.0, fault="f1"))
    levels.take(event("transition", 3.0, level="OK"))
    assert levels.unwell(usual) == []
    levels.take(event("transition", 3.5, unit="companion", level="WARN"))
    assert levels.unwell(usual) == [], "PHM says for a while that it had ended"
    levels.take(event("start", 4.0))
    assert levels.unwell(usual) == ["no report yet"]
    assert levels.since == 4.0


def test_the_plan_is_printed_without_a_swarm(capsys: pytest.CaptureFixture[str]) -> None:
    """`--plan` needs no running swarm; a record of another campaign, or a wrong fault, ends with exit code 2."""
    assert main(["--plan", "--trials", "3", "--record", "none.jsonl"]) == 0
    assert len(capsys.readouterr().out.strip().splitlines()) == 3
    assert main(["--plan", "--only", "nonsense"]) == 2
    assert "no such fault" in capsys.readouterr().err


def test_a_record_of_another_campaign_is_rejected(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Trials of two seeds in one file are not one campaign."""
    file = tmp_path / "trials.jsonl"
    append(file, trial(setting={"seed": 2, "agents": 8}))
    assert main(["--plan", "--record", str(file), "--seed", "1"]) == 2
    assert "another campaign" in capsys.readouterr().err


def test_a_report_lists_what_is_bad() -> None:
    """Units that are WARN or ERROR in a complete report; one that a restart interrupted remains incomplete."""
    made = trial(alarms=[], acts=[], lines=[])
    for each in (
        event("unit", 0.5, level="ERROR"),
        event("report_started", 1.0),
        event("start", 1.5),
        event("report_started", 2.0),
        event("unit", 2.1, level="ERROR"),
        event("unit", 2.1, unit="rates/a", level="OK"),
        event("unit", 2.2, unit="radio/ground", level="WARN"),
        event("report", 3.0),
    ):
        note(made, 3, each)
    assert [(each.began, each.bad, each.mono) for each in made.summaries] == [
        (1.0, [], None),
        (2.0, ["nodes/a", "radio/ground"], 3.0),
    ]
