"""A suspended or busy computer of the ground station loses no agent because of that."""

from __future__ import annotations

from phm.core.scheduling_delay import WINDOW_S
from phm.gcs.station import LATE_MOST_S, GroundStation
from phm.testing import FakeClock, settings
from tests.gcs.bench import autopilot, phm_heartbeat

PERIOD_S = 2.0


def receiving_station() -> tuple[GroundStation, FakeClock]:
    """A ground station with closed links, which has received agent 7 and its autopilot for a while."""
    clock = FakeClock()
    made = settings(mavlink={"endpoints": [{"url": "udpin:127.0.0.1:14550"}], "component_id": 190})
    station = GroundStation(made.mavlink, 254, clock)
    for _ in range(10):
        for frame in (phm_heartbeat(7), autopilot(7)):
            station._store.receive(frame, "gcs", clock.stamp())
        clock.advance(PERIOD_S)
        station._tick()
    return station, clock


def presence(station: GroundStation) -> tuple[str, str]:
    body = station.snapshot()[1].body
    return body["agents"][0]["presence"], next(iter(body["autopilots"].values()))["presence"]


def test_after_a_pause_of_the_ground_every_agent_has_its_full_time() -> None:
    """As long as the pause, and no longer: an agent that stays silent is lost."""
    station, clock = receiving_station()
    clock.be_late(40.0)
    station._tick()
    assert presence(station) == ("alive", "alive")
    clock.advance(WINDOW_S)
    station._tick()
    assert presence(station) == ("lost", "lost")


def test_a_permanently_busy_ground_still_detects_a_loss() -> None:
    """Its delays of the last minute postpone a loss by a few seconds."""
    station, clock = receiving_station()
    for _ in range(round((5 * PERIOD_S + 2 * LATE_MOST_S) / 0.5)):
        clock.advance(0.1)
        clock.be_late(0.4)
        station._tick()
    assert presence(station) == ("lost", "lost")
