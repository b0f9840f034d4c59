"""From observations to settings, and the notes where they are uncertain."""

from __future__ import annotations

from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import pytest

from phm import testing
from phm.facts import Attachment, DeviceMapping, EndpointFact, HealthcheckFact, ProcessFact
from phm.learn.baseline import Learned, learn, manifest_name
from phm.learn.observations import (
    Observations,
    ObservedAutopilot,
    ObservedContainer,
    ObservedFolder,
    ObservedTopic,
)
from phm.probes.file_tree import TreeListing
from phm.probes.tree_comparison import Comparison

TYPE = "std_msgs/msg/String"
STEADY = (10.0, 10.02, 9.98) * 20
PLAIN = ObservedTopic(
    "/a/scan", (EndpointFact("/a/lidar", TYPE),), (EndpointFact("/a/planner", TYPE),), STEADY, 0.0, False, 600
)


def container(name: str = "ros_app", **fields: Any) -> ObservedContainer:
    """fields: of its fact, or of the observation."""
    fact = testing.container(name)
    changes = {key: fields.pop(key) for key in tuple(fields) if hasattr(fact, key)}
    return ObservedContainer(replace(fact, **changes), name, **fields)


def learned_topic(watched_s: float = 60.0, **fields: Any) -> Learned:
    nodes = {"/a/lidar": True, "/a/planner": True, "/a/second": True}
    (found,) = learn(Observations(watched_s, nodes=nodes, topics=(replace(PLAIN, **fields),))).topics
    return found


def test_a_steady_topic_is_learned_without_a_doubt() -> None:
    """Type, rate, publishers and subscribers, without a note."""
    found = learned_topic()
    wanted = {"type": TYPE, "rate": 10, "publishers": ["/a/lidar"], "subscribers": ["/a/planner"]}
    assert found.values == {"name": "/a/scan", **wanted}
    assert found.notes == {}


def test_the_tolerance_follows_the_observed_spread() -> None:
    """Three times as much, and a note."""
    found = learned_topic(rates=(10.0,) * 20 + (9.0, 11.0))
    assert (found.values["rate"], found.values["tolerance"]) == (10, 30)
    assert "10 %" in found.notes["rate"]


def test_a_rate_that_is_too_irregular_is_not_learned() -> None:
    """A note says that it varied."""
    found = learned_topic(rates=(2.0, 10.0, 30.0) * 10)
    assert "rate" not in found.values and "varied" in found.notes["name"]


def test_a_short_watch_is_noted() -> None:
    """A rate measured over a short time has a note."""
    assert "only" in learned_topic(watched_s=10.0).notes["rate"]


def test_several_publishers_are_noted() -> None:
    """All publishers of the topic are learned, with a note that there are several."""
    two = (EndpointFact("/a/lidar", TYPE), EndpointFact("/a/second", TYPE))
    found = learned_topic(publishers=two)
    assert found.values["publishers"] == ["/a/lidar", "/a/second"]
    assert "2 publishers" in found.notes["publishers"]


@pytest.mark.parametrize(("durability", "rate"), [("transient_local", 0), ("volatile", None)])
def test_a_topic_without_messages(durability: str, rate: int | None) -> None:
    """Latched only if its publisher keeps the last message; else the rate is unknown. Both are noted."""
    found = learned_topic(rates=(), publishers=(EndpointFact("/a/lidar", TYPE, durability=durability),))
    assert found.values.get("rate") == rate
    assert found.notes


@pytest.mark.parametrize(("kind", "noted"), [("sensor_msgs/msg/Image", True), (TYPE, False)])
def test_a_subscriber_that_converts_images_may_subscribe_on_demand(kind: str, noted: bool) -> None:
    """As image_proc does; one that publishes nothing has no demand to wait for."""
    camera, rectify, viewer = (EndpointFact(f"/a/{name}", kind) for name in ("camera", "rectify", "viewer"))
    raw = replace(PLAIN, name="/a/raw", publishers=(camera,), subscribers=(rectify,))
    seen = Observations(
        60.0,
        nodes={end.node: True for end in (camera, rectify, viewer)},
        topics=(raw, replace(PLAIN, name="/a/rect", publishers=(rectify,), subscribers=(viewer,))),
    )
    first, second = learn(seen).topics
    assert first.values["subscribers"] == ["/a/rectify"]
    assert ("on demand" in first.notes.get("subscribers", "")) is noted
    assert "subscribers" not in second.notes


def test_a_type_that_cannot_be_read_leaves_out_the_rate() -> None:
    """A note says why."""
    found = learned_topic(rates=(), problem="type unknown: my_msgs is not installed")
    assert "rate" not in found.values and "type unknown" in found.notes["name"]


def test_topics_of_tools_are_left_out() -> None:
    """A publisher that is not a node of the agent, such as `ros2 topic pub`."""
    assert learn(Observations(60.0, nodes={"/a/planner": True}, topics=(PLAIN,))).topics == ()


def test_a_node_that_left_is_not_learned() -> None:
    """A note names it; nodes of `ros2 launch` are left out."""
    found = learn(Observations(60.0, nodes={"/a/stays": True, "/a/left": False, "/launch_ros_123": True}))
    assert [node.name for node in found.nodes] == ["/a/stays"]
    assert any("/a/left" in note for note in found.notes)


def test_an_active_lifecycle_node_must_be_active() -> None:
    """So that a node which is deactivated is one fault, at its cause. The note says when that is wrong."""
    seen = Observations(60.0, nodes={"/a/amcl": True, "/a/camera": True}, active_nodes=frozenset({"/a/amcl"}))
    amcl, camera = learn(seen).nodes
    assert amcl.values == {"name": "/a/amcl", "ready": {"lifecycle": "active"}} and "remove" in amcl.notes["ready"]
    assert camera.values == {"name": "/a/camera"}


