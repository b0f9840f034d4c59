"""What the link probe makes of heartbeats: ground station, autopilot, and somebody with our identity."""

from __future__ import annotations

import socket
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.settings import Settings
from phm.probes.links import Links
from phm.testing import FakeClock, settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from tests.fakes.mavlink import Sender, heartbeat
from tests.fakes.until import until

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


LINKS = [
    {"url": "udpin:127.0.0.1:14550", "name": "radio"},
    {"url": "udpin:127.0.0.1:14551", "name": "router", "leads_to": "router"},
    {"url": "udpin:127.0.0.1:14552", "name": "ground", "leads_to": "ground"},
    {"url": "udpin:127.0.0.1:14553", "name": "peers", "leads_to": "peers"},
]


class Scene:
    """The probe of agent 7 on a hub whose endpoints are not opened, into which the test puts messages."""

    def __init__(self) -> None:
        self.clock, self.wakes = FakeClock(), 0
        chosen = settings(agent={"id": 7}, mavlink={"gcs_timeout": 10, "endpoints": LINKS})
        self.hub = MavlinkHub(chosen.mavlink, 7, self.clock)
        self.links = Links(self.hub, chosen.agent.id, chosen.mavlink, self.clock, self.wake)

    def wake(self) -> None:
        self.wakes += 1

    def hear(self, system: int, component: int, message: Any, link: str = "radio") -> int:
        """How many wakes followed."""
        before = self.wakes
        self.hub._deliver(Sender(system, component).received(message), link)
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


def steady(scene: Scene, beats: int = 130) -> None:
    """A ground station and an autopilot, a heartbeat a second each, on a link that is read all the time."""
    scene.hub.read_at = lambda link: scene.clock.mono()  # type: ignore[method-assign]
    for _ in range(beats):
        scene.hear(255, 190, GCS)
        scene.hear(7, 1, pilot())
        scene.clock.advance(1.0)
    scene.hear(255, 190, GCS)
    scene.hear(7, 1, pilot())


def overdue(scene: Scene) -> tuple[bool, bool]:
    gcs, flying = scene.links.gcs(), scene.links.autopilot()
    assert gcs is not None
    assert flying is not None
    return gcs.overdue, flying.overdue


def test_who_was_steady_is_overdue_before_the_timeout() -> None:
    """The autopilot after 2.5 s, the ground station after half of its timeout; each wakes the checks once."""
    scene = Scene()
    steady(scene)
    assert scene.pass_time(2.4) == 0
    assert (scene.pass_time(0.2), overdue(scene)) == (1, (False, True))
    assert scene.pass_time(2.3) == 1  # the autopilot's timeout
    assert (scene.pass_time(0.2), overdue(scene)) == (1, (True, True))
    scene.hear(255, 190, GCS)
    scene.hear(7, 1, pilot())
    assert overdue(scene) == (False, False)


def test_a_phm_that_stood_still_blames_nobody() -> None:
    """What came meanwhile is not read yet; and the pause is no habit of the sender after."""
    scene = Scene()
    steady(scene)
    stopped_at = scene.clock.mono()
    scene.hub.read_at = lambda link: stopped_at  # type: ignore[method-assign]
    scene.clock.advance(3.0)
    assert overdue(scene) == (False, False)
    scene.hear(255, 190, GCS)
    scene.hear(7, 1, pilot())
    scene.hub.read_at = lambda link: scene.clock.mono()  # type: ignore[method-assign]
    fact = scene.links.autopilot()
    assert fact is not None
    assert fact.due_s == 2.5


def radio_status(**fields: int) -> Any:
    usual = {"rssi": 180, "remrssi": 170, "txbuf": 98, "noise": 40, "remnoise": 50, "rxerrors": 0, "fixed": 0}
    return mavlink.MAVLink_radio_status_message(**{**usual, **fields})


def test_a_radio_that_lost_the_other_one_makes_the_agent_deaf() -> None:
    """Before gcs_timeout, but not while a ground station is heard all the same; it wakes the check."""
    scene = Scene()
    scene.hear(255, 190, GCS)
    scene.hear(51, 68, radio_status())
    scene.clock.advance(2.0)
    assert not scene.links.gcs_unreachable()
    assert scene.hear(51, 68, radio_status(remrssi=0, remnoise=0)) == 1
    assert not scene.links.gcs_unreachable()
    assert scene.pass_time(1.0) == 1
    assert scene.links.gcs_unreachable()
    assert scene.hear(255, 190, GCS) == 1
    assert not scene.links.gcs_unreachable()


