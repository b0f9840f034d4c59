"""Contradictory armed states, from heartbeats to what recovery may do: only a received landing ends a contradiction."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from phm.probes.autopilot_state import AutopilotState
from phm.recovery.safety.armed_state import ArmedMonitor, ArmedStatus
from phm.testing import FakeClock
from phm.transport.dialect import mavlink
from tests.fakes.mavlink import heartbeat

TIMEOUT_S = 3.5
CABLE, ROUTER = "cable", "router"


class Flight:
    """Heartbeats once a second, and whether recovery is restricted after them."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.autopilot = AutopilotState(TIMEOUT_S)
        self.monitor = self._monitor()

    def _monitor(self) -> ArmedMonitor:
        return ArmedMonitor(lambda: self.autopilot.fact(self.clock.mono()), TIMEOUT_S, self.clock)

    def fly(self, seconds: int, reports: Iterable[tuple[str, bool]]) -> ArmedStatus:
        """reports: (link, armed) of each second, one after the other within it."""
        each = tuple(reports)
        for _ in range(seconds):
            for link, armed in each:
                self.clock.advance(1.0 / len(each))
                mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
                self.autopilot.heartbeat(
                    self.clock.mono(), heartbeat(5, kind=2, autopilot=3, base_mode=81 | mode), link
                )
                self.monitor.now()
        return self.monitor.now()

    def restart_phm(self) -> None:
        """PHM starts again with the state that it kept."""
        kept = self.monitor.kept()
        self.autopilot = AutopilotState(TIMEOUT_S)
        self.monitor = self._monitor()
        self.monitor.restore(kept)


@pytest.mark.parametrize("disarmed_link", [ROUTER, CABLE], ids=["two links", "one link"])
@pytest.mark.parametrize("restarted", [False, True], ids=["PHM runs on", "PHM restarts"])
def test_the_silence_of_the_armed_sender_is_not_a_landing(disarmed_link: str, restarted: bool) -> None:
    """Another sender that says disarmed, by accident or forged, opens nothing once the armed one is no longer received."""
    flight = Flight()
    flight.fly(60, [(CABLE, True)])
    assert flight.fly(20, [(CABLE, True), (disarmed_link, False)]).restricts
    if restarted:
        flight.restart_phm()
    found = flight.fly(90, [(disarmed_link, False)])
    assert found.restricts
    assert "another sender may use its id" in found.why


def test_a_received_landing_ends_the_contradiction() -> None:
    """The vehicle reports nothing but armed for a while, then disarmed."""
    flight = Flight()
    flight.fly(20, [(CABLE, True), (CABLE, False)])
    assert flight.fly(10, [(CABLE, True)]).restricts
    assert not flight.fly(10, [(CABLE, False)]).restricts


def test_a_landing_after_a_restart_ends_the_kept_contradiction() -> None:
    """The state file keeps the contradiction, and the landing of this run ends it."""
    flight = Flight()
    flight.fly(20, [(CABLE, True), (CABLE, False)])
    flight.restart_phm()
    assert flight.fly(10, [(CABLE, True)]).restricts
    assert not flight.fly(10, [(CABLE, False)]).restricts


def test_a_landing_on_two_links_is_one() -> None:
    """Both report it, one a moment later; neither needs the other one afterwards."""
    flight = Flight()
    flight.fly(60, [(CABLE, True), (ROUTER, True)])
    flight.fly(1, [(CABLE, False), (ROUTER, True)])
    assert not flight.fly(10, [(CABLE, False), (ROUTER, False)]).restricts
    assert not flight.fly(60, [(ROUTER, False)]).restricts


def test_a_link_that_broke_in_flight_vetoes_no_landing_on_another() -> None:
    """The other link has reported the flight, too, and its end."""
    flight = Flight()
    flight.fly(60, [(CABLE, True), (ROUTER, True)])
    flight.fly(60, [(ROUTER, True)])
    assert not flight.fly(10, [(ROUTER, False)]).restricts


def test_a_link_that_opens_after_a_broken_one_is_not_a_landing() -> None:
    """It has reported disarmed only, and the vehicle was last received armed."""
    flight = Flight()
    flight.fly(60, [(CABLE, True)])
    flight.fly(1, [])
    assert flight.fly(60, [(ROUTER, False)]).restricts


def test_arming_for_a_moment_is_not_a_contradiction() -> None:
    """An operator arms and disarms within a second or two: restricted for as long as a reboot in the air would explain it."""
    flight = Flight()
    flight.fly(10, [(CABLE, False)])
    flight.fly(2, [(CABLE, True)])
    assert not flight.fly(40, [(CABLE, False)]).restricts
