"""The link probe's view of heartbeats: ground station, autopilot, and other senders with our identity."""

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
from phm.wire.gcs_marker import MONITOR
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
        self.links.look()
        return self.wakes - before


GCS = heartbeat(kind=mavlink.MAV_TYPE_GCS)


def pilot(*, armed: bool = False, mode: int = 5) -> Any:
    return heartbeat(mode, kind=mavlink.MAV_TYPE_QUADROTOR, autopilot=3, base_mode=81 | (ARMED if armed else 0))


def test_an_identity_that_was_never_received_is_unknown() -> None:
    """None, not an age."""
    scene = Scene()
    assert scene.links.gcs_age_s() is None
    assert scene.links.autopilot() is None
    assert scene.links.problems() == ()


def test_a_ground_station_appears_and_is_lost() -> None:
    """Its age counts from the last heartbeat; appearing and getting lost each wake the check once."""
    scene = Scene()
    assert scene.receive(255, 190, GCS) == 1
    assert scene.receive(255, 190, GCS) == 0
    assert scene.pass_time(9.0) == 0
    assert scene.links.gcs_age_s() == pytest.approx(9.0)
    assert scene.pass_time(2.0) == 1
    assert scene.pass_time(2.0) == 0
    assert scene.receive(254, 190, GCS) == 1
    assert scene.links.gcs_age_s() == 0.0


PHM_GCS = heartbeat(MONITOR, kind=mavlink.MAV_TYPE_GCS)


def leaving(custom_mode: int = 0) -> Any:
    message = heartbeat(custom_mode, kind=mavlink.MAV_TYPE_GCS)
    message.system_status = mavlink.MAV_STATE_POWEROFF
    return message


def test_phm_gcs_is_not_the_pilots_ground_station() -> None:
    """Its loss is not reported, with or without a farewell; relays still depend on it."""
    scene = Scene()
    scene.receive(254, 190, PHM_GCS)
    assert scene.links.gcs() is None
    assert scene.links.gcs_age_s() == 0.0
    scene.receive(255, 190, GCS)
    scene.pass_time(11.0)
    scene.receive(254, 190, PHM_GCS)
    lost = scene.links.gcs()
    assert lost is not None and (lost.system, lost.age_s) == (255, pytest.approx(11.0))
    assert scene.links.gcs_age_s() == 0.0


@pytest.mark.parametrize(("pilots", "counted"), [([], 250), ([254], 254), ([255], None)])
def test_listed_systems_are_the_pilots(pilots: list[int], counted: int | None) -> None:
    """`mavlink.pilots`: only those, and `phm gcs`, too, if it is listed."""
    scene = Scene(pilots=pilots)
    scene.receive(250, 190, GCS)
    scene.receive(254, 190, PHM_GCS)
    fact = scene.links.gcs()
    assert (None if fact is None else fact.system) == counted


def test_a_station_that_announces_its_end_is_not_lost() -> None:
    """Without another one none is expected; another one that is received still counts."""
    scene = Scene()
    scene.receive(255, 190, GCS)
    assert scene.receive(255, 190, leaving()) == 1
    fact = scene.links.gcs()
    assert fact is not None and fact.left
    scene.receive(250, 190, GCS)
    scene.receive(255, 190, GCS)
    scene.receive(255, 190, leaving())
    fact = scene.links.gcs()
    assert fact is not None and (fact.left, fact.system) == (False, 250)


def test_a_farewell_does_not_hide_the_loss_of_another_station() -> None:
    """The pilot's station died without one; a second one, which says goodbye, ends only itself."""
    scene = Scene()
    scene.receive(255, 190, GCS)
    scene.pass_time(11.0)
    scene.receive(254, 190, GCS)
    scene.receive(254, 190, leaving())
    fact = scene.links.gcs()
    assert fact is not None
    assert (fact.left, fact.system, fact.age_s) == (False, 255, pytest.approx(11.0))
    scene.receive(255, 190, leaving())
    fact = scene.links.gcs()
    assert fact is not None and fact.left


