"""The path of a command: each broken hop raises one alarm and blocks all units behind it."""

from __future__ import annotations

import errno
from typing import Any

import pytest

from phm import api
from phm.facts import BeaconFact
from phm_checks._command_path import Hop, HopState, first_broken, hop, in_words, seen_from_here
from tests.fakes.path_world import PathWorld

SERIAL = "/dev/ttyUSB0"
NODE = {"name": "/a/controller", "commands": True}


def flying(**more: Any) -> PathWorld:
    """All hops have been received for a while, and nothing is wrong."""
    world = PathWorld(**more)
    world.devices.put(SERIAL)
    world.run(20.0)
    assert world.bad() == set()
    assert world.alarms == []
    return world


# ---------------------------------------------------------------- pure functions


def test_the_first_broken_hop_counts() -> None:
    """Weak, unknown and unused hops do not stop a command; of several broken hops the first is reported."""
    hops = [
        Hop("GCS", HopState.UNKNOWN),
        Hop("radio", HopState.WEAK),
        Hop("port", HopState.UNUSED),
        Hop("router", HopState.BROKEN, "silent"),
        Hop("autopilot", HopState.BROKEN),
    ]
    assert first_broken(hops) == hops[3]
    assert first_broken(hops[:3]) is None
    assert in_words(hops) == "GCS unknown -> radio weak -> router BROKEN (silent) -> autopilot BROKEN"


def test_a_hop_behind_a_broken_hop_is_unknown() -> None:
    """Its evidence cannot arrive; a hop that is received nevertheless keeps its state."""
    hops = [
        Hop("GCS", HopState.BROKEN, "no heartbeat", ("router", "radio")),
        Hop("radio", HopState.OK, "", ("router",)),
        Hop("router", HopState.BROKEN, "silent"),
    ]
    assert in_words(seen_from_here(hops)) == "GCS unknown (behind router) -> radio ok -> router BROKEN (silent)"


def test_a_hop_takes_level_and_text_from_its_check() -> None:
    """The level becomes the state of the hop, and the brief its evidence, without a repeated name."""
    broken = api.error("no RADIO_STATUS", brief="radio: no RADIO_STATUS 6 s", condition="radio_silent")
    assert hop("radio", broken) == Hop("radio", HopState.BROKEN, "no RADIO_STATUS 6 s")
    assert hop("radio", api.bypass("none")) == Hop("radio", HopState.UNUSED)
    assert hop("radio", api.stale("its link is closed")) == Hop("radio", HopState.UNKNOWN, "its link is closed")
    assert hop("radio", api.ok("received")) == Hop("radio", HopState.OK)


# ---------------------------------------------------------------- each hop in turn, through the tracker

HOPS = [
    ("gcs", "both", "gcs: GCS: no heartbeat 1", {"path"}),
    ("gcs", "router", "gcs: GCS: no heartbeat 1", {"path"}),
    ("radio", "both", "radio/ground: radio: no RADIO_STATUS", {"gcs", "path"}),
    ("radio", "router", "radio/ground: radio: no RADIO_STATUS", {"gcs", "path"}),
    ("link", "both", "link/ground: link: refused", {"gcs", "path", "radio/ground", "autopilot"}),
    ("link", "router", "link/ground: router: refused", {"gcs", "path", "radio/ground", "autopilot"}),
    ("router", "router", "link/ground: router: silent", {"gcs", "path", "radio/ground", "autopilot"}),
    ("router", "both", "link/ground: link: silent", {"gcs", "path", "radio/ground", "autopilot"}),
    ("pilot", "both", "autopilot: autopilot: no heartbeat", {"gcs", "path"}),
    ("pilot", "router", "autopilot: autopilot: no heartbeat", {"path"}),
]


@pytest.mark.parametrize(("hop_name", "leads_to", "alarm", "behind"), HOPS, ids=[f"{one[0]}-{one[1]}" for one in HOPS])
def test_each_broken_hop_raises_one_alarm_with_its_name(
    hop_name: str, leads_to: str, alarm: str, behind: set[str]
) -> None:
    """The alarm is at the broken hop. Hops behind it are STALE and blocked by it, and recover after it."""
    world = flying(leads_to=leads_to)
    world.down = {hop_name}
    world.run(60.0)
    (alarm_text,) = world.alarms
    assert alarm_text.startswith(alarm)
    unit = alarm_text.partition(":")[0]
    assert world.blocked() == dict.fromkeys(behind, unit)
    assert world.bad() == {unit}
    world.down = set()
    world.run(30.0)
    assert world.closed == [(unit, "resolved")]
    assert world.bad() == set()
    assert world.blocked() == {}
    assert len(world.alarms) == 1


@pytest.mark.parametrize("heartbeat_s", [2.0, 10.0])
def test_a_radio_that_reports_rarely_raises_one_alarm(heartbeat_s: float) -> None:
    """In a large swarm the radio's silence is detected after the ground station's: no alarm is withdrawn for it."""
    world = flying(leads_to="router", heartbeat_s=heartbeat_s)
    world.run(20.0)
    world.down = {"radio"}
    world.run(90.0)
    (alarm_text,) = world.alarms
    assert alarm_text.startswith("radio/ground: radio: no RADIO_STATUS")
    assert world.closed == []


