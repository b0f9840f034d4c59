"""The link probe on closed endpoints, and the messages that its tests inject."""

from __future__ import annotations

from typing import Any

from phm.probes.links import Links
from phm.testing import FakeClock, settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from tests.fakes.mavlink import Sender, heartbeat

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
LINKS = [
    {"url": "udpin:127.0.0.1:14550", "name": "radio"},
    {"url": "udpin:127.0.0.1:14551", "name": "router", "leads_to": "router"},
    {"url": "udpin:127.0.0.1:14552", "name": "ground", "leads_to": "ground"},
    {"url": "udpin:127.0.0.1:14553", "name": "peers", "leads_to": "peers"},
]


class Scene:
    """The probe of agent 7 on a hub with closed endpoints, into which the test injects messages."""

    def __init__(self, **mavlink_settings: Any) -> None:
        self.clock, self.wakes = FakeClock(), 0
        chosen = settings(agent={"id": 7}, mavlink={"gcs_timeout": 10, "endpoints": LINKS, **mavlink_settings})
        self.hub = MavlinkHub(chosen.mavlink, 7, self.clock)
        self.links = Links(self.hub, chosen.agent.id, chosen.mavlink, self.clock, self.wake)

    def wake(self) -> None:
        self.wakes += 1

    def receive(self, system: int, component: int, message: Any, link: str = "radio", *, signed: bool = False) -> int:
        """Receive a message and return the number of wake-ups that followed."""
        before = self.wakes
        received = Sender(system, component).received(message)
        received._signed = signed
        self.hub._deliver(received, link)
        return self.wakes - before

    def pass_time(self, seconds: float) -> int:
        before = self.wakes
        self.clock.advance(seconds)
        self.links.wake_if_changed()
        return self.wakes - before


GCS = heartbeat(kind=mavlink.MAV_TYPE_GCS)


def pilot(*, armed: bool = False, mode: int = 5) -> Any:
    return heartbeat(mode, kind=mavlink.MAV_TYPE_QUADROTOR, autopilot=3, base_mode=81 | (ARMED if armed else 0))


def steady(scene: Scene, heartbeats: int = 130) -> None:
    """A ground station and an autopilot, each with one heartbeat per second, on a link that is read all the time."""
    scene.hub.read_at = lambda link: scene.clock.mono()  # type: ignore[method-assign]
    for _ in range(heartbeats):
        scene.receive(255, 190, GCS)
        scene.receive(7, 1, pilot())
        scene.clock.advance(1.0)
    scene.receive(255, 190, GCS)
    scene.receive(7, 1, pilot())


def overdue(scene: Scene) -> tuple[bool, bool]:
    gcs, flying = scene.links.gcs(), scene.links.autopilot()
    assert gcs is not None
    assert flying is not None
    return gcs.overdue, flying.overdue


def radio_status(**fields: int) -> Any:
    usual = {"rssi": 180, "remrssi": 170, "txbuf": 98, "noise": 40, "remnoise": 50, "rxerrors": 0, "fixed": 0}
    return mavlink.MAVLink_radio_status_message(**{**usual, **fields})


def boot(boot_ms: int) -> Any:
    return mavlink.MAVLink_system_time_message(0, boot_ms)
