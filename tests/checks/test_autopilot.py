"""Slot 10: rules of the check of the autopilot."""

from __future__ import annotations

import dataclasses
from typing import Any

from phm import api, testing
from phm_checks.autopilot import Autopilot

WELL = api.AutopilotFact(0.3, False, 5, 3, "fc", 120.0)
OPEN = api.LinkFact("fc", open=True, rx_age_s=0.3)


def check(**mavlink: Any) -> api.Check:
    endpoint = {"url": "/dev/ttyACM0", "name": "fc"}
    (one,) = Autopilot.build(testing.settings(mavlink={"endpoints": [endpoint], **mavlink}))
    return one


def run(judge: api.Check, pilot: api.AutopilotFact | None, link: api.LinkFact = OPEN) -> api.Result:
    result = judge.run(testing.world(links=testing.FakeLinks(autopilot=pilot, links=(link,))))
    assert isinstance(result, api.Result)
    return result


def changed(**fields: Any) -> api.AutopilotFact:
    return dataclasses.replace(WELL, **fields)


def test_an_autopilot_that_is_heard_is_ok() -> None:
    """Armed or not, its mode and how long it has run go into the record."""
    result = run(check(), changed(armed=True))
    assert result.level is api.Level.OK
    assert "armed, mode 5" in result.summary
    expected = {"armed": True, "mode": 5, "system_status": 3, "boot_s": 120.0, "reboots": 0, "link": "fc"}
    assert {name: result.values[name] for name in expected} == expected


def test_an_autopilot_never_heard_is_not_judged_unless_it_is_expected() -> None:
    """mavlink.autopilot says that there is one."""
    assert run(check(), None).bypass
    result = run(check(autopilot=True), None)
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "autopilot_silent",
        "autopilot: no heartbeat",
    )


def test_an_autopilot_may_start_after_phm() -> None:
    """It is switched on with the companion, and is waited for."""
    just_begun = testing.world(links=testing.FakeLinks(links=(OPEN,)), myself=testing.FakeSelf(uptime_s=10.0))
    result = check(autopilot=True).run(just_begun)
    assert isinstance(result, api.Result)
    assert result.level is api.Level.STALE


def test_a_silent_autopilot_is_an_error() -> None:
    """With the age of its last heartbeat, and whether it was armed then."""
    result = run(check(), changed(age_s=6.0, armed=True))
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "autopilot_silent",
        "autopilot: no heartbeat 6 s",
    )
    assert "It was armed" in result.summary


def test_a_longer_time_may_be_given() -> None:
    """mavlink.autopilot_timeout."""
    assert run(check(autopilot_timeout="10s"), changed(age_s=6.0)).level is api.Level.OK


def test_its_link_is_reopened_only_where_it_is_silent_as_a_whole() -> None:
    """Another component that still speaks on the port proves that the port is well."""
    assert run(check(), changed(age_s=6.0)).target == ""
    assert run(check(), changed(age_s=6.0), dataclasses.replace(OPEN, rx_age_s=6.0)).target == "link:fc"
    assert run(check(autopilot=True), None, dataclasses.replace(OPEN, rx_age_s=None)).target == "link:fc"


def test_behind_a_closed_link_it_is_not_known() -> None:
    """The link tells why."""
    assert run(check(), changed(age_s=60.0), api.LinkFact("fc", open=False)).level is api.Level.STALE
    assert run(check(autopilot=True), None, api.LinkFact("fc", open=False)).level is api.Level.STALE


def test_a_reboot_is_told_for_a_while() -> None:
    """As a warning, with the words that the operator reads; then it is over."""
    result = run(check(), changed(rebooted_s=2.0, reboots=1, boot_s=2.0))
    assert (result.level, result.condition, result.brief) == (
        api.Level.WARN,
        "autopilot_rebooted",
        "autopilot rebooted",
    )
    assert run(check(), changed(rebooted_s=31.0, reboots=1)).level is api.Level.OK


def test_a_reboot_while_armed_is_an_error() -> None:
    """It may be in the air."""
    result = run(check(), changed(rebooted_s=2.0, reboots=1, rebooted_armed=True))
    assert (result.level, result.brief) == (api.Level.ERROR, "autopilot rebooted while armed")


OVERDUE = changed(age_s=2.7, quiet_s=2.6, due_s=2.5, overdue=True)
ROUTER = {"url": "tcp:10.0.0.1:5760", "name": "fc", "leads_to": "router"}


def behind_a_router(pilot: api.AutopilotFact, *others: float) -> api.Result:
    """others: how long ago each of the others behind it was heard."""
    senders = (api.SenderFact(1, 1, 2.6, 50, 0.0), *(api.SenderFact(255, 190, age_s, 50, 0.0) for age_s in others))
    link = dataclasses.replace(OPEN, rx_age_s=min([2.6, *others]), senders=senders)
    (judge,) = Autopilot.build(testing.settings(agent={"id": 1}, mavlink={"endpoints": [ROUTER]}))
    return run(judge, pilot, link)


def test_a_steady_autopilot_is_lost_before_the_timeout() -> None:
    """On its own port nothing else can be the cause: told at once, and its link is opened anew."""
    result = run(check(), OVERDUE, dataclasses.replace(OPEN, rx_age_s=2.4))
    assert (result.level, result.condition, result.settle_s) == (api.Level.ERROR, "autopilot_silent", 0.0)
    assert "expected one within 2.5 s, and nothing else is received on fc either" in result.summary
    assert result.target == "link:fc"


def test_behind_a_router_others_prove_that_it_is_the_autopilot() -> None:
    """Frames of others that came since its own ended; the router is well."""
    result = behind_a_router(OVERDUE, 0.9)
    assert (result.level, result.settle_s, result.target) == (api.Level.ERROR, 0.0, "")
    assert "other frames are still received" in result.summary


def test_behind_a_router_that_may_be_silent_it_is_waited_for() -> None:
    """The timeout holds and the evidence about the router is waited for, as those of others ended together with its own."""
    assert behind_a_router(OVERDUE).level is api.Level.OK
    assert behind_a_router(OVERDUE, 2.3).level is api.Level.OK
    late = behind_a_router(changed(age_s=3.8, quiet_s=3.7), 3.4)
    assert (late.level, late.settle_s) == (api.Level.ERROR, None)


def test_a_reboot_is_told_at_once() -> None:
    """The autopilot itself says so."""
    assert run(check(), changed(rebooted_s=0.1, reboots=1)).settle_s == 0.0