def test_the_container_of_a_node_is_known_by_its_process() -> None:
    """Not needed with one container; with several, a node that no process names is noted."""
    one = container("one", processes=(ProcessFact(1, command="python node.py --ros-args -r __node:=planner"),))
    nodes = {"/a/planner": True, "/a/hidden": True}
    hidden, planner = learn(Observations(60.0, (one, container("two")), nodes=nodes)).nodes
    assert planner.values["container"] == "one"
    assert "container" in hidden.notes["name"]
    assert learn(Observations(60.0, (one,), nodes=nodes)).nodes[0].values == {"name": "/a/hidden"}


def test_a_container_is_learned_as_observed() -> None:
    """Health check, networks and devices as observed."""
    one = container(
        health="healthy",
        healthcheck=HealthcheckFact(),
        network_mode="net",
        networks=(Attachment("net", "id", "172.20.0.2"),),
        devices=(DeviceMapping("/dev/ttyACM0", "/dev/autopilot"),),
        answers={"net": True},
    )
    (found,) = learn(Observations(60.0, (one,))).containers
    assert found.values == {"name": "ros_app", "healthcheck": "required", "networks": ["net"]}
    assert found.notes == {}
    (device,) = found.nested["devices"]
    assert device.values == {"path": "/dev/ttyACM0", "in_container": "/dev/autopilot"}
    assert "by-id" in device.notes["path"]


def test_a_device_that_phm_does_not_see_is_left_out() -> None:
    """It would be missing as soon as PHM runs; the note says how PHM can see it."""
    one = container(devices=(DeviceMapping("/dev/video0", "/dev/video0"),), unseen_devices=("/dev/video0",))
    found = learn(Observations(60.0, (one,)))
    assert "devices" not in found.containers[0].nested
    assert any("dev_root" in note for note in found.notes)


def test_a_mapped_folder_is_left_out() -> None:
    """The check knows character devices only: it would be a fault from the start."""
    one = container(devices=(DeviceMapping("/dev/dri", "/dev/dri"),), other_devices=("/dev/dri",))
    found = learn(Observations(60.0, (one,)))
    assert "devices" not in found.containers[0].nested
    assert any("character devices" in note for note in found.notes)


def test_uncertain_values_of_a_container_have_notes() -> None:
    """No HEALTHCHECK, an address that does not answer, a restart."""
    net = (Attachment("net", "id", "172.20.0.2"),)
    one = container(healthcheck=None, network_mode="net", networks=net, answers={"net": False}, restarted=True)
    (found,) = learn(Observations(60.0, (one,))).containers
    assert found.values["address"] is False
    assert set(found.notes) == {"healthcheck", "address", "name"}


def test_a_container_on_the_network_of_the_host_has_no_network() -> None:
    """`networks` lists networks of Docker that can be reconnected."""
    one = container(network_mode="host", networks=(Attachment("host", "id", ""),))
    assert "networks" not in learn(Observations(60.0, (one,))).containers[0].values


def test_a_folder_becomes_one_entry_with_a_manifest() -> None:
    """Files that changed while they were watched are not part of it."""
    folder = ObservedFolder("ros_app", "/ws/install", {"a": "1"}, 3_000_000, ("log.txt",))
    found = learn(Observations(60.0, (container(),), (folder,)))
    assert set(found.manifests) == {"ros_app-ws-install.sha256"}
    (entry,) = found.containers[0].nested["files"]
    assert entry.values["ignore"][-1] == "log.txt" and "changed" in entry.notes["ignore"]


@pytest.mark.parametrize("where", ["unstable", "unreadable"])
def test_the_name_of_a_file_is_never_a_pattern(where: str) -> None:
    """A file named `*` does not take all other files out of the manifest."""
    names = ("*", "a[b]?")
    odd: dict[str, Any] = {where: names}
    folder = ObservedFolder("ros_app", "/ws", {"kept": "1"}, 1, **odd)
    (entry,) = learn(Observations(60.0, (container(),), (folder,))).containers[0].nested["files"]
    ignore = entry.values["ignore"]
    assert Comparison(ignore).of({"kept": "1"}, TreeListing({"kept": "2"})).changed == ("kept",)
    assert all(any(fnmatchcase(name, pattern) for pattern in ignore) for name in names)


def test_a_manifest_has_a_harmless_name() -> None:
    """Characters of the folder's path that could leave the directory or need quotes are replaced."""
    name = manifest_name(ObservedFolder("app", "/../../etc/x y", {}, 0))
    assert "/" not in name and " " not in name and name.startswith("app")


def test_the_autopilot_sets_the_agents_id_and_its_timeout() -> None:
    """Its system id is the agent's; slow heartbeats lengthen the timeout."""
    found = learn(Observations(60.0, autopilots=(ObservedAutopilot(7, "fc", 60, 1.1),)), 1)
    assert (found.agent.values, found.mavlink.values) == ({"id": 7}, {"autopilot": True})
    slow = learn(Observations(60.0, autopilots=(ObservedAutopilot(7, "fc", 60, 4.0),)), 7)
    assert (slow.agent.values, slow.mavlink.values["autopilot_timeout"]) == ({}, 12.0)


def test_two_autopilots_are_not_guessed_at() -> None:
    """Neither is configured; the note names both."""
    two = (ObservedAutopilot(7, "fc", 60, 1.0), ObservedAutopilot(8, "fc", 60, 1.0))
    found = learn(Observations(60.0, autopilots=two), 7)
    assert found.mavlink.values == {} and "7, 8" in found.mavlink.notes[""]
