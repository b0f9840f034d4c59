"""A ground station's computer that was suspended or busy loses no agent for it."""

from __future__ import annotations

from phm.core.scheduling_delay import WINDOW_S
from phm.gcs.station import LATE_MOST_S, GroundStation
from phm.testing import FakeClock, settings
from tests.gcs.bench import beat, pilot

PERIOD_S = 2.0


def heard() -> tuple[GroundStation, FakeClock]:
    """A ground station whose links are not opened, which has received agent 7 and its autopilot for a while."""
    clock = FakeClock()
    made = settings(mavlink={"endpoints": [{"url": "udpin:127.0.0.1:14550"}], "component_id": 190})
    station = GroundStation(made.mavlink, 254, clock)
    for _ in range(10):
        for frame in (beat(7), pilot(7)):
            station._store.hear(frame, "gcs", clock.stamp())
        clock.advance(PERIOD_S)
        station._tick()
    return station, clock


def presence(station: GroundStation) -> tuple[str, str]:
    body = station.snapshot()[1].body
    return body["agents"][0]["presence"], next(iter(body["pilots"].values()))["presence"]


def test_after_a_pause_of_the_ground_everyone_has_its_time_again() -> None:
    """As long as its pause was, and no longer: who stays silent after is lost."""
    station, clock = heard()
    clock.be_late(40.0)
    station._tick()
    assert presence(station) == ("alive", "alive")
    clock.advance(WINDOW_S)
    station._tick()
    assert presence(station) == ("lost", "lost")


def test_a_ground_that_is_busy_for_good_still_finds_who_is_lost() -> None:
    """Its delays of the last minute put a loss off by a few seconds."""
    station, clock = heard()
    for _ in range(round((5 * PERIOD_S + 2 * LATE_MOST_S) / 0.5)):
        clock.advance(0.1)
        clock.be_late(0.4)
        station._tick()
    assert presence(station) == ("lost", "lost")
