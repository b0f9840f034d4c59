"""State of the autopilot: reboots, and whether its heartbeat is overdue."""

from __future__ import annotations

from typing import Any

import pytest

from phm.probes.adaptive_timeout import LEARN_S
from phm.probes.autopilot_state import TWINS, AutopilotState
from phm.recovery.safety.armed_state import ArmedState, LastArmedState, assess
from phm.transport.dialect import mavlink
from tests.fakes.mavlink import heartbeat

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
STANDBY, BOOT = mavlink.MAV_STATE_STANDBY, mavlink.MAV_STATE_BOOT


def receive_heartbeat(pilot: AutopilotState, at: float, *, armed: bool = False, status: int = STANDBY) -> None:
    message = heartbeat(5, kind=2, autopilot=3, base_mode=81 | (ARMED if armed else 0))
    message.system_status = status
    pilot.heartbeat(at, message, "fc")


def fact_of(pilot: AutopilotState, now: float) -> Any:
    fact = pilot.fact(now)
    assert fact is not None
    return fact


def test_an_autopilot_that_was_never_received_is_none() -> None:
    """A time since boot alone is not a heartbeat."""
    pilot = AutopilotState()
    pilot.booted(1.0, 500)
    assert pilot.fact(2.0) is None


def test_a_reboot_is_detected_by_a_decreasing_uptime() -> None:
    """Counted once, with its age; the uptime continues from there."""
    pilot = AutopilotState()
    receive_heartbeat(pilot, 0.0)
    for second in range(10):
        pilot.booted(float(second), 60_000 + 1000 * second)
    assert fact_of(pilot, 10.0).reboots == 0
    assert fact_of(pilot, 10.0).boot_s == pytest.approx(70.0)
    pilot.booted(12.0, 800)
    pilot.booted(13.0, 1800)
    fact = fact_of(pilot, 14.0)
    assert (fact.reboots, fact.rebooted_s, fact.rebooted_armed) == (1, 2.0, False)
    assert fact.boot_s == pytest.approx(2.8)


def test_reordered_messages_are_not_a_reboot() -> None:
    """Some have the time of a measurement, and the number wraps around after 49.7 days."""
    pilot = AutopilotState()
    receive_heartbeat(pilot, 0.0)
    for at, boot_ms in ((1.0, 60_000), (1.1, 58_500), (1.2, 60_200), (2.0, 2**32 - 500), (3.0, 400)):
        pilot.booted(at, boot_ms)
    assert fact_of(pilot, 4.0).reboots == 0


@pytest.mark.parametrize("heartbeat_first", [True, False], ids=["heartbeat first", "time first"])
def test_a_reboot_while_armed_is_reported_as_such(heartbeat_first: bool) -> None:
    """Even if the first heartbeat after it, disarmed, arrives before the new uptime."""
    pilot = AutopilotState()
    receive_heartbeat(pilot, 0.0)
    receive_heartbeat(pilot, 1.0, armed=True)
    pilot.booted(1.0, 90_000)
    receive_heartbeat(pilot, 9.0, armed=True)
    pilot.booted(9.0, 98_000)
    if heartbeat_first:
        receive_heartbeat(pilot, 11.5)
    pilot.booted(11.6, 600)
    assert fact_of(pilot, 12.0).rebooted_armed


def test_a_reboot_after_landing_is_not_in_flight() -> None:
    """Disarmed before the reboot: an operator may have caused it."""
    pilot = AutopilotState()
    receive_heartbeat(pilot, 1.0, armed=True)
    receive_heartbeat(pilot, 5.0)
    pilot.booted(6.0, 98_000)
    pilot.booted(9.0, 600)
    fact = fact_of(pilot, 9.0)
    assert (fact.reboots, fact.rebooted_armed) == (1, False)


