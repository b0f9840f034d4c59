"""Our own autopilot, as the link probe sees it: arming, reboots, duplicates."""

from __future__ import annotations

from typing import Any

import pytest

from phm.transport.dialect import mavlink
from tests.fakes.mavlink import heartbeat
from tests.probes.links.links_scene import Scene, boot, pilot


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
    assert (fact.armed, fact.contradicted) == (False, True)
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
