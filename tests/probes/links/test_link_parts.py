"""Parts of the link probe: senders and their gaps, traffic over time, radios, reboots of the autopilot, ports in use."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import termios
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

from phm.facts import LinkFact
from phm.probes.adaptive_timeout import LEARN_S
from phm.probes.autopilot_state import TWINS, AutopilotState
from phm.probes.link_radio import RadioState
from phm.probes.link_stats import LOSS_S, MIN_FRAMES, LinkStats
from phm.probes.serial_port_users import users
from phm.recovery.safety.armed_state import ArmedState, LastArmedState, assess
from phm.transport import serial_errors
from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import Codec
from phm.transport.mavlink_traffic import MAX_SENDERS, SenderTable, Traffic
from phm.transport.serial_errors import SerialErrorCount
from tests.fakes.mavlink import Sender, heartbeat
from tests.fakes.until import until

BASE = LinkFact("ground", open=True)
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


# ---------------------------------------------------------------- gaps in sequence numbers


def counted(sequences: Iterable[int]) -> tuple[int, int]:
    """Frames and lost frames of one sender."""
    senders = SenderTable()
    for number in sequences:
        senders.heard(1, 1, number % 256)
    return senders.now().get((1, 1), (0, 0))


@given(st.integers(0, 255), st.lists(st.integers(0, 60), max_size=300))
def test_skipped_sequence_numbers_are_lost_frames(start: int, gaps: list[int]) -> None:
    """Each gap counts in full, also across the wrap-around of the number."""
    sequences, at = [start], start
    for gap in gaps:
        at += gap + 1
        sequences.append(at)
    assert counted(sequences) == (len(sequences), sum(gaps))


def test_duplicate_and_reordered_frames_are_not_lost() -> None:
    """By two routes, or in another order: a received frame is not missing."""
    assert counted([1, 1, 2, 2, 3]) == (3, 0)
    assert counted([1, 3, 2, 4]) == (4, 0)
    assert counted([254, 0, 255, 1]) == (4, 0)


def test_a_restarted_sender_has_lost_nothing() -> None:
    """After a reboot, or a pause, the number may have any value."""
    assert counted([10, 11, 140, 141])[1] == 0
    assert counted([200, 201, 70, 71])[1] == 0


def test_senders_are_limited() -> None:
    """Forged senders do not displace a real one."""
    senders = SenderTable()
    for number in range(100):
        senders.heard(1, 1, number)
    for made_up in range(1000):
        senders.heard(2 + made_up // 250, made_up % 250, 0)
    assert len(senders.now()) == MAX_SENDERS
    assert senders.now()[1, 1] == (100, 0)


def test_ignored_frames_count_as_well() -> None:
    """Loss is measured with all frames, though most are never decoded."""
    codec = Codec(7, 193, lambda number: False)
    sender, reader = Sender(7, 1), codec.parser()
    frames = [sender.frame(heartbeat(n), v1=n % 2 == 0) for n in range(10)]
    for frame in frames[:3] + frames[5:]:
        assert reader.feed(frame) == []
    assert codec.senders.now() == {(7, 1): (8, 2)}


def test_the_old_message_id_of_radio_status_is_accepted() -> None:
    """Radios with old firmware send RADIO, id 166, which is treated as RADIO_STATUS."""
    radio = mavlink.mavlink_map[166](180, 170, 90, 40, 45, 3, 4)
    radio._header.msgId = 166
    frame = Sender(51, 68).frame(radio, v1=True)
    assert frame[5] == 166
    codec = Codec(7, 193, lambda number: number == mavlink.MAVLINK_MSG_ID_RADIO_STATUS)
    (message,) = codec.parser().feed(frame)
    assert message.get_msgId() == mavlink.MAVLINK_MSG_ID_RADIO_STATUS
    assert (message.rssi, message.remrssi, message.txbuf, message.rxerrors, message.fixed) == (180, 170, 90, 3, 4)


# ---------------------------------------------------------------- traffic over time


def test_the_traffic_is_unknown_at_first() -> None:
    """One sample makes no rate."""
    flow = LinkStats((7, 193))
    assert flow.fact(0.0, BASE) == BASE
    flow.sample(10.0, Traffic(bytes_in=100))
    fact = flow.fact(10.2, BASE)
    assert (fact.rx_s, fact.frames_s, fact.line) == (None, None, None)
    assert fact.rx_age_s == pytest.approx(0.2)


def test_rates_are_means_over_the_last_seconds() -> None:
    """Bytes, frames, false frame starts and line errors per second; the age shows a pause."""
    flow = LinkStats((7, 193))
    for second in range(20):
        moving = min(second, 10)
        flow.sample(
            float(second),
            Traffic(100 * moving, 10 * second, 5 * moving, moving, line=SerialErrorCount(2 * second, 0, 0)),
        )
        if second == 9:
            fact = flow.fact(9.0, BASE)
            assert (fact.rx_s, fact.tx_s, fact.frames_s, fact.bad_s) == (100.0, 10.0, 5.0, 1.0)
            assert fact.line is not None
            assert fact.line.framing_s == 2.0
            assert fact.rx_age_s == 0.0
    fact = flow.fact(19.0, BASE)
    assert (fact.rx_s, fact.tx_s, fact.rx_age_s) == (0.0, 10.0, 9.0)


def test_samples_may_be_offered_at_any_rate() -> None:
    """The thread of each endpoint does so."""
    flow = LinkStats((7, 193))
    for step in range(2000):
        flow.sample(step * 0.01, Traffic(bytes_in=step))
    assert len(flow._totals) < 20
    assert flow.fact(20.0, BASE).rx_s == pytest.approx(100.0, rel=0.01)


def test_loss_is_reported_per_sender_over_a_window() -> None:
    """Of the last half minute, and only with enough frames; PHM's own echo does not count as a sender."""
    flow = LinkStats((7, 193))
    counts = {(1, 1): (0, 0), (255, 190): (0, 0), (7, 193): (0, 0)}
    for second in range(int(LOSS_S) + 70):
        lost = min(60, second)
        counts = {(1, 1): (9 * second, lost), (255, 190): (second // 4, 0), (7, 193): (second, 0)}
        flow.sample(float(second), Traffic(bytes_in=second, senders=counts))
        if second == 50:
            early = flow.fact(50.0, BASE).senders
            assert [(one.system, one.component) for one in early] == [(1, 1), (255, 190)]
            assert early[0].loss_percent == pytest.approx(10.0)
            assert early[1].loss_percent is None
            assert early[1].frames < MIN_FRAMES
    (pilot, ground) = flow.fact(100.0, BASE).senders
    assert pilot.loss_percent == 0.0
    assert (pilot.age_s, ground.age_s) == (1.0, 4.0)


def test_a_sender_that_was_forgotten_and_returned_has_lost_nothing() -> None:
    """Its counters start again."""
    flow = LinkStats((7, 193))
    flow.sample(0.0, Traffic(senders={(1, 1): (500, 90)}))
    flow.sample(5.0, Traffic(senders={(1, 1): (30, 0)}))
    (sender,) = flow.fact(5.0, BASE).senders
    assert sender.loss_percent is None
    assert sender.frames == 0


# ---------------------------------------------------------------- radios


def status(**fields: int) -> Any:
    usual = {"rssi": 180, "remrssi": 170, "txbuf": 98, "noise": 40, "remnoise": 50, "rxerrors": 0, "fixed": 0}
    return mavlink.MAVLink_radio_status_message(**{**usual, **fields})


def test_a_radio_that_was_never_received_is_none() -> None:
    """Unknown is not zero."""
    assert RadioState("ground").fact(5.0) is None


def test_a_radio_reports_its_numbers() -> None:
    """Age, margins as means, and errors as rates."""
    radio = RadioState("ground")
    for second in range(6):
        radio.hear(float(second), status(rssi=180 + second, rxerrors=4 * second, fixed=second), 1.0)
    fact = radio.fact(7.0)
    assert fact is not None
    assert (fact.link, fact.age_s, fact.rssi, fact.txbuf) == ("ground", 2.0, 185, 98)
    assert (fact.margin, fact.remmargin) == (143.0, 120.0)
    assert (fact.rxerrors_s, fact.fixed_s) == (4.0, 1.0)


def test_values_that_a_radio_does_not_know_are_none() -> None:
    """255 means unknown; without a noise value there is no margin."""
    radio = RadioState("ground")
    radio.hear(0.0, status(remrssi=255, noise=255), 1.0)
    fact = radio.fact(0.0)
    assert fact is not None
    assert (fact.remrssi, fact.noise, fact.margin, fact.remmargin) == (None, None, None, None)
    assert (fact.rxerrors_s, fact.fixed_s) == (None, None)


def test_a_radio_without_contact_to_the_other_one_is_alone() -> None:
    """Zeros instead of the other one's values, as a SiK radio sends them; not a weak signal, and over immediately."""
    radio = RadioState("ground")
    radio.hear(0.0, status(), 1.0)
    radio.hear(1.0, status(remrssi=0, remnoise=0), 1.0)
    fact = radio.fact(1.0)
    assert fact is not None
    assert (fact.alone, fact.remrssi, fact.remnoise, fact.remmargin, fact.margin) == (True, None, None, None, 140.0)
    radio.hear(2.0, status(), 1.0)
    back = radio.fact(2.0)
    assert back is not None
    assert (back.alone, back.remrssi, back.remmargin) == (False, 170, 120.0)


def test_a_radio_that_never_reports_the_other_one_is_not_alone() -> None:
    """Some report zeros all the time."""
    radio = RadioState("ground")
    for second in range(5):
        radio.hear(float(second), status(remrssi=0, remnoise=0), 1.0)
    fact = radio.fact(4.0)
    assert fact is not None
    assert (fact.alone, fact.remmargin) == (False, None)


def test_counters_of_a_restarted_radio_are_not_negative() -> None:
    """They start at zero again."""
    radio = RadioState("ground")
    for second, errors in enumerate([60000, 60002, 3, 4]):
        radio.hear(float(second), status(rxerrors=errors), 1.0)
    fact = radio.fact(3.0)
    assert fact is not None
    assert fact.rxerrors_s == pytest.approx(2.0)


def test_the_period_of_a_radio_adapts() -> None:
    """At first that of PHM's heartbeats, which it answers; then as measured; one long pause does not count."""
    radio = RadioState("ground")
    radio.hear(0.0, status(), 5.0)
    first = radio.fact(0.0)
    assert first is not None
    assert first.due_s == 5.0
    for at in (1.0, 2.0, 3.0, 4.0, 5.0, 65.0, 66.0):
        radio.hear(at, status(), 5.0)
    later = radio.fact(66.0)
    assert later is not None
    assert later.due_s == 1.0
    radio.hear(67.0, status(), 10.0)
    asked_less = radio.fact(67.0)
    assert asked_less is not None
    assert asked_less.due_s == 10.0


# ---------------------------------------------------------------- reboots of the autopilot


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
    assert pilot.twins(50.0)
    receive_heartbeat(pilot, 50.0)
    fact = fact_of(pilot, 50.0)
    assert fact.rebooted_s is None
    assert assess(fact, 3.5).state is ArmedState.ARMED


def test_an_acknowledged_reboot_is_known_until_it_has_happened() -> None:
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
    assert pilot.twins(4.0)
    assert fact_of(pilot, 4.0).rebooted_s is None
    assert not pilot.twins(30.0)
    slow = AutopilotState()
    for number in range(TWINS):
        slow.booted(10.0 * number, 8_000)
        slow.booted(10.0 * number + 5.0, 500)
    assert not slow.twins(36.0)


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


# ---------------------------------------------------------------- serial ports


def test_users_of_a_port_are_named(tmp_path: Path) -> None:
    """Another program by name and pid; PHM itself is omitted; a symlink to the port is resolved."""
    far, near = pty.openpty()
    path = os.ttyname(near)
    named = tmp_path / "by-id"
    named.symlink_to(path)
    code = f"import os; os.open({path!r}, os.O_RDWR | os.O_NOCTTY); print('open', flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"open\n"
        found = users(str(named))
        assert len(found) == 1
        assert found[0].endswith(f"({other.pid})")
        assert "python" in found[0]
        other.communicate(b"\n")
    until(lambda: not users(path), "the port to be free")
    os.close(far)
    os.close(near)


def test_inaccessible_processes_are_skipped(tmp_path: Path) -> None:
    """Processes that terminate meanwhile, or belong to other users, raise nothing."""
    (tmp_path / "1").mkdir()
    (tmp_path / "2" / "fd").mkdir(parents=True)
    (tmp_path / "2" / "fd" / "0").write_text("no link")
    (tmp_path / "self").mkdir()
    assert users("/dev/ttyUSB0", tmp_path) == ()


def test_a_port_keeps_its_dtr() -> None:
    """Closing it must not drop the line that resets the device; a port whose driver does not count reports nothing."""
    far, near = pty.openpty()
    attributes = termios.tcgetattr(near)
    attributes[2] |= termios.HUPCL
    termios.tcsetattr(near, termios.TCSANOW, attributes)
    serial_errors.keep_dtr(near)
    assert not termios.tcgetattr(near)[2] & termios.HUPCL
    assert serial_errors.read_counts(near) is None
    os.close(far)
    os.close(near)
    serial_errors.keep_dtr(near)  # a port that is gone raises nothing


def test_line_errors_are_read_in_the_layout_of_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    """frame, overrun, parity and buf_overrun of struct serial_icounter_struct."""
    counters = bytearray(80)
    for at, value in ((6, 11), (7, 20), (8, 33), (10, 4)):
        counters[at * 4 : at * 4 + 4] = value.to_bytes(4, sys.byteorder)
    monkeypatch.setattr("phm.transport.serial_errors.fcntl.ioctl", lambda fd, request, data: bytes(counters))
    assert serial_errors.read_counts(0) == SerialErrorCount(framing=11, overrun=24, parity=33)