def test_a_station_that_has_signed_leaves_only_with_a_signature() -> None:
    """Anybody on the link can send an unsigned farewell; an unsigned heartbeat before it changes nothing."""
    scene = Scene()
    scene.receive(255, 190, GCS, signed=True)
    scene.receive(255, 190, GCS)
    scene.receive(255, 190, leaving())
    fact = scene.links.gcs()
    assert fact is not None and not fact.left
    scene.receive(255, 190, leaving(), signed=True)
    fact = scene.links.gcs()
    assert fact is not None and fact.left


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


def test_arming_is_detected_immediately() -> None:
    """Arming and disarming wake the check; mode and system state are part of the fact."""
    scene = Scene()
    assert scene.receive(7, 1, pilot(mode=4)) == 1
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.armed, fact.custom_mode, fact.system_status, fact.age_s) == (False, 4, 4, 0.0)
    assert scene.receive(7, 1, pilot(armed=True)) == 1
    fact = scene.links.autopilot()
    assert fact is not None
    assert fact.armed
    assert scene.receive(7, 1, pilot()) == 1


def test_a_silent_autopilot_ages() -> None:
    """Another component of the same system does not hide that the autopilot is silent."""
    scene = Scene()
    scene.receive(7, 1, pilot())
    assert scene.pass_time(3.0) == 0
    assert scene.receive(7, 193, heartbeat()) == 0
    assert scene.pass_time(1.0) == 1
    fact = scene.links.autopilot()
    assert fact is not None
    assert fact.age_s == pytest.approx(4.0)


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


def radio_status(**fields: int) -> Any:
    usual = {"rssi": 180, "remrssi": 170, "txbuf": 98, "noise": 40, "remnoise": 50, "rxerrors": 0, "fixed": 0}
    return mavlink.MAVLink_radio_status_message(**{**usual, **fields})


def test_a_radio_without_contact_disconnects_the_agent_from_the_ground() -> None:
    """Before `gcs_timeout`, but not while a ground station is still received; it wakes the check."""
    scene = Scene()
    scene.receive(255, 190, GCS)
    scene.receive(51, 68, radio_status())
    scene.clock.advance(2.0)
    assert not scene.links.gcs_unreachable()
    assert scene.receive(51, 68, radio_status(remrssi=0, remnoise=0)) == 1
    assert not scene.links.gcs_unreachable()
    assert scene.pass_time(1.0) == 1
    assert scene.links.gcs_unreachable()
    assert scene.receive(255, 190, GCS) == 1
    assert not scene.links.gcs_unreachable()


def test_a_radio_report_wakes_the_check_when_it_has_news() -> None:
    """A full buffer or damaged packets are reported when they occur; the same values again wake nothing."""
    scene = Scene()
    scene.receive(51, 68, radio_status())
    scene.clock.advance(1.0)
    assert scene.receive(51, 68, radio_status()) == 1  # the error rate is known now
    scene.clock.advance(1.0)
    assert scene.receive(51, 68, radio_status()) == 0
    scene.clock.advance(1.0)
    assert scene.receive(51, 68, radio_status(txbuf=10)) == 1
    scene.clock.advance(1.0)
    assert scene.receive(51, 68, radio_status(txbuf=10, rxerrors=40)) == 1


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


def boot(boot_ms: int) -> Any:
    return mavlink.MAVLink_system_time_message(0, boot_ms)


def test_a_reboot_wakes_the_checks() -> None:
    """By the uptime in the autopilot's own messages; other components of the vehicle do not count."""
    scene = Scene()
    scene.receive(7, 1, pilot())
    assert scene.receive(7, 1, boot(60_000)) == 0
    assert scene.receive(7, 191, boot(100)) == 0
    assert scene.receive(8, 1, boot(100)) == 0
    scene.clock.advance(2.0)
    assert scene.receive(7, 1, boot(900)) == 1
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.reboots, fact.rebooted_s, fact.link) == (1, 0.0, "radio")
    assert fact.boot_s == pytest.approx(0.9)


