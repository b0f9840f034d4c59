"""Contract with a real ArduPilot: its recorded frames through the real link code, checks and tracker."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from phm.api import Level
from phm.recovery.safety.armed_state import ArmedState
from tests.fakes.recorded_flight import RecordedFlight

Record = Callable[..., RecordedFlight]


@pytest.fixture
def record() -> Iterator[Record]:
    made: list[RecordedFlight] = []

    def open_one(name: str, *closes: float) -> RecordedFlight:
        made.append(RecordedFlight(name, *closes))
        return made[-1]

    yield open_one
    for flight in made:
        flight.close()


def flight(record: Record) -> RecordedFlight:
    """With default parameters. The connection closes when the autopilot reboots, at 111.2."""
    return record("hang_reboot_companion.tlog.gz", 111.25)


def test_arming_and_landing_are_followed(record: Record) -> None:
    """Armed is a bit of the base mode, which lasts from before take-off until after landing."""
    made, states = flight(record), []
    for at_s in (40.0, 46.5, 50.5, 100.0, 106.0, 110.0):
        made.play(at_s)
        states.append(made.armed_state)
    on_ground, in_air = ArmedState.DISARMED, ArmedState.ARMED
    assert states == [on_ground, in_air, in_air, in_air, on_ground, on_ground]


def test_a_hang_in_flight_is_one_fault(record: Record) -> None:
    """The ground station behind the autopilot is silent with it: a consequence. The vehicle counts as armed throughout."""
    made = flight(record)
    made.play(70.0)
    assert made.armed_state is ArmedState.ARMED
    assert "It was armed at its last heartbeat" in made.text("autopilot")
    made.play(80.0)
    (opened, closed) = made.published()
    assert opened[1] == "autopilot fault autopilot_silent"
    assert 64.5 <= opened[0] <= 66.5
    assert closed == (74.0, "autopilot resolved by itself")
    assert {state.level for state in made.tracker.states() if state.unit in ("autopilot", "gcs")} == {Level.OK}


def test_a_commanded_reboot_is_a_reboot(record: Record) -> None:
    """Six silent seconds are a loss, since no one on board can know more; the first heartbeat after them shows the reboot."""
    made = flight(record)
    made.play(110.0)
    before = len(made.published())
    made.play(116.0)
    assert "may be rebooting" in made.text("autopilot")
    made.play(143.0)
    opened, closed, warned = made.published()[before:]
    assert opened[1] == "autopilot fault autopilot_silent"
    assert 114.5 <= opened[0] <= 116.5
    assert closed == (118.2, "autopilot resolved by reboot")
    assert warned == (118.2, "autopilot warning autopilot rebooted")
    fact = made.probe.autopilot()
    assert fact is not None
    assert (fact.reboots, fact.rebooted_armed) == (1, False)
    made.play(149.0)
    assert made.tracker.state("autopilot").level is Level.OK


def test_a_mute_ground_station_is_one_fault(record: Record) -> None:
    """Silence of the recorded ground station opens one fault, and its next heartbeat closes it."""
    made = flight(record)
    made.play(143.0)
    before = len(made.published())
    made.play(176.0)
    opened, closed = made.published()[before:]
    assert opened[1] == "gcs fault gcs_lost"
    assert 149.0 <= opened[0] <= 155.0
    assert closed == (161.1, "gcs resolved by itself")


def test_a_reboot_with_streams_counts_once(record: Record) -> None:
    """The state BOOT, the time since boot and the text arrive within 2.5 s."""
    made = record("streams_reboot_companion.tlog.gz", 4.9)
    made.play(27.9)
    assert [words for _, words in made.published()] == [
        "autopilot fault autopilot_silent",
        "autopilot resolved by reboot",
        "autopilot warning autopilot rebooted",
    ]
    fact = made.probe.autopilot()
    assert fact is not None
    assert fact.reboots == 1
    assert fact.boot_s == pytest.approx(17.2, abs=1.0)
