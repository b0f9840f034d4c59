"""Identities, traffic, and silence of senders on the links."""

from __future__ import annotations

import socket
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.settings import Settings
from phm.facts import LinkFact
from phm.probes.links import Links
from phm.testing import settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from tests.fakes.mavlink import Sender, heartbeat
from tests.fakes.until import until
from tests.probes.links.links_scene import GCS, Scene, overdue, pilot, radio_status, steady


def test_an_identity_that_was_never_received_is_unknown() -> None:
    """None, not an age."""
    scene = Scene()
    assert scene.links.gcs_age_s() is None
    assert scene.links.autopilot() is None
    assert scene.links.problems() == ()


@pytest.mark.parametrize(
    ("system", "component", "message"),
    [
        (8, 1, pilot()),
        (7, 191, heartbeat()),
        (7, 190, GCS),
        (255, 190, heartbeat(kind=mavlink.MAV_TYPE_ONBOARD_CONTROLLER)),
    ],
    ids=["another vehicle", "another companion", "an onboard program that claims to be a GCS", "not a GCS"],
)
def test_other_senders_are_neither_ground_station_nor_our_autopilot(system: int, component: int, message: Any) -> None:
    """Only MAV_TYPE_GCS of another system is a ground station, only our system's component 1 is our autopilot."""
    scene = Scene()
    assert scene.receive(system, component, message) == 0
    assert scene.links.gcs_age_s() is None
    assert scene.links.autopilot() is None


def test_a_regular_sender_is_overdue_before_the_timeout() -> None:
    """The autopilot after 2.5 s, the ground station after half of its timeout; each wakes the checks once."""
    scene = Scene()
    steady(scene)
    assert scene.pass_time(2.4) == 0
    assert (scene.pass_time(0.2), overdue(scene)) == (1, (False, True))
    assert scene.pass_time(2.3) == 1  # the autopilot's timeout
    assert (scene.pass_time(0.2), overdue(scene)) == (1, (True, True))
    scene.receive(255, 190, GCS)
    scene.receive(7, 1, pilot())
    assert overdue(scene) == (False, False)


def test_a_suspended_phm_reports_no_loss() -> None:
    """Messages of that time are not read yet; and the pause is not learned as one of the sender."""
    scene = Scene()
    steady(scene)
    stopped_at = scene.clock.mono()
    scene.hub.read_at = lambda link: stopped_at  # type: ignore[method-assign]
    scene.clock.advance(3.0)
    assert overdue(scene) == (False, False)
    scene.receive(255, 190, GCS)
    scene.receive(7, 1, pilot())
    scene.hub.read_at = lambda link: scene.clock.mono()  # type: ignore[method-assign]
    fact = scene.links.autopilot()
    assert fact is not None
    assert fact.due_s == 2.5


def test_a_sender_with_our_identity_is_reported() -> None:
    """Two heartbeats that we did not send are a problem, which ends when they end."""
    scene = Scene()
    assert scene.receive(7, 193, heartbeat()) == 0
    assert scene.links.problems() == ()
    assert scene.receive(7, 193, heartbeat()) == 1
    (problem,) = scene.links.problems()
    assert "system 7 component 193" in problem
    assert scene.pass_time(31.0) == 1
    assert scene.links.problems() == ()


def test_an_unused_port_has_no_users(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine it may take longer than PHM waits to look at all processes."""
    monkeypatch.setattr("phm.probes.links.USERS_S", 120.0)
    assert Scene().links.users("/dev/null-and-void") == ()


def test_the_traffic_of_an_endpoint_is_measured() -> None:
    """Bytes, frames and senders of a real socket, with their rates, and the duration of its silence."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        url = f"udpout:127.0.0.1:{peer.getsockname()[1]}"
        chosen: Settings = settings(agent={"id": 7}, mavlink={"endpoints": [{"url": url, "name": "fc"}]})
        hub = MavlinkHub(chosen.mavlink, 7, SystemClock())
        links = Links(hub, chosen.agent.id, chosen.mavlink, SystemClock(), lambda: None)
        hub.start()
        try:
            hub.send(heartbeat())
            _, address = peer.recvfrom(300)
            sender = Sender(7, 1)

            def measured() -> LinkFact | None:
                peer.sendto(sender.frame(pilot()), address)
                (link,) = links.links()
                known = link.rx_s and link.frames_s and link.senders and link.senders[0].frames > 20
                return link if known else None

            link = until(measured, "the measurement of the traffic")
            assert (link.name, link.open) == ("fc", True)
            assert [(one.system, one.component, one.loss_percent) for one in link.senders] == [(7, 1, 0.0)]
            assert link.rx_age_s is not None
            until(lambda: (links.links()[0].rx_age_s or 0.0) > 1.0, "its silence")
        finally:
            hub.close()


def test_our_own_echo_is_not_a_duplicate() -> None:
    """A router that echoes our frames raises no alarm; another sender on the same link does."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as router:
        router.bind(("127.0.0.1", 0))
        router.settimeout(60.0)
        url = f"udpout:127.0.0.1:{router.getsockname()[1]}"
        chosen: Settings = settings(agent={"id": 7}, mavlink={"endpoints": [{"url": url}]})
        hub = MavlinkHub(chosen.mavlink, 7, SystemClock())
        links = Links(hub, chosen.agent.id, chosen.mavlink, SystemClock(), lambda: None)
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
            until(links.problems, "a report of the duplicate")
        finally:
            hub.close()


@pytest.mark.parametrize("why", ["PHM did not run", "its link was not read"])
def test_unread_data_is_not_silence(why: str) -> None:
    """Ground station, autopilot and radio are lost only if PHM ran and read their link; a link that is never read again hides
    a loss for one more timeout."""
    scene = Scene()
    scene.hub.read_at = lambda link: scene.clock.mono()  # type: ignore[method-assign]
    scene.receive(255, 190, GCS)
    scene.receive(7, 1, pilot())
    scene.receive(51, 68, radio_status())
    if why == "PHM did not run":
        scene.clock.be_late(15.0)
    else:
        read_at = scene.clock.mono()
        scene.hub.read_at = lambda link: read_at  # type: ignore[method-assign]
        scene.clock.advance(3.6)

    def silent_s() -> tuple[float, float, float]:
        gcs, flying, radio = scene.links.gcs(), scene.links.autopilot(), scene.links.radios()[0]
        assert gcs is not None
        assert flying is not None
        return gcs.silent_s, flying.silent_s, radio.silent_s

    assert max(silent_s()) < 1.0
    scene.clock.advance(20.0)
    gcs_s, pilot_s, radio_s = silent_s()
    assert gcs_s > 10.0
    assert pilot_s > 3.5
    assert radio_s > 10.0


def test_after_a_reload_the_senders_of_before_are_known() -> None:
    """An autopilot, a ground station and a radio that are lost do not become senders that were never there."""
    scene = Scene()
    steady(scene, 5)
    scene.receive(51, 68, radio_status())
    scene.clock.advance(60.0)
    before = scene.links
    scene.links = Links(scene.hub, before._system, before._settings, scene.clock, scene.wake)
    assert (scene.links.autopilot(), scene.links.gcs(), scene.links.radios()) == (None, None, ())
    scene.links.resume(before)
    flying, gcs, (radio,) = scene.links.autopilot(), scene.links.gcs(), scene.links.radios()
    assert flying is not None and gcs is not None
    assert (flying.age_s, gcs.age_s, radio.age_s) == (60.0, 60.0, 60.0)
    scene.receive(7, 1, pilot())
    flying = scene.links.autopilot()
    assert flying is not None and flying.age_s == 0.0
