"""Which faults are drawn, and how the record of an agent is assigned to a trial."""

from __future__ import annotations

import hashlib
import re
from typing import Any
from unittest.mock import Mock

import pytest

from sitl.campaign.arguments import parser
from sitl.campaign.event_collector import Levels, note
from sitl.campaign.fault_catalog import (
    EXCLUDED,
    LEFT_ALONE,
    OFF,
    chosen,
    class_of,
    excluded,
    explained,
    injection,
    kind,
)
from sitl.campaign.main import main
from sitl.campaign.plan import fits
from sitl.campaign.profiles import ALL, CHANGES
from sitl.campaign.report import BEGIN, END
from sitl.campaign.schedule import schedule
from sitl.campaign.seeds import checked_out, seed_of
from sitl.campaign.trial import OFF as OFF_RUN, append
from sitl.faults import all_faults
from sitl.faults.base import Agent
from sitl.harness.compose_stack import ROOT
from sitl.harness.config_overrides import overridden
from tests.fakes.campaign_trials import trial

TUNED, SHIPPED, AS_FOUND = ALL["tuned"], ALL["shipped"], ALL["as-found"]
COMMIT = "0123456789" * 4


def test_every_fault_is_injected_or_excluded_with_a_reason() -> None:
    """With eight agents and emulated links, the only faults that the tuned profile excludes are double faults and one that
    is injected when it ends.
    """
    faults = all_faults()
    left = excluded(faults, 8, TUNED, air=True)
    assert left.keys() == {name for name, fault in faults.items() if fault.also} | EXCLUDED.keys()
    assert {fault.layer for fault in faults.values()} == {"companion", "container", "ros", "link"}
    assert chosen(faults, (), 8, TUNED, air=True).keys() == faults.keys() - left.keys()


def test_the_shipped_configuration_says_what_it_cannot_see() -> None:
    """What needs more than names is excluded from the other profiles, with the keys that it needs; a fault whose
    configuration only names things is not. Files are reported, and PHM may not restore them.
    """
    faults = all_faults()
    for profile in (SHIPPED, AS_FOUND):
        left = excluded(faults, 8, profile, air=True)
        assert "host.memory.error" in left["memory_full"]
        assert "host.free_disk" in left["disk_full"]
        assert "SHA-256" in left["file_altered"]
        assert not {"engine_restarted", "netns_owner_killed", "container_killed"} & left.keys()
        assert not injection(faults["file_deleted"], Agent("p", "agent_1", docker=Mock()), profile).healable
    assert injection(faults["file_deleted"], Agent("p", "agent_1", docker=Mock()), TUNED).healable


def test_several_faults_on_one_agent_are_independent_or_explained() -> None:
    """An engine and a container, a network and a node, a node and the host's load may fail together; the end of a
    container explains its nodes, so one alarm may report both. PHM's own faults come alone.
    """
    faults = all_faults()
    one, other = (class_of(faults[name]) for name in ("host_overload", "node_killed"))
    assert fits(one, [other])
    assert fits(class_of(faults["engine_restarted"]), [class_of(faults["container_killed"])])
    assert fits(class_of(faults["network_disconnected"]), [other])
    for name in (
        "phm_killed",
        "gcs_radio_cut",
        "crash_loop",
        "peer_lost",
        "cpu_limited",
        "topic_silent",
        "memory_leak",
        "power_loss",
        "phm_state_noise",
        "phm_killed_in_restart",
    ):
        assert not fits(class_of(faults[name]), [other]), name
    agents = [Agent("p", f"agent_{number}", docker=Mock(), number=number) for number in (1, 2)]
    found = [
        injection(faults[name], agents[at], SHIPPED)
        for name, at in (("node_killed", 0), ("network_blocked", 0), ("container_killed", 0), ("node_stopped", 1))
    ]
    explained(found)
    assert [each.explained_by for each in found] == ["container_killed", "", "", ""]


def test_faults_of_radio_and_router_blind_the_ground() -> None:
    """Faults of the radio and of the router hide the agent; one of its autopilot does not."""
    faults, agent = all_faults(), Agent("p", "agent_1", docker=Mock())
    blind = {name for name, fault in faults.items() if injection(fault, agent, TUNED).blinds}
    assert blind == {"gcs_radio_cut", "radio_lossy", "radio_saturated", "router_killed"}
    assert kind(faults["topic_silent"]) == kind(faults["qos_mismatch"]) == "topics"