def test_a_report_of_the_radio_wakes_the_check_when_it_says_something_new() -> None:
    """A full buffer or damaged packets are told when they are reported; the same again wakes nobody."""
    scene = Scene()
    scene.hear(51, 68, radio_status())
    scene.clock.advance(1.0)
    assert scene.hear(51, 68, radio_status()) == 1  # now errors a second are known
    scene.clock.advance(1.0)
    assert scene.hear(51, 68, radio_status()) == 0
    scene.clock.advance(1.0)
    assert scene.hear(51, 68, radio_status(txbuf=10)) == 1
    scene.clock.advance(1.0)
    assert scene.hear(51, 68, radio_status(txbuf=10, rxerrors=40)) == 1


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


def boot(boot_ms: int) -> Any:
    return mavlink.MAVLink_system_time_message(0, boot_ms)


def test_a_reboot_wakes_the_checks() -> None:
    """By the time since boot of the autopilot's own messages; others of the vehicle do not count."""
    scene = Scene()
    scene.hear(7, 1, pilot())
    assert scene.hear(7, 1, boot(60_000)) == 0
    assert scene.hear(7, 191, boot(100)) == 0
    assert scene.hear(8, 1, boot(100)) == 0
    scene.clock.advance(2.0)
    assert scene.hear(7, 1, boot(900)) == 1
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.reboots, fact.rebooted_s, fact.link) == (1, 0.0, "radio")
    assert fact.boot_s == pytest.approx(0.9)


def test_two_autopilots_with_our_system_id_are_told() -> None:
    """Their times since boot go back and forth; it is a mistake of the configuration, and no reboot."""
    scene = Scene()
    scene.hear(7, 1, pilot())
    for _ in range(5):
        scene.hear(7, 1, boot(600_000))
        scene.hear(7, 1, boot(20_000))
        scene.clock.advance(0.5)
    (problem,) = scene.links.problems()
    assert "two autopilots send as system 7" in problem
    fact = scene.links.autopilot()
    assert fact is not None
    assert fact.rebooted_s is None
    scene.clock.advance(30.0)
    assert scene.links.problems() == ()


@pytest.mark.parametrize("link", ["ground", "peers"])
def test_only_links_that_lead_to_the_autopilot_count(link: str) -> None:
    """Another vehicle with our ids, or a forger: neither disarms ours, nor reboots it, nor stands for it; it is reported."""
    scene = Scene()
    scene.hear(7, 1, pilot(armed=True))
    scene.hear(7, 1, boot(600_000))
    for _ in range(2):
        scene.hear(7, 1, pilot(), link)
        scene.hear(7, 1, boot(1_000), link)
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.armed, fact.disarmed_s, fact.link, fact.reboots) == (True, None, "radio", 0)
    (problem,) = scene.links.problems()
    assert f"autopilot with our system id 7 arrive by {link}, which does not lead to it" in problem
    assert scene.pass_time(31.0) >= 1
    assert scene.links.problems() == ()


def test_a_stray_autopilot_alone_is_none() -> None:
    """What comes by a link to the ground alone is never taken for ours."""
    scene = Scene()
    scene.hear(7, 1, pilot(), "ground")
    assert scene.links.autopilot() is None


def test_our_own_autopilot_passed_on_by_the_ground_is_no_duplicate() -> None:
    """Its time since boot is the same; it does not count for arming all the same."""
    scene = Scene()
    scene.hear(7, 1, boot(600_000))
    scene.hear(7, 1, pilot(armed=True))
    for _ in range(3):
        scene.clock.advance(1.0)
        scene.hear(7, 1, boot(600_500), "ground")
        scene.hear(7, 1, pilot(), "ground")
    assert scene.links.problems() == ()
    fact = scene.links.autopilot()
    assert fact is not None
    assert fact.armed


def test_two_links_that_disagree_count_as_armed_and_are_reported() -> None:
    """Both lead to the autopilot; whichever spoke last."""
    scene = Scene()
    for _ in range(4):
        scene.hear(7, 1, pilot(armed=True))
        scene.hear(7, 1, pilot(), "router")
        scene.clock.advance(1.0)
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.armed, fact.armed_s, fact.disarmed_s, fact.link) == (True, 1.0, 1.0, "router")
    (problem,) = scene.links.problems()
    assert "two autopilots send as system 7" in problem
    scene.clock.advance(9.5)
    scene.hear(7, 1, pilot(), "router")
    fact = scene.links.autopilot()
    assert fact is not None
    assert not fact.armed
    assert scene.links.problems() == ()


def test_arming_and_disarming_by_an_operator_is_no_duplicate() -> None:
    """A few changes, one after the other."""
    scene = Scene()
    for armed in (False, True, False, True):
        scene.hear(7, 1, pilot(armed=armed))
        scene.clock.advance(4.0)
    assert scene.links.problems() == ()


