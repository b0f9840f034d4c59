"""Slot 10: rules of the autopilot check."""

from __future__ import annotations

import dataclasses
from typing import Any

from phm import api, testing
from phm_checks.autopilot import Autopilot

HEALTHY = api.AutopilotFact(0.3, False, 5, 3, "fc", 120.0)
OPEN = api.LinkFact("fc", open=True, rx_age_s=0.3)


def check(**mavlink: Any) -> api.Check:
    endpoint = {"url": "/dev/ttyACM0", "name": "fc"}
    (one,) = Autopilot.build(testing.settings(mavlink={"endpoints": [endpoint], **mavlink}))
    return one


def run(autopilot_check: api.Check, pilot: api.AutopilotFact | None, link: api.LinkFact = OPEN) -> api.Result:
    result = autopilot_check.run(testing.world(links=testing.FakeLinks(autopilot=pilot, links=(link,))))
    assert isinstance(result, api.Result)
    return result


def changed(**fields: Any) -> api.AutopilotFact:
    return dataclasses.replace(HEALTHY, **fields)


def test_an_autopilot_that_sends_heartbeats_is_ok() -> None:
    """The record has its mode and its uptime, whether it is armed or not."""
    result = run(check(), changed(armed=True))
    assert result.level is api.Level.OK
    assert "armed, mode 5" in result.summary
    expected = {"armed": True, "mode": 5, "system_status": 3, "boot_s": 120.0, "reboots": 0, "link": "fc"}
    assert {name: result.values[name] for name in expected} == expected


def test_an_autopilot_that_was_never_received_is_a_fault_only_when_it_is_expected() -> None:
    """`mavlink.autopilot` declares that there is one."""
    result = run(check(), None)
    assert result.bypass and result.evidence.unobserved, "it may also be still lost after a restart of PHM"
    result = run(check(autopilot=True), None)
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "autopilot_silent",
        "autopilot: no heartbeat",
    )


def with_other_systems(
    *others: int, component: int = 1, radio: bool = False, up_s: float = 60.0, **mavlink: Any
) -> api.Result:
    """others: systems that are received by the port instead of the agent's own, 1."""
    senders = tuple(api.SenderFact(system, component, 0.2, 200, 0.0) for system in others)
    radios = (api.RadioFact("fc", 0.5, 1.0),) if radio else ()
    links = testing.FakeLinks(links=(dataclasses.replace(OPEN, senders=senders),), radios=radios)
    result = check(**mavlink).run(testing.world(links=links, daemon=testing.FakeSelf(uptime_s=up_s)))
    assert isinstance(result, api.Result)
    return result


def test_an_autopilot_with_another_id_is_named() -> None:
    """Also where none is expected: without it, PHM would never say that `agent.id` is wrong."""
    result = with_other_systems(5)
    assert (result.level, result.condition, result.brief, result.bypass) == (
        api.Level.WARN,
        "autopilot_silent",
        "autopilot: id 5, agent.id 1",
        False,
    )
    assert "autopilot 5 is received on fc, agent.id is 1: set agent.id (PHM_AGENT_ID) to 5" in result.summary
    result = with_other_systems(5, autopilot=True)
    assert (result.level, result.brief) == (api.Level.ERROR, "autopilot: id 5, agent.id 1")
    assert "set agent.id (PHM_AGENT_ID) to 5" in result.summary and "cable" not in result.summary


def test_other_vehicles_are_not_taken_for_the_autopilot() -> None:
    """Those received by radio or behind a router, several, other components, a ground station; nor anything while PHM starts."""
    tcp = {"url": "tcp:10.0.0.1:5760", "name": "fc"}
    results = (
        with_other_systems(5, radio=True),
        with_other_systems(5, endpoints=[tcp]),
        with_other_systems(5, endpoints=[{**tcp, "leads_to": "router"}]),
        with_other_systems(5, 6),
        with_other_systems(5, 1),
        with_other_systems(5, component=191),
        with_other_systems(255),
        with_other_systems(5, up_s=10.0),
    )
    assert all(result.bypass for result in results)
    assert with_other_systems(5, endpoints=[{**tcp, "leads_to": "autopilot"}]).level is api.Level.WARN


def test_an_autopilot_may_start_after_phm() -> None:
    """It gets its power together with the companion, so PHM waits for it."""
    just_begun = testing.world(links=testing.FakeLinks(links=(OPEN,)), daemon=testing.FakeSelf(uptime_s=10.0))
    result = check(autopilot=True).run(just_begun)
    assert isinstance(result, api.Result)
    assert result.level is api.Level.STALE