def test_a_reboot_is_recognized_by_the_state_boot() -> None:
    """As recorded from an ArduPilot with default streams: heartbeats with BOOT, the text, then STANDBY. One reboot."""
    pilot = AutopilotState()
    for at in range(40):
        receive_heartbeat(pilot, float(at))
    for at in (46.0, 47.0):
        receive_heartbeat(pilot, at, status=BOOT)
    pilot.ready(47.5)
    receive_heartbeat(pilot, 48.0)
    pilot.booted(55.0, 10_000)
    fact = fact_of(pilot, 56.0)
    assert (fact.reboots, fact.rebooted_s, fact.rebooted_armed) == (1, 10.0, False)


@pytest.mark.parametrize("time_first", [True, False])
def test_several_signs_of_one_reboot_count_once(time_first: bool) -> None:
    """The time since boot may arrive before or after the first heartbeat."""
    pilot = AutopilotState()
    for at in range(40):
        receive_heartbeat(pilot, float(at), armed=True)
        pilot.booted(at + 0.1, 90_000 + 1000 * at)
    if time_first:
        pilot.booted(45.9, 900)
    receive_heartbeat(pilot, 46.0, status=BOOT)
    pilot.booted(46.1, 1_100)
    pilot.ready(47.5)
    receive_heartbeat(pilot, 48.0)
    fact = fact_of(pilot, 48.0)
    assert (fact.reboots, fact.rebooted_armed) == (1, True)
    receive_heartbeat(pilot, 90.0, status=BOOT)
    assert fact_of(pilot, 90.0).reboots == 2


def test_an_autopilot_that_starts_together_with_phm_has_not_rebooted() -> None:
    """Its first heartbeats say BOOT, and the text follows."""
    pilot = AutopilotState()
    receive_heartbeat(pilot, 0.0, status=BOOT)
    receive_heartbeat(pilot, 1.0, status=mavlink.MAV_STATE_CALIBRATING)
    pilot.ready(1.5)
    receive_heartbeat(pilot, 2.0)
    assert fact_of(pilot, 3.0).reboots == 0


@pytest.mark.parametrize("armed", [False, True])
def test_the_text_shows_a_reboot_without_the_state_boot(armed: bool) -> None:
    """A plane says CALIBRATING meanwhile. It was armed if it was so before the silence."""
    pilot = AutopilotState()
    for at in range(40):
        receive_heartbeat(pilot, float(at), armed=armed)
    receive_heartbeat(pilot, 46.0, status=mavlink.MAV_STATE_CALIBRATING)
    pilot.ready(50.0)
    pilot.booted(52.0, 10_000)
    fact = fact_of(pilot, 53.0)
    assert (fact.reboots, fact.rebooted_s, fact.rebooted_armed) == (1, 3.0, armed)


def fly(pilot: AutopilotState, *, times: bool = False) -> None:
    """40 s in the air, until 39. times: with its time since boot."""
    for second in range(40):
        receive_heartbeat(pilot, float(second), armed=True)
        if times:
            pilot.booted(second + 0.1, 90_000 + 1000 * second)


def test_late_heartbeats_of_another_link_are_the_same_reboot() -> None:
    """Its delayed BOOT arrives after the first link's STANDBY, and another one after that."""
    pilot = AutopilotState(10.0)
    fly(pilot)
    for at, status in ((45.5, BOOT), (46.5, STANDBY), (46.8, BOOT), (47.5, STANDBY), (47.8, BOOT), (48.8, STANDBY)):
        receive_heartbeat(pilot, at, status=status)
    fact = fact_of(pilot, 49.0)
    assert (fact.reboots, fact.rebooted_armed) == (1, True)
    assert assess(fact, 10.0).state is ArmedState.ARMED


def test_the_first_boot_may_arrive_after_standby() -> None:
    """The other link lost it. What was reported after the silence says nothing about the time before."""
    pilot = AutopilotState(10.0)
    fly(pilot)
    receive_heartbeat(pilot, 45.5)
    receive_heartbeat(pilot, 45.8, status=BOOT)
    fact = fact_of(pilot, 46.0)
    assert (fact.reboots, fact.rebooted_armed) == (1, True)


