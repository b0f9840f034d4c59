"""Ground stations and radios, as the link probe sees them."""

from __future__ import annotations

import socket
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.settings import Settings
from phm.probes.links import Links
from phm.testing import settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm.wire.gcs_marker import MONITOR
from tests.fakes.mavlink import heartbeat
from tests.fakes.until import until
from tests.probes.links.links_scene import GCS, Scene, radio_status


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
        until(lambda: wakes, "the checks to be woken")
        with socket.create_server(("127.0.0.1", port)):
            until(lambda: not links.gcs_unreachable() and links.links()[0].failed == 0, "the return of the router")
    finally:
        hub.close()