def test_a_silent_autopilot_is_an_error() -> None:
    """The result has the age of its last heartbeat and whether it was armed then."""
    result = run(check(), changed(age_s=6.0, armed=True))
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "autopilot_silent",
        "autopilot: no heartbeat 6 s",
    )
    assert "It was armed" in result.summary


def test_the_timeout_is_configurable() -> None:
    """`mavlink.autopilot_timeout`."""
    assert run(check(autopilot_timeout="10s"), changed(age_s=6.0)).level is api.Level.OK


def test_the_link_is_reopened_only_when_nothing_is_received_on_it() -> None:
    """Another component that still sends on the port proves that the port works."""
    assert run(check(), changed(age_s=6.0)).target == ""
    assert run(check(), changed(age_s=6.0), dataclasses.replace(OPEN, rx_age_s=6.0)).target == "link:fc"
    assert run(check(autopilot=True), None, dataclasses.replace(OPEN, rx_age_s=None)).target == "link:fc"


def test_behind_a_closed_link_the_autopilot_is_stale() -> None:
    """The link's own unit reports the cause."""
    assert run(check(), changed(age_s=60.0), api.LinkFact("fc", open=False)).level is api.Level.STALE
    assert run(check(autopilot=True), None, api.LinkFact("fc", open=False)).level is api.Level.STALE


def test_a_reboot_is_reported_for_a_limited_time() -> None:
    """A warning with a text for the operator, until the time is over."""
    result = run(check(), changed(rebooted_s=2.0, reboots=1, boot_s=2.0))
    assert (result.level, result.condition, result.brief) == (
        api.Level.WARN,
        "autopilot_rebooted",
        "autopilot rebooted",
    )
    assert run(check(), changed(rebooted_s=31.0, reboots=1)).level is api.Level.OK


def test_a_reboot_while_armed_is_an_error() -> None:
    """The vehicle may be flying."""
    result = run(check(), changed(rebooted_s=2.0, reboots=1, rebooted_armed=True))
    assert (result.level, result.brief) == (api.Level.ERROR, "autopilot rebooted while armed")


OVERDUE = changed(age_s=2.7, quiet_s=2.6, due_s=2.5, overdue=True)
ROUTER = {"url": "tcp:10.0.0.1:5760", "name": "fc", "leads_to": "router"}


def behind_a_router(pilot: api.AutopilotFact, *others: float) -> api.Result:
    """others: seconds since the last frame of each other component behind the router."""
    senders = (api.SenderFact(1, 1, 2.6, 50, 0.0), *(api.SenderFact(255, 190, age_s, 50, 0.0) for age_s in others))
    link = dataclasses.replace(OPEN, rx_age_s=min([2.6, *others]), senders=senders)
    (autopilot_check,) = Autopilot.build(testing.settings(agent={"id": 1}, mavlink={"endpoints": [ROUTER]}))
    return run(autopilot_check, pilot, link)


def test_a_regular_autopilot_is_lost_before_the_timeout() -> None:
    """On its own port there is no other possible cause: report immediately and reopen the link."""
    result = run(check(), OVERDUE, dataclasses.replace(OPEN, rx_age_s=2.4))
    assert (result.level, result.condition, result.settle_s) == (api.Level.ERROR, "autopilot_silent", 0.0)
    assert "expected one within 2.5 s, and nothing else is received on fc either" in result.summary
    assert result.target == "link:fc"


def test_other_components_behind_a_router_prove_that_the_autopilot_is_lost() -> None:
    """Their frames arrived after its last frame, so the router works."""
    result = behind_a_router(OVERDUE, 0.9)
    assert (result.level, result.settle_s, result.target) == (api.Level.ERROR, 0.0, "")
    assert "other frames are still received" in result.summary


def test_behind_a_router_that_may_be_silent_the_full_timeout_applies() -> None:
    """The frames of the others ended together with its own, so the check waits for evidence about the router."""
    assert behind_a_router(OVERDUE).level is api.Level.OK
    assert behind_a_router(OVERDUE, 2.3).level is api.Level.OK
    late = behind_a_router(changed(age_s=3.8, quiet_s=3.7), 3.4)
    assert (late.level, late.settle_s) == (api.Level.ERROR, None)