def test_a_reordered_heartbeat_of_a_short_start_is_armed() -> None:
    """On one UDP link, without a silence: the last armed heartbeat arrives after the first BOOT."""
    pilot = AutopilotState()
    fly(pilot)
    for at, status, armed in ((42.0, STANDBY, False), (42.1, BOOT, False), (42.2, STANDBY, True), (43.0, BOOT, False)):
        receive_heartbeat(pilot, at, status=status, armed=armed)
    receive_heartbeat(pilot, 44.0, status=mavlink.MAV_STATE_CRITICAL)
    receive_heartbeat(pilot, 45.0, status=BOOT)
    fact = fact_of(pilot, 45.0)
    assert (fact.reboots, fact.rebooted_armed) == (1, True)


def test_a_late_time_of_the_last_run_is_the_same_reboot() -> None:
    """A message that was sent before the reboot and arrives after it counts as no second one."""
    pilot = AutopilotState()
    fly(pilot, times=True)
    for at, boot_ms in ((46.0, 900), (46.5, 130_000), (47.0, 1900)):
        pilot.booted(at, boot_ms)
    fact = fact_of(pilot, 47.0)
    assert (fact.reboots, fact.rebooted_armed) == (1, True)


def test_the_time_since_boot_may_come_later_than_the_first_heartbeat() -> None:
    """By another link, 1.3 s behind: from its time the start would be after that heartbeat."""
    pilot = AutopilotState()
    fly(pilot, times=True)
    receive_heartbeat(pilot, 45.5)
    receive_heartbeat(pilot, 46.5)
    pilot.booted(47.0, 1_200)
    fact = fact_of(pilot, 47.0)
    assert (fact.reboots, fact.rebooted_armed) == (1, True)


@pytest.mark.parametrize("by_time", [True, False])
def test_a_second_reboot_within_the_start_counts(by_time: bool) -> None:
    """It has its own silence, or has run for less time than has passed since the first. In the air both count as armed."""
    pilot = AutopilotState()
    fly(pilot)
    receive_heartbeat(pilot, 46.0, status=BOOT)
    pilot.booted(46.1, 900)
    if by_time:
        for second in range(47, 56):
            receive_heartbeat(pilot, float(second))
        pilot.booted(54.0, 8_800)
        pilot.booted(56.0, 500)
    else:
        receive_heartbeat(pilot, 48.0)
        receive_heartbeat(pilot, 54.5, status=BOOT)
    fact = fact_of(pilot, 56.0)
    assert (fact.reboots, fact.rebooted_armed) == (2, True)


def test_a_long_timeout_hides_no_reboot() -> None:
    """A plane: no BOOT, and the text follows its first disarmed heartbeats. Until then the silence is enough."""
    pilot, flew = AutopilotState(10.0), LastArmedState(True, 0.0)
    fly(pilot)
    for at in range(46, 54):
        receive_heartbeat(pilot, float(at), status=mavlink.MAV_STATE_CALIBRATING)
    assert assess(fact_of(pilot, 53.0), 10.0, flew).state is ArmedState.ARMED
    pilot.ready(53.5)
    assert fact_of(pilot, 54.0).rebooted_armed


def test_two_autopilots_with_one_identity_hide_no_reboot_in_flight() -> None:
    """Times since boot of another link that is further behind than the reboot lasted."""
    pilot = AutopilotState()
    fly(pilot, times=True)
    receive_heartbeat(pilot, 46.0, status=BOOT)
    for step in range(TWINS * 2):
        pilot.booted(46.0 + step * 0.5, 130_000 if step % 2 else 1000 + step * 500)
    assert pilot.identity_shared(50.0)
    receive_heartbeat(pilot, 50.0)
    fact = fact_of(pilot, 50.0)
    assert fact.rebooted_s is None
    assert assess(fact, 3.5).state is ArmedState.ARMED