@pytest.mark.parametrize("heartbeat_s", [2.0, 10.0])
def test_a_lost_ground_station_behind_a_working_radio_is_reported(heartbeat_s: float) -> None:
    """The radio has been received since: the alarm is for the ground station and says that the onboard radio responds."""
    world = flying(leads_to="router", heartbeat_s=heartbeat_s)
    world.run(20.0)
    world.down = {"gcs"}
    world.run(40.0)
    (alarm_text,) = world.alarms
    assert alarm_text.startswith("gcs: GCS: no heartbeat")
    assert "onboard radio responds" in world.text("gcs")


def test_an_agent_without_endpoints_has_no_alarm() -> None:
    """Without radio, ground station and autopilot nothing is missing, and the path makes no statement."""
    world = PathWorld()
    world.never = {"gcs", "radio", "pilot"}
    world.run(60.0)
    assert world.alarms == []
    assert world.warnings == []
    assert "GCS unknown (no heartbeat yet)" in world.text("path")
    assert "radio" not in world.text("path")


def test_required_endpoints_that_never_send_are_faults() -> None:
    """With `mavlink.autopilot` and a required radio, silence since the start is a fault of each of the two hops."""
    world = PathWorld(leads_to="router", mavlink={"autopilot": True})
    world.never = {"pilot"}
    world.run(30.0)
    assert world.alarms == ["autopilot: autopilot: no heartbeat"]


def test_an_unused_radio_is_not_part_of_the_path() -> None:
    """An autopilot does not forward RADIO_STATUS: the hop is unused, and a lost ground station raises its own alarm."""
    world = PathWorld()
    world.never = {"radio"}
    world.run(20.0)
    world.down = {"gcs"}
    world.run(30.0)
    (alarm_text,) = world.alarms
    assert alarm_text.startswith("gcs: ")
    assert "check the radio" in world.text("gcs")
    assert "radio" not in world.text("path")


def test_a_silent_router_with_one_sender_behind_it_is_not_blamed() -> None:
    """The only sender behind it may be the one that failed."""
    world = PathWorld(leads_to="router")
    world.never = {"gcs", "radio"}
    world.run(20.0)
    world.down = {"router"}
    world.run(30.0)
    (alarm_text,) = world.alarms
    assert alarm_text.startswith("autopilot: ")


# ---------------------------------------------------------------- the port

PORTS = [
    (errno.ENOENT, False, "port: ttyUSB0 missing", "check its cable"),
    (errno.ENOENT, True, "port: ttyUSB0 not in PHM container", "in PHM's container"),
    (errno.EACCES, True, "port: ttyUSB0 no permission", "dialout"),
    (errno.EAGAIN, True, "port: ttyUSB0 in use by mavproxy.py", "mavproxy.py (42)"),
    (errno.EIO, True, "port: ttyUSB0 failed", "driver"),
    (
        errno.ENXIO,
        True,
        "port: ttyUSB0 failed",
        "or PHM's container has the old device file: `docker compose up -d --force-",
    ),
    (
        errno.ENODEV,
        True,
        "port: ttyUSB0 failed",
        "or PHM's container has the old device file: `docker compose up -d --force-",
    ),
]


@pytest.mark.parametrize(("code", "there", "brief", "advice"), PORTS, ids=[one[2].split(" ", 2)[2] for one in PORTS])
def test_a_closed_port_alarm_states_the_reason(code: int, there: bool, brief: str, advice: str) -> None:
    """The device is missing, access is denied or another program uses it; the alarm also says what to do."""
    world = flying(url=SERIAL)
    world.down, world.closed_with = {"link"}, (code, f"could not open port: error {code}")
    world.links.busy = {SERIAL: ("mavproxy.py (42)",)}
    if not there:
        world.devices.devices.clear()
    world.run(30.0)
    assert world.alarms == [f"link/ground: {brief}"]
    assert advice in world.text("link/ground")


CAMERA = {"path": "/dev/video0", "mapped": False, "open": "never"}
APP = {"name": "ros_app", "devices": [{"path": SERIAL, "mapped": False, "open": "never"}, CAMERA]}


def with_devices(**more: Any) -> PathWorld:
    world = PathWorld(url=SERIAL, containers=[APP], **more)
    world.devices.put(SERIAL)
    world.devices.put("/dev/video0")
    world.run(20.0)
    assert world.alarms == []
    return world


def test_a_port_that_a_container_also_misses_raises_one_alarm() -> None:
    """If the port is also a device of a container, the devices check reports the loss."""
    world = with_devices()
    del world.devices.devices[SERIAL]
    world.down, world.closed_with = {"link"}, (errno.ENOENT, "no such file")
    world.run(30.0)
    assert world.alarms == ["devices/ros_app: ttyUSB0 missing"]
    assert world.bad() == {"devices/ros_app"}
    assert "which devices/ros_app reports" in world.text("link/ground")
    assert "is broken at port" in world.text("path")