def test_frames_of_others_that_arrive_in_time_rule_out_a_lack_of_cpu_time() -> None:
    """In a campaign a hung autopilot was reported after 16 s, because the machine was busy: other frames of its link arrived all the
    time. Not decided by a single late frame of the others, nor before the timeout."""
    assert not behind_a_router(OVERDUE, 0.9).evidence.conclusive
    silent = changed(age_s=3.8, quiet_s=3.7)
    assert not behind_a_router(silent, 1.9).evidence.conclusive
    assert behind_a_router(silent, 0.9).evidence.conclusive


def test_that_others_were_received_in_time_counts_until_the_autopilot_is_received() -> None:
    (autopilot_check,) = Autopilot.build(testing.settings(agent={"id": 1}, mavlink={"endpoints": [ROUTER]}))

    def conclusive(age_s: float, others_s: float) -> bool:
        link = dataclasses.replace(OPEN, rx_age_s=0.1, senders=(api.SenderFact(255, 190, others_s, 50, 0.0),))
        return run(autopilot_check, changed(age_s=age_s, quiet_s=age_s), link).evidence.conclusive

    assert [conclusive(3.8, 0.4), conclusive(5.8, 2.4)] == [True, True]
    assert [conclusive(0.2, 0.4), conclusive(4.0, 2.4)] == [False, False]


def test_a_reboot_is_reported_immediately() -> None:
    """The autopilot's own uptime proves it."""
    assert run(check(), changed(rebooted_s=0.1, reboots=1)).settle_s == 0.0


def test_a_reboot_ends_the_fault_of_the_silence_before() -> None:
    """The six silent seconds of a real one are a loss, since no one can know more; then the reboot is what ended it."""
    one = check()
    lost = run(one, changed(age_s=4.0))
    assert (lost.level, lost.condition) == (api.Level.ERROR, "autopilot_silent")
    assert "may be rebooting" in lost.summary
    back = run(one, changed(rebooted_s=0.2, reboots=1))
    assert (back.level, back.evidence.ended_by, back.ends_fault) == (api.Level.WARN, "reboot", True)
    assert run(one, changed(rebooted_s=31.0, reboots=1)).evidence.ended_by == "reboot"
    assert run(one, changed(rebooted_s=32.0, reboots=1)).evidence.ended_by == ""


def test_an_earlier_reboot_does_not_end_a_later_silence() -> None:
    """A reboot is credited only if it happened during the failure that it ends."""
    one = check()
    assert run(one, changed(rebooted_s=2.0, reboots=1)).evidence.ended_by == ""
    run(one, changed(age_s=4.0, rebooted_s=10.0, reboots=1))
    assert run(one, changed(rebooted_s=12.0, reboots=1)).evidence.ended_by == ""


def test_a_reported_reboot_does_not_end_the_next_silence() -> None:
    """The link hangs while the reboot is still reported; a second reboot ends its own silence."""
    one = check()
    run(one, changed(age_s=4.0))
    assert run(one, changed(rebooted_s=0.2, reboots=1)).evidence.ended_by == "reboot"
    for reboots, ended_by in ((1, ""), (2, "reboot")):
        lost = run(one, changed(age_s=4.0, rebooted_s=14.0, reboots=1))
        assert lost.level is api.Level.ERROR
        assert run(one, changed(rebooted_s=16.0, reboots=reboots)).evidence.ended_by == ended_by


def test_a_reboot_while_armed_ends_no_fault() -> None:
    """The vehicle may be falling."""
    one = check()
    run(one, changed(age_s=4.0, armed=True))
    result = run(one, changed(rebooted_s=0.2, reboots=1, rebooted_armed=True))
    assert (result.level, result.ends_fault) == (api.Level.ERROR, False)


def test_a_commanded_reboot_is_not_a_loss() -> None:
    """Known immediately where PHM receives the acknowledgement, also while the link is closed."""
    one = check()
    for link in (OPEN, api.LinkFact("fc", open=False)):
        result = run(one, changed(age_s=5.0, rebooting_s=5.2), link)
        assert (result.level, result.brief) == (api.Level.WARN, "autopilot rebooting")
    back = run(one, changed(rebooted_s=0.2, reboots=1))
    assert back.brief == "autopilot rebooted"


def test_a_commanded_reboot_that_does_not_happen_is_a_loss_or_nothing() -> None:
    """It stays away, it continues to send (the command was for the companion), or it is armed."""
    assert run(check(), changed(age_s=31.0, rebooting_s=31.0)).condition == "autopilot_silent"
    assert run(check(), changed(age_s=0.5, rebooting_s=10.0)).level is api.Level.OK
    assert run(check(), changed(age_s=5.0, rebooting_s=5.0, armed=True)).level is api.Level.ERROR