def test_announcements_of_a_reboot_wake_the_checks() -> None:
    """By the acknowledgement of the command where PHM receives it, and by the text at the end of the start."""
    scene = Scene()
    scene.receive(7, 1, pilot())
    accepted = mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 0)
    denied = mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 2)
    armed = mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    scene.clock.advance(40.0)
    scene.receive(7, 1, pilot())
    assert [scene.receive(7, 1, message) for message in (denied, armed)] == [0, 0]
    assert scene.receive(7, 191, accepted) == 0
    assert scene.receive(7, 1, accepted, "ground") == 0
    assert scene.receive(7, 1, accepted) == 1
    ready = mavlink.MAVLink_statustext_message(6, b"ArduPilot Ready")
    assert scene.receive(7, 193, ready) == 0
    assert scene.receive(7, 1, ready) == 1
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.reboots, fact.rebooting_s) == (1, None)


def requests(scene: Scene) -> list[tuple[Any, str]]:
    """Commands that were sent, with their link."""
    sent: list[tuple[Any, str]] = []
    scene.hub.send = lambda message, *more, link="", **others: sent.append((message, link))  # type: ignore[method-assign]
    return sent


def test_the_time_since_boot_is_requested_only_where_configured() -> None:
    """By default PHM sends the autopilot nothing."""
    scene = Scene()
    sent = requests(scene)
    scene.receive(7, 1, pilot())
    scene.links._sample()
    assert sent == []


def test_a_missing_time_since_boot_is_requested() -> None:
    """SYSTEM_TIME once a second, from the vehicle's autopilot on its link, also after a reboot; not while it arrives."""
    scene = Scene(request_boot_time=True)
    sent = requests(scene)
    scene.links._sample()
    assert sent == []
    scene.receive(7, 1, pilot())
    scene.links._sample()
    ((message, link),) = sent
    assert (message.target_system, message.target_component, link) == (7, 1, "radio")
    assert (message.command, message.param1, message.param2) == (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 2, 1e6)
    for second in range(20):
        scene.receive(7, 1, pilot())
        scene.receive(7, 1, boot(60_000 + second * 1000))
        scene.clock.advance(1.0)
        scene.links._sample()
    assert len(sent) == 1
    scene.clock.advance(6.0)
    scene.links._sample()
    assert len(sent) == 1
    scene.receive(7, 1, pilot())
    scene.links._sample()
    assert len(sent) == 2


def test_two_autopilots_with_our_system_id_are_reported() -> None:
    """Their uptimes alternate; it is a configuration mistake, not a reboot."""
    scene = Scene()
    scene.receive(7, 1, pilot())
    for _ in range(5):
        scene.receive(7, 1, boot(600_000))
        scene.receive(7, 1, boot(20_000))
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
    """Another vehicle with our ids, or a forged one, neither disarms, reboots nor replaces ours; it is reported."""
    scene = Scene()
    scene.receive(7, 1, pilot(armed=True))
    scene.receive(7, 1, boot(600_000))
    for _ in range(2):
        scene.receive(7, 1, pilot(), link)
        scene.receive(7, 1, boot(1_000), link)
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.armed, fact.disarmed_s, fact.link, fact.reboots) == (True, None, "radio", 0)
    (problem,) = scene.links.problems()
    assert f"autopilot with our system id 7 arrive by {link}, which does not lead to it" in problem
    assert scene.pass_time(31.0) >= 1
    assert scene.links.problems() == ()


def test_an_autopilot_on_a_ground_link_only_is_ignored() -> None:
    """A sender that is received only by a link to the ground is never accepted as ours."""
    scene = Scene()
    scene.receive(7, 1, pilot(), "ground")
    assert scene.links.autopilot() is None


def test_our_own_autopilot_forwarded_by_the_ground_is_not_a_duplicate() -> None:
    """Its uptime is the same; it still does not count for arming."""
    scene = Scene()
    scene.receive(7, 1, boot(600_000))
    scene.receive(7, 1, pilot(armed=True))
    for _ in range(3):
        scene.clock.advance(1.0)
        scene.receive(7, 1, boot(600_500), "ground")
        scene.receive(7, 1, pilot(), "ground")
    assert scene.links.problems() == ()
    fact = scene.links.autopilot()
    assert fact is not None
    assert fact.armed