def test_what_phm_reads_after_a_suspension_may_be_old() -> None:
    """The pause is part of the fact, so that a disarmed heartbeat that waited in a buffer opens nothing."""
    scene = Scene()
    scene.hub.read_at = lambda link: 1000.0  # type: ignore[method-assign]
    scene.clock.advance(5.0 + 1000.0 - scene.clock.mono())
    scene.hear(7, 1, pilot())
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.disarmed_s, fact.stalled_s) == (0.0, 0.0)


def test_the_ground_station_is_known_with_its_link() -> None:
    """Which one, and by which endpoint."""
    scene = Scene()
    assert scene.links.gcs() is None
    scene.hear(254, 190, GCS)
    scene.clock.advance(2.0)
    gcs = scene.links.gcs()
    assert gcs is not None
    assert (gcs.age_s, gcs.system, gcs.component, gcs.link) == (2.0, 254, 190, "radio")


def test_a_radio_appears_and_is_lost() -> None:
    """By its RADIO_STATUS, whoever it calls itself; it is due as often as PHM's own heartbeats."""
    scene = Scene()
    assert scene.links.radios() == ()
    status = mavlink.MAVLink_radio_status_message(180, 170, 98, 40, 50, 0, 0)
    assert scene.hear(51, 68, status) == 1
    assert scene.hear(51, 68, status) == 0
    (radio,) = scene.links.radios()
    assert (radio.link, radio.age_s, radio.due_s, radio.rssi) == ("radio", 0.0, 2.0, 180)
    assert scene.pass_time(6.0) == 1
    assert scene.links.radios()[0].age_s == 6.0


def test_who_has_a_port_open_is_asked_within_a_deadline() -> None:
    """Nobody has this one."""
    assert Scene().links.users("/dev/null-and-void") == ()


def test_the_traffic_of_an_endpoint_is_known() -> None:
    """Bytes, frames and senders of a real socket, with their rates, and how long it has been silent."""
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

            def measured() -> bool:
                peer.sendto(sender.frame(pilot()), address)
                link = links.links()[0]
                return bool(link.rx_s and link.frames_s and link.senders and link.senders[0].frames > 20)

            until(measured, "the traffic being measured")
            (link,) = links.links()
            assert (link.name, link.open) == ("fc", True)
            assert [(one.system, one.component, one.loss_percent) for one in link.senders] == [(7, 1, 0.0)]
            assert link.rx_age_s is not None
            until(lambda: (links.links()[0].rx_age_s or 0.0) > 1.0, "its silence being seen")
        finally:
            hub.close()


def test_a_router_that_refuses_twice_leaves_the_agent_deaf() -> None:
    """It was there and is gone: nothing can come from the ground. When it is back, that is over."""
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    chosen: Settings = settings(
        agent={"id": 7}, mavlink={"endpoints": [{"url": f"tcp:127.0.0.1:{port}", "name": "r", "leads_to": "router"}]}
    )
    hub, wakes = MavlinkHub(chosen.mavlink, 7, SystemClock()), []
    links = Links(hub, chosen.agent.id, chosen.mavlink, SystemClock(), lambda: wakes.append(1))
    hub.start()
    try:
        client, _ = listener.accept()
        until(lambda: [link.open for link in links.links()] == [True], "the connection")
        assert not links.gcs_unreachable()
        until(lambda: hub.read_at("r") is not None, "it being read")
        listener.close()
        client.close()
        until(links.gcs_unreachable, "two refusals")
        (link,) = links.links()
        assert (link.open, link.failed >= 2, hub.read_at("r")) == (False, True, None)
        assert wakes
        with socket.create_server(("127.0.0.1", port)):
            until(lambda: not links.gcs_unreachable(), "the router being back")
            assert links.links()[0].failed == 0
    finally:
        hub.close()


def test_our_own_echo_is_no_duplicate() -> None:
    """A router that sends our frames back makes no alarm; a stranger on the same wire does."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as router:
        router.bind(("127.0.0.1", 0))
        router.settimeout(5.0)
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
            until(links.problems, "the duplicate being told")
        finally:
            hub.close()


@pytest.mark.parametrize("why", ["PHM did not run", "its link was not read"])
def test_what_waits_unread_is_no_silence(why: str) -> None:
    """Ground station, autopilot and radio are lost only as far as PHM ran and read; a link that is never read again hides a
    loss for one timeout more."""
    scene = Scene()
    scene.hub.read_at = lambda link: scene.clock.mono()  # type: ignore[method-assign]
    scene.hear(255, 190, GCS)
    scene.hear(7, 1, pilot())
    scene.hear(51, 68, radio_status())
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
