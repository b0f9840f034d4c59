"""What the link probe makes of heartbeats: ground station, autopilot, and somebody with our identity."""

from __future__ import annotations

import socket
from typing import Any

import pytest

from phm.clock import SystemClock
from phm.probes.links import Links
from phm.settings import Settings
from phm.testing import FakeClock, settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from tests.fakes.mavlink import Sender, heartbeat, until

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


class Scene:
    """The probe of agent 7 on a hub without endpoints, into which the test puts messages."""

    def __init__(self) -> None:
        self.clock, self.wakes = FakeClock(), 0
        chosen = settings(agent={"id": 7}, mavlink={"gcs_timeout": 10})
        self.hub = MavlinkHub(chosen.mavlink, 7, self.clock)
        self.links = Links(self.hub, chosen, self.clock, self.wake)

    def wake(self) -> None:
        self.wakes += 1

    def hear(self, system: int, component: int, message: Any) -> int:
        """How many wakes followed."""
        before = self.wakes
        self.hub._deliver(Sender(system, component).received(message), "radio")
        return self.wakes - before

    def pass_time(self, seconds: float) -> int:
        before = self.wakes
        self.clock.advance(seconds)
        self.links.look()
        return self.wakes - before


GCS = heartbeat(kind=mavlink.MAV_TYPE_GCS)


def pilot(*, armed: bool = False, mode: int = 5) -> Any:
    return heartbeat(mode, kind=mavlink.MAV_TYPE_QUADROTOR, autopilot=3, base_mode=81 | (ARMED if armed else 0))


def test_nothing_heard_is_not_known() -> None:
    """Never heard is None, not an age."""
    scene = Scene()
    assert scene.links.gcs_age_s() is None
    assert scene.links.autopilot() is None
    assert scene.links.problems() == ()


def test_a_ground_station_appears_and_is_lost() -> None:
    """Its age counts from the last heartbeat; appearing and getting lost wake the check, each once."""
    scene = Scene()
    assert scene.hear(255, 190, GCS) == 1
    assert scene.hear(255, 190, GCS) == 0
    assert scene.pass_time(9.0) == 0
    assert scene.links.gcs_age_s() == pytest.approx(9.0)
    assert scene.pass_time(2.0) == 1
    assert scene.pass_time(2.0) == 0
    assert scene.hear(254, 190, GCS) == 1
    assert scene.links.gcs_age_s() == 0.0


@pytest.mark.parametrize(
    ("system", "component", "message"),
    [
        (8, 1, pilot()),
        (7, 191, heartbeat()),
        (7, 190, GCS),
        (255, 190, heartbeat(kind=mavlink.MAV_TYPE_ONBOARD_CONTROLLER)),
    ],
    ids=["another vehicle", "another companion", "a program aboard that says GCS", "no GCS"],
)
def test_others_are_neither_ground_station_nor_our_autopilot(system: int, component: int, message: Any) -> None:
    """Only MAV_TYPE_GCS of another system is a ground station, only our system's component 1 our autopilot."""
    scene = Scene()
    assert scene.hear(system, component, message) == 0
    assert scene.links.gcs_age_s() is None
    assert scene.links.autopilot() is None


def test_arming_is_seen_at_once() -> None:
    """Arming and disarming wake the check; the mode and the system's state are passed on."""
    scene = Scene()
    assert scene.hear(7, 1, pilot(mode=4)) == 1
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.armed, fact.custom_mode, fact.system_status, fact.age_s) == (False, 4, 4, 0.0)
    assert scene.hear(7, 1, pilot(armed=True)) == 1
    fact = scene.links.autopilot()
    assert fact is not None
    assert fact.armed
    assert scene.hear(7, 1, pilot()) == 1


def test_a_silent_autopilot_ages() -> None:
    """Another component of the same system does not hide that the autopilot is silent."""
    scene = Scene()
    scene.hear(7, 1, pilot())
    assert scene.pass_time(3.0) == 0
    assert scene.hear(7, 193, heartbeat()) == 0
    assert scene.pass_time(1.0) == 1
    fact = scene.links.autopilot()
    assert fact is not None
    assert fact.age_s == pytest.approx(4.0)


def test_somebody_with_our_identity_is_told() -> None:
    """Two heartbeats that we did not send make a problem, which ends when they do."""
    scene = Scene()
    assert scene.hear(7, 193, heartbeat()) == 0
    assert scene.links.problems() == ()
    assert scene.hear(7, 193, heartbeat()) == 1
    (problem,) = scene.links.problems()
    assert "system 7 component 193" in problem
    assert scene.pass_time(31.0) == 1
    assert scene.links.problems() == ()


def test_our_own_echo_is_no_duplicate() -> None:
    """A router that sends our frames back makes no alarm; a stranger on the same wire does."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as router:
        router.bind(("127.0.0.1", 0))
        router.settimeout(5.0)
        url = f"udpout:127.0.0.1:{router.getsockname()[1]}"
        chosen: Settings = settings(agent={"id": 7}, mavlink={"endpoints": [{"url": url}]})
        hub = MavlinkHub(chosen.mavlink, 7, SystemClock())
        links = Links(hub, chosen, SystemClock(), lambda: None)
        hub.start()
        try:
            (counters,) = hub.counters().values()
            for count in range(1, 6):
                hub.send(heartbeat(count))
                frame, sender = router.recvfrom(300)
                router.sendto(frame, sender)
                until(lambda wanted=count: counters.received == wanted)  # type: ignore[misc]
            assert links.problems() == ()
            stranger = Sender(7, 193)
            for count in (6, 7):
                router.sendto(stranger.frame(heartbeat(99)), sender)
                until(lambda wanted=count: counters.received == wanted)  # type: ignore[misc]
            until(links.problems, "the duplicate being told")
        finally:
            hub.close()
