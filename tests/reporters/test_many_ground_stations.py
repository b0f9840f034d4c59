"""A sender that uses one system id after another looks like many ground stations that appear."""

from __future__ import annotations

from phm.core.model import Level
from phm.transport.dialect import mavlink
from tests.fakes.mavlink import Sender, heartbeat
from tests.reporters.test_mavlink import Scene


def appear(scene: Scene, number: int) -> None:
    """A ground station with another id appears."""
    scene.port.receive(Sender(200 + number % 50, 190).received(heartbeat(kind=mavlink.MAV_TYPE_GCS)))


def full_states(scene: Scene, seconds: int, *, each_s: float) -> int:
    """How many full states are sent while a station appears in each of these periods."""
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.port.sent.clear()
    for number in range(round(seconds / each_s)):
        appear(scene, number)
        scene.pass_time(each_s)
    return [severity for severity, _ in scene.port.lines()].count(2)


def test_stations_that_appear_all_the_time_do_not_delay_the_full_state() -> None:
    """Each new one would otherwise postpone the answer to the one before without an end."""
    scene = Scene(agent=30, refresh=600).running()
    assert full_states(scene, 4, each_s=0.2) == 1


def test_full_states_are_limited() -> None:
    """Three, then one in the period of the refresh: they are more important than answers and views, which must leave, too."""
    scene = Scene(refresh=60).running()
    assert 8 <= full_states(scene, 360, each_s=5.0) <= 9