def test_two_links_that_disagree_count_as_armed_and_are_reported() -> None:
    """Both lead to the autopilot; the order of messages does not matter."""
    scene = Scene()
    for _ in range(4):
        scene.receive(7, 1, pilot(armed=True))
        scene.receive(7, 1, pilot(), "router")
        scene.clock.advance(1.0)
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.armed, fact.armed_s, fact.disarmed_s, fact.link) == (True, 1.0, 1.0, "router")
    (problem,) = scene.links.problems()
    assert "two autopilots send as system 7" in problem
    scene.clock.advance(9.5)
    scene.receive(7, 1, pilot(), "router")
    fact = scene.links.autopilot()
    assert fact is not None
    assert not fact.armed
    assert scene.links.problems() == ()


def test_arming_and_disarming_by_an_operator_is_not_a_duplicate() -> None:
    """A few changes, one after the other."""
    scene = Scene()
    for armed in (False, True, False, True):
        scene.receive(7, 1, pilot(armed=armed))
        scene.clock.advance(4.0)
    assert scene.links.problems() == ()


def test_data_that_phm_reads_after_a_suspension_may_be_old() -> None:
    """The pause is part of the fact, so that a disarmed heartbeat from a buffer permits nothing."""
    scene = Scene()
    scene.hub.read_at = lambda link: 1000.0  # type: ignore[method-assign]
    scene.clock.advance(5.0 + 1000.0 - scene.clock.mono())
    scene.receive(7, 1, pilot())
    fact = scene.links.autopilot()
    assert fact is not None
    assert (fact.disarmed_s, fact.stalled_s) == (0.0, 0.0)


def test_the_ground_station_is_known_with_its_link() -> None:
    """Its identity and its endpoint."""
    scene = Scene()
    assert scene.links.gcs() is None
    scene.receive(254, 190, GCS)
    scene.clock.advance(2.0)
    gcs = scene.links.gcs()
    assert gcs is not None
    assert (gcs.age_s, gcs.system, gcs.component, gcs.link) == (2.0, 254, 190, "radio")


def test_a_radio_appears_and_is_lost() -> None:
    """By its RADIO_STATUS, with any identity; it is due as often as PHM's own heartbeats."""
    scene = Scene()
    assert scene.links.radios() == ()
    status = mavlink.MAVLink_radio_status_message(180, 170, 98, 40, 50, 0, 0)
    assert scene.receive(51, 68, status) == 1
    assert scene.receive(51, 68, status) == 0
    (radio,) = scene.links.radios()
    assert (radio.link, radio.age_s, radio.due_s, radio.rssi) == ("radio", 0.0, 2.0, 180)
    assert scene.pass_time(6.0) == 1
    assert scene.links.radios()[0].age_s == 6.0


def test_users_of_a_port_are_queried_within_a_deadline() -> None:
    """This port has none."""
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

            def measured() -> bool:
                peer.sendto(sender.frame(pilot()), address)
                link = links.links()[0]
                return bool(link.rx_s and link.frames_s and link.senders and link.senders[0].frames > 20)

            until(measured, "the measurement of the traffic")
            (link,) = links.links()
            assert (link.name, link.open) == ("fc", True)
            assert [(one.system, one.component, one.loss_percent) for one in link.senders] == [(7, 1, 0.0)]
            assert link.rx_age_s is not None
            until(lambda: (links.links()[0].rx_age_s or 0.0) > 1.0, "its silence")
        finally:
            hub.close()


def test_a_router_that_refuses_twice_disconnects_the_agent_from_the_ground() -> None:
    """It was connected and is gone: nothing can arrive from the ground. When it is back, that is over."""
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
        until(lambda: hub.read_at("r") is not None, "the first read")
        listener.close()
        client.close()
        until(links.gcs_unreachable, "two refusals")
        (link,) = links.links()
        assert (link.open, link.failed >= 2, hub.read_at("r")) == (False, True, None)
        assert wakes
        with socket.create_server(("127.0.0.1", port)):
            until(lambda: not links.gcs_unreachable(), "the return of the router")
            assert links.links()[0].failed == 0
    finally:
        hub.close()


def test_our_own_echo_is_not_a_duplicate() -> None:
    """A router that echoes our frames raises no alarm; another sender on the same link does."""
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