def test_a_stepped_clock_does_not_pass() -> None:
    """Nothing sets it back before it is cleared."""
    assert not injection(all_faults()["clock_stepped"], Agent("p", "agent_1", docker=Mock()), TUNED).passes


def test_an_unavailable_fault_is_rejected() -> None:
    """A fault that does not exist, or needs more agents, is named in the message."""
    with pytest.raises(ValueError, match="no such fault: nonsense"):
        chosen(all_faults(), ["nonsense"], 8, TUNED, air=True)
    with pytest.raises(ValueError, match="peer_lost: it needs 3 agents"):
        chosen(all_faults(), ["peer_lost"], 2, TUNED, air=True)


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


def test_on_a_busy_machine_a_unit_may_be_stale_for_that() -> None:
    """With the load that the campaign makes, a unit that PHM cannot judge for want of a processor does not delay it."""
    for busy, found in ((True, []), (False, ["nodes/a is STALE"])):
        levels = Levels(busy=busy)
        levels.take(event("unit", 1.0, level="OK"))
        levels.take(event("report", 1.0))
        levels.take(event("transition", 2.0, level="STALE", blocked_by="host/cpu"))
        assert levels.unwell({"nodes/a": "OK"}) == found
        levels.take(event("transition", 3.0, level="STALE", blocked_by="container/a"))
        assert levels.unwell({"nodes/a": "OK"}) == ["nodes/a is STALE"]


def test_the_plan_is_printed_without_a_swarm(capsys: pytest.CaptureFixture[str]) -> None:
    """`--plan` needs no running swarm: the trials of each seed, how often each fault is injected, what is excluded and why.
    A wrong fault, number of seeds or commit ends with exit code 2.
    """
    assert main(["--plan", "--seeds", "2", "--trials", "3", "--commit", COMMIT]) == 0
    out = capsys.readouterr().out
    assert out.count("seed 1 of 2") == out.count("seed 2 of 2") == 1
    assert len([row for row in out.splitlines() if " on A0" in row]) == 6
    assert "6 trials, 2 with several faults on one agent" in out
    assert "memory_full: the shipped configuration does not set host.memory.error, host.memory.warn" in out
    assert main(["--plan", "--seeds", "1", "--trials", "1", "--only", "node_killed", "--commit", COMMIT]) == 0
    out = capsys.readouterr().out
    assert "memory_full: it is not among the faults given with --only" in out
    assert "-  node_killed" not in out
    for words, error in (
        (["--only", "nonsense"], "no such fault"),
        (["--seeds", "0"], "1 seed or more"),
        (["--commit", "abc"], "40 hexadecimal digits"),
    ):
        assert main(["--plan", *words]) == 2
        assert error in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"commit": "f" * 40}, f"the record of commit {'f' * 40}"),
        ({"agents": 4}, "with other agents"),
        ({"seed": 1}, "another number of seeds or trials"),
    ],
)
def test_a_record_of_another_campaign_is_rejected(
    tmp_path: Any, capsys: pytest.CaptureFixture[str], change: dict[str, Any], error: str
) -> None:
    """Of another commit, with other settings, or with other trials than planned."""
    file = tmp_path / "trials.jsonl"
    words = ["--commit", COMMIT, "--seed", "1", "--trials", "4", "--record", str(file)]
    to_do = schedule(parser().parse_args(words))
    append(file, trial(kind=OFF_RUN, setting=to_do.setting(0)))
    append(file, trial(setting={**to_do.setting(0), **change}))
    assert main(words) == 2
    assert error in capsys.readouterr().err


def test_seeds_follow_from_the_commit() -> None:
    """By the documented rule, so that no one can choose them. Uncommitted changes do not change them."""
    for index in range(3):
        digest = hashlib.sha256(f"{COMMIT}/{index}".encode()).hexdigest()
        assert seed_of(COMMIT, index) == seed_of(f"{COMMIT}-dirty", index) == int(digest[:8], 16)
    assert re.fullmatch(r"[0-9a-f]{40}(-dirty)?", checked_out())
