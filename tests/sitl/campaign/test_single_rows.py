"""The figures of faults that were the only one of their agent, and of those with others."""

from __future__ import annotations

from sitl.campaign import single_rows
from sitl.campaign.groups import groups
from sitl.campaign.publication import RECORD
from sitl.campaign.sections import sections
from sitl.campaign.trial import OFF, load
from sitl.harness.compose_stack import ROOT
from tests.fakes.campaign_trials import alarm, injection, trial

ROUTER = "container/router"


def test_faults_are_split_by_whether_their_agent_had_others() -> None:
    """A fault on another agent, one that could not be injected and the run with recovery off do not count."""
    failed = injection(fault="device_gone", unit="devices/x", moment=None)
    early = alarm(0.6, outcome="resolved", by="restart", conditions=["missing", "node_missing"])
    other = injection(fault="router_killed", unit=ROUTER, condition="exited", healable=False, world=None)
    found = groups(
        [
            trial(injections=[injection(), injection(agent=4), failed]),
            trial(number=2, injections=[injection(), other], alarms=[early]),
            trial(kind=OFF, number=1),
        ]
    )
    assert single_rows.rows(found) == [
        ("the only one: injected", "2"),
        ("the only one: detected at their unit", "1 of 2"),
        ("the only one: missed", "1 of 2"),
        ("the only one: cause right", "1 of 2"),
        ("the only one: of these, first known as something else", "0"),
        ("the only one: healable, ended by action", "1 of 2"),
        ("the only one: detection, mean", "0.40 s"),
        ("the only one: recovery by action, mean", "4.00 s"),
        ("with others: injected", "2"),
        ("with others: detected at their unit", "1 of 2"),
        ("with others: missed", "1 of 2"),
        ("with others: cause right", "1 of 2"),
        ("with others: of these, first known as something else", "1"),
        ("with others: healable, ended by action", "1 of 1"),
        ("with others: detection, mean", "0.60 s"),
        ("with others: recovery by action, mean", "4.00 s"),
    ]
    assert single_rows.rows(groups([trial(injections=[])]))[1] == ("the only one: detected at their unit", "-")


def test_the_published_record_has_both() -> None:
    """It was made with a plan that had some classes only with others; nothing of the plan is needed to read it."""
    found = groups(load(ROOT / RECORD))
    shown = next(each for each in sections(found) if each.title == "The only fault of an agent, and with others")
    injected = [row[1:] for row in shown.rows if row[0].endswith(": injected")]
    for only, others, group in zip(*injected, found, strict=True):
        assert int(only) + int(others) == group.all.injected