def test_an_acknowledged_reboot_is_known_until_it_has_happened() -> None:
    """`rebooting_s` is the time since the acknowledgement."""
    pilot = AutopilotState()
    receive_heartbeat(pilot, 0.0)
    pilot.commanded(1.0)
    receive_heartbeat(pilot, 1.1)
    assert fact_of(pilot, 5.0).rebooting_s == 4.0
    receive_heartbeat(pilot, 7.0, status=BOOT)
    assert fact_of(pilot, 8.0).rebooting_s is None


def test_a_pause_resets_the_time_since_disarming() -> None:
    """Arming ends it, and silence for longer than the timeout restarts it."""
    pilot = AutopilotState()
    for at in (0.0, 3.0, 6.0):
        receive_heartbeat(pilot, at)
    assert fact_of(pilot, 7.0).disarmed_for_s == 7.0
    receive_heartbeat(pilot, 10.0)
    assert fact_of(pilot, 11.0).disarmed_for_s == 1.0
    receive_heartbeat(pilot, 12.0, armed=True)
    assert fact_of(pilot, 12.0).disarmed_for_s is None
    receive_heartbeat(pilot, 13.0)
    assert fact_of(pilot, 14.0).disarmed_for_s == 1.0


def test_two_autopilots_with_one_identity_are_not_reboots() -> None:
    """Their uptimes alternate faster than any vehicle can boot; a vehicle in a reboot loop takes longer."""
    pilot = AutopilotState()
    receive_heartbeat(pilot, 0.0)
    for step in range(TWINS * 2 + 1):
        pilot.booted(step * 0.5, 600_000 if step % 2 else 20_000)
    assert pilot.identity_shared(4.0)
    assert fact_of(pilot, 4.0).rebooted_s is None
    assert not pilot.identity_shared(30.0)
    slow = AutopilotState()
    for number in range(TWINS):
        slow.booted(10.0 * number, 8_000)
        slow.booted(10.0 * number + 5.0, 500)
    assert not slow.identity_shared(36.0)


def known(pilot: AutopilotState, period_s: float = 1.0) -> float:
    """Receive it regularly for as long as the learning takes; return the time of the last heartbeat."""
    count = int(LEARN_S / period_s) + 5
    for number in range(count):
        receive_heartbeat(pilot, number * period_s)
        pilot.booted(number * period_s + 0.1, 100_000 + int(number * period_s * 1000))
    return (count - 1) * period_s


def overdue(pilot: AutopilotState, now: float, read_at: float | None) -> bool:
    fact = pilot.fact(now, lambda link: read_at)
    assert fact is not None
    return fact.overdue


def test_a_regular_autopilot_is_overdue_early() -> None:
    """After two and a half heartbeat periods, if its link was read until then; never if that is unknown."""
    pilot = AutopilotState()
    last = known(pilot)
    assert not overdue(pilot, last + 2.1, last + 2.1)
    assert not overdue(pilot, last + 9.0, last + 2.1)
    assert not overdue(pilot, last + 9.0, None)
    assert overdue(pilot, last + 2.6, last + 2.6)
    receive_heartbeat(pilot, last + 2.7)
    assert not overdue(pilot, last + 2.8, last + 2.8)


def test_an_autopilot_with_other_frames_is_not_overdue() -> None:
    """Its heartbeats are lost or late."""
    pilot = AutopilotState()
    last = known(pilot)
    pilot.booted(last + 2.2, 300_000)
    assert not overdue(pilot, last + 2.8, last + 2.8)
    assert overdue(pilot, last + 3.4, last + 3.4)


@pytest.mark.parametrize("heartbeat_first", [True, False], ids=["heartbeat first", "time first"])
def test_the_pause_of_a_reboot_does_not_raise_the_limit(heartbeat_first: bool) -> None:
    """After it the period of the autopilot is known as before."""
    pilot = AutopilotState()
    last = known(pilot)
    at = last + 2.3
    if heartbeat_first:
        receive_heartbeat(pilot, at)
    pilot.booted(at + 0.1, 100)
    for number in range(4):
        receive_heartbeat(pilot, at + 0.2 + number)
    assert fact_of(pilot, at + 3.5).due_s == pytest.approx(2.5)
