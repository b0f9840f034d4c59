"""Radios by their RADIO_STATUS."""

from __future__ import annotations

from typing import Any

import pytest

from phm.probes.link_radio import RadioState
from phm.transport.dialect import mavlink


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
        radio.receive(float(second), status(rssi=180 + second, rxerrors=4 * second, fixed=second), 1.0)
    fact = radio.fact(7.0)
    assert fact is not None
    assert (fact.link, fact.age_s, fact.rssi, fact.txbuf) == ("ground", 2.0, 185, 98)
    assert (fact.margin, fact.remmargin) == (143.0, 120.0)
    assert (fact.rxerrors_s, fact.fixed_s) == (4.0, 1.0)


def test_values_that_a_radio_does_not_know_are_none() -> None:
    """255 means unknown; without a noise value there is no margin."""
    radio = RadioState("ground")
    radio.receive(0.0, status(remrssi=255, noise=255), 1.0)
    fact = radio.fact(0.0)
    assert fact is not None
    assert (fact.remrssi, fact.noise, fact.margin, fact.remmargin) == (None, None, None, None)
    assert (fact.rxerrors_s, fact.fixed_s) == (None, None)


def test_a_radio_without_contact_to_the_other_one_is_alone() -> None:
    """Zeros instead of the other one's values, as a SiK radio sends them; not a weak signal, and over immediately."""
    radio = RadioState("ground")
    radio.receive(0.0, status(), 1.0)
    radio.receive(1.0, status(remrssi=0, remnoise=0), 1.0)
    fact = radio.fact(1.0)
    assert fact is not None
    assert (fact.alone, fact.remrssi, fact.remnoise, fact.remmargin, fact.margin) == (True, None, None, None, 140.0)
    radio.receive(2.0, status(), 1.0)
    back = radio.fact(2.0)
    assert back is not None
    assert (back.alone, back.remrssi, back.remmargin) == (False, 170, 120.0)


def test_a_radio_that_never_reports_the_other_one_is_not_alone() -> None:
    """Some report zeros all the time."""
    radio = RadioState("ground")
    for second in range(5):
        radio.receive(float(second), status(remrssi=0, remnoise=0), 1.0)
    fact = radio.fact(4.0)
    assert fact is not None
    assert (fact.alone, fact.remmargin) == (False, None)


def test_counters_of_a_restarted_radio_are_not_negative() -> None:
    """They start at zero again."""
    radio = RadioState("ground")
    for second, errors in enumerate([60000, 60002, 3, 4]):
        radio.receive(float(second), status(rxerrors=errors), 1.0)
    fact = radio.fact(3.0)
    assert fact is not None
    assert fact.rxerrors_s == pytest.approx(2.0)


def test_the_period_of_a_radio_adapts() -> None:
    """At first that of PHM's heartbeats, which it answers; then as measured; one long pause does not count."""
    radio = RadioState("ground")
    radio.receive(0.0, status(), 5.0)
    first = radio.fact(0.0)
    assert first is not None
    assert first.due_s == 5.0
    for at in (1.0, 2.0, 3.0, 4.0, 5.0, 65.0, 66.0):
        radio.receive(at, status(), 5.0)
    later = radio.fact(66.0)
    assert later is not None
    assert later.due_s == 1.0
    radio.receive(67.0, status(), 10.0)
    asked_less = radio.fact(67.0)
    assert asked_less is not None
    assert asked_less.due_s == 10.0