def test_another_missing_device_of_the_container_does_not_hide_a_link() -> None:
    """A camera may be missing for an entire flight."""
    world = with_devices()
    del world.devices.devices["/dev/video0"]
    world.run(10.0)
    world.down, world.closed_with = {"link"}, (errno.EIO, "input/output error")
    world.run(30.0)
    assert world.alarms == ["devices/ros_app: video0 missing", "link/ground: port: ttyUSB0 failed"]


def test_a_missing_port_is_reported_by_its_link_without_a_devices_check() -> None:
    """The devices check is disabled."""
    world = with_devices(checks={"devices": {"enabled": False}})
    del world.devices.devices[SERIAL]
    world.down, world.closed_with = {"link"}, (errno.ENOENT, "no such file")
    world.run(30.0)
    assert world.alarms == ["link/ground: port: ttyUSB0 missing"]


# ---------------------------------------------------------------- the application


def listed(world: PathWorld) -> None:
    world.ros.change(nodes={"/a/controller": 1})


def test_a_node_that_executes_commands_is_part_of_the_path() -> None:
    """When it dies, its own unit raises the alarm; the path shows where commands stop, without a second alarm."""
    world = PathWorld(ros={"nodes": [NODE]})
    listed(world)
    world.run(20.0)
    assert "application ok" in world.text("path")
    world.ros.change(nodes={})
    world.run(30.0)
    assert world.alarms == ["nodes/a/controller: controller dead"]
    assert world.blocked() == {"path": "nodes/a/controller"}
    assert "is broken at application" in world.text("path")
    assert world.tracker.state("path").result.evidence.broken_hop == "application"
    assert "application BROKEN (controller not in the graph)" in world.text("path")


def test_other_nodes_are_not_part_of_the_path() -> None:
    """Only nodes with `commands: true` are hops, where there are any."""
    world = PathWorld(ros={"nodes": [NODE, {"name": "/a/camera"}]})
    listed(world)
    world.ros.change(nodes={**world.ros.snapshot().nodes, "/a/camera": 1})
    world.run(20.0)
    listed(world)
    world.run(30.0)
    assert world.blocked() == {}
    assert "application ok" in world.text("path")


@pytest.mark.parametrize("beacon", [BeaconFact(8.0, 0.5), BeaconFact(0.2, 0.5, late_s=9.0)], ids=["silent", "late"])
def test_a_hung_node_breaks_the_path(beacon: BeaconFact) -> None:
    """It is in the graph, but its beacon shows that it does not execute commands."""
    world = PathWorld(ros={"nodes": [NODE]})
    listed(world)
    world.ros.change(beacons={"/a/controller": beacon})
    world.run(3.0)
    assert "application BROKEN (controller does not answer)" in world.text("path")


def test_without_a_current_graph_the_application_is_unknown() -> None:
    """With no snapshot of the graph, or an old one, the path makes no statement about nodes."""
    world = PathWorld(ros={"nodes": [NODE]})
    world.ros.fail("the child is being replaced")
    world.run(3.0)
    assert "application unknown" in world.text("path")
    world.ros.work()
    world.ros.change(age_s=9.0)
    world.run(3.0)
    assert "application unknown (the ROS graph snapshot is 9.0 s old)" in world.text("path")


# ---------------------------------------------------------------- two endpoints


def test_endpoints_that_lead_to_one_side_only_make_no_path() -> None:
    """A path needs both ends."""
    for leads_to in ("ground", "autopilot"):
        assert "path" not in {entry.unit.id for entry in PathWorld(leads_to=leads_to).plan.tracked}


def test_the_endpoint_to_the_other_agents_is_not_a_hop() -> None:
    """The texts omit it, and neither path nor ground station depends on it; the router needs no name to distinguish it."""
    peers = {"url": "udpout:10.0.0.1:14600", "name": "peers", "leads_to": "peers"}
    router = {"url": "tcp:10.0.0.1:5760", "name": "ground", "leads_to": "router"}
    world = PathWorld(leads_to="router", mavlink={"endpoints": [router, peers]})
    needs = {entry.unit.id: entry.needs for entry in world.plan.tracked}
    assert "link/peers" in needs
    assert "link/peers" not in (*needs["path"], *needs["gcs"])
    world.run(10.0)
    assert "router ok" in world.text("path")
    assert "peers" not in world.text("path")
    assert "router ground" not in world.text("path")


def test_a_ground_station_behind_a_router_does_not_depend_on_the_autopilot() -> None:
    """Only an autopilot that forwards frames can hide the ground station."""
    needs = {entry.unit.id: entry.needs for entry in PathWorld(leads_to="router").plan.tracked}
    assert "autopilot" not in needs["gcs"]
    needs = {entry.unit.id: entry.needs for entry in PathWorld(leads_to="both").plan.tracked}
    assert "autopilot" in needs["gcs"]
