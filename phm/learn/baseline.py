"""Turns observations into settings, each with a note where it is not certain. Pure."""

from __future__ import annotations

import glob
import math
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from phm.core.settings import MavlinkSettings, TopicSettings
from phm.learn.observations import Observations, ObservedContainer, ObservedFolder, ObservedTopic

SHORT_S = 30.0
"""A rate that was measured for less than this may vary more than was seen."""
FEW = 10
"""This many rates are enough to know their spread."""
STEADY_PERCENT = 3.0
MOST_PERCENT = 40.0
"""With a larger tolerance a rate says nothing."""
MARGIN = 3.0
"""The tolerance is at least this many times the observed deviation."""
TIMEOUT_HEARTBEATS = 3.0
IGNORED = ("__pycache__", "*.pyc")
_GENERATED = re.compile(r"_[0-9a-f]{6,}$|_\d{3,}$")
_TOOLS = re.compile(r"/(_ros2cli.*|launch_ros_\d+|transform_listener_impl_\w+|rviz2?|rqt\w*|foxglove_bridge)$")
_LAZY = frozenset(f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo", "PointCloud2"))
"""Nodes that convert these, such as those of image_proc, may subscribe only while a node subscribes to the result."""
_OWN_MODES = ("host", "none", "bridge", "default")


@dataclass(frozen=True, slots=True)
class Learned:
    """One entry of a list, or one section. notes: why a key is uncertain; the empty key is the entry itself."""

    values: Mapping[str, Any]
    notes: Mapping[str, str] = field(default_factory=dict)
    nested: Mapping[str, Sequence[Learned]] = field(default_factory=dict)
    """Lists of entries in this entry."""
    key: str = ""
    """What identifies a container in the configuration, if not its name."""

    @property
    def name(self) -> str:
        return self.key or str(self.values.get("name") or self.values.get("path") or "")


@dataclass(frozen=True, slots=True)
class Baseline:
    """manifests: checksums by name of the manifest file. notes: what is not a setting, in sentences."""

    containers: tuple[Learned, ...] = ()
    nodes: tuple[Learned, ...] = ()
    topics: tuple[Learned, ...] = ()
    agent: Learned = field(default_factory=lambda: Learned({}))
    mavlink: Learned = field(default_factory=lambda: Learned({}))
    manifests: Mapping[str, ObservedFolder] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    seen: frozenset[str] = frozenset()
    """All nodes and topics that were there, without the first slash; also those that were left out."""
    ros_watched: bool = True
    """Whether what is not in `seen` was not there."""

    def unsure(self) -> list[tuple[str, str]]:
        """Each note with the place that it is about."""
        found: list[tuple[str, str]] = []
        for section, entries in (
            ("containers", self.containers),
            ("ros.nodes", self.nodes),
            ("ros.topics", self.topics),
            ("agent", (self.agent,)),
            ("mavlink", (self.mavlink,)),
        ):
            for entry in entries:
                found += _notes(f"{section} {entry.name}".strip(), entry)
        return found


def _notes(where: str, entry: Learned) -> list[tuple[str, str]]:
    found = [(f"{where}: {key}" if key else where, why) for key, why in entry.notes.items()]
    for key, below in entry.nested.items():
        for one in below:
            found += _notes(f"{where}: {key} {one.name}", one)
    return found


def learn(seen: Observations, agent_id: int | None = None) -> Baseline:
    """The settings for what was observed. agent_id: as configured; None: not configured."""
    folders = {manifest_name(folder): folder for folder in seen.folders}
    nodes = [name for name, stays in sorted(seen.nodes.items()) if stays and not _TOOLS.search(name)]
    used = frozenset(nodes)
    return Baseline(
        containers=tuple(_container(one, folders) for one in seen.containers),
        nodes=tuple(_node(name, seen) for name in nodes),
        topics=tuple(found for one in seen.topics if (found := _topic(one, seen, used)) is not None),
        agent=_agent(seen, agent_id),
        mavlink=_mavlink(seen),
        manifests=folders,
        notes=_general(seen),
        seen=frozenset(
            name.lstrip("/") for name in (*seen.nodes, *seen.other_topics, *(one.name for one in seen.topics))
        ),
        ros_watched=seen.ros_watched,
    )


def manifest_name(folder: ObservedFolder) -> str:
    """File name of the manifest of a folder, e.g. ``ros_app-ws-install.sha256``."""
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", f"{folder.container}{folder.path}").strip("-")
    return f"{plain[:150]}.sha256"


# ---------------------------------------------------------------- containers


def _container(one: ObservedContainer, folders: Mapping[str, ObservedFolder]) -> Learned:
    fact = one.fact
    values: dict[str, Any] = {"name": fact.name}
    notes: dict[str, str] = {}
    if one.restarted:
        notes["name"] = "it was restarted while it was watched: check that the agent was healthy"
    if fact.healthcheck is None:
        values["healthcheck"] = "auto"
        notes["healthcheck"] = "it has no HEALTHCHECK: Docker knows only that it is running"
    elif fact.health == "healthy":
        values["healthcheck"] = "required"
    else:
        notes["name"] = f"its health was {fact.health} and not healthy: `healthcheck` is not learned"
    networks = [entry.name for entry in fact.networks] if fact.network_mode not in _OWN_MODES else []
    if networks:
        values["networks"] = networks
        if any(one.answers.get(name) is False for name in networks):
            values["address"] = False
            notes["address"] = "its address did not answer: `address: true` would be a fault now"
    nested = {"files": [_folder(folder, name) for name, folder in folders.items() if folder.container == one.key]}
    nested["devices"] = [
        _device(mapping.host_path, mapping.container_path)
        for mapping in fact.devices
        if mapping.host_path not in (*one.unseen_devices, *one.other_devices)
    ]
    return Learned(values, notes, {key: entries for key, entries in nested.items() if entries}, one.key)


def _device(path: str, inside: str) -> Learned:
    values: dict[str, Any] = {"path": path}
    if inside and inside != path:
        values["in_container"] = inside
    moving = re.fullmatch(r"/dev/tty(USB|ACM)\d+", path)
    return Learned(values, {"path": "its number can change: use /dev/serial/by-id/..."} if moving else {})


def _folder(folder: ObservedFolder, name: str) -> Learned:
    values: dict[str, Any] = {"path": folder.path, "manifest": name, "ignore": [*IGNORED, *_literal(folder.unstable)]}
    notes = {"manifest": f"{len(folder.files)} files, {folder.size / 1e6:.1f} MB"}
    if folder.unstable:
        notes["ignore"] = f"{len(folder.unstable)} of these changed while they were watched"
    if folder.unreadable:
        values["ignore"] += _literal(folder.unreadable)
        notes["ignore"] = "PHM cannot read some of these, or they changed while they were watched"
    return Learned(values, notes)


def _literal(paths: Sequence[str]) -> list[str]:
    """Patterns without wildcards: a file may be named ``*``, which would ignore all files."""
    return [glob.escape(path) for path in paths]


# ---------------------------------------------------------------- ROS


def _node(name: str, seen: Observations) -> Learned:
    values: dict[str, Any] = {"name": name}
    notes: dict[str, str] = {}
    if _GENERATED.search(name):
        notes["name"] = "looks generated: if it differs after a restart, remove this entry"
    if len(seen.containers) > 1:
        owners = [one.key for one in seen.containers if _runs(one, name)]
        if len(owners) == 1:
            values["container"] = owners[0]
        else:
            notes["name"] = "its container is not known from the process lists: add `container`"
    if name in seen.active_nodes:
        values["ready"] = {"lifecycle": "active"}
        notes["ready"] = "a lifecycle node that was active: remove this if it is not always activated"
    return Learned(values, notes)


def _runs(one: ObservedContainer, node: str) -> bool:
    """Whether a process of the container names the node: `__node:=NAME`, `--name NAME`, or NAME as a separate word."""
    short = re.escape(node.rpartition("/")[2])
    word = re.compile(rf"(?:__node:=|--name[ =]|(?<![\w./-])){short}(?![\w-])")
    return any(word.search(process.command) for process in one.processes)


def _topic(one: ObservedTopic, seen: Observations, nodes: frozenset[str]) -> Learned | None:
    publishers = sorted({end.node for end in one.publishers if end.node in nodes})
    subscribers = sorted({end.node for end in one.subscribers if end.node in nodes})
    types = sorted({end.type for end in one.publishers if end.type})
    if not publishers:
        return None
    values: dict[str, Any] = {"name": one.name}
    notes: dict[str, str] = {}
    if len(types) == 1:
        values["type"] = types[0]
    elif types:
        notes["name"] = f"published as {' and as '.join(types[:3])}: `type` and `rate` are not learned"
    if one.changed:
        notes["name"] = "its publishers or subscribers changed while it was watched"
    if len(types) == 1:
        _rate(one, seen.watched_s, values, notes)
    values["publishers"] = publishers
    if len(publishers) > 1:
        notes["publishers"] = f"{len(publishers)} publishers: the rate is their sum"
    if subscribers:
        values["subscribers"] = subscribers
        sources = {end.node for other in seen.topics for end in other.publishers}
        if sources.intersection(subscribers) and _LAZY.intersection(types):
            notes["subscribers"] = "may subscribe on demand: remove a node that does so only while its output is used"
    return Learned(values, notes)


def _rate(one: ObservedTopic, watched_s: float, values: dict[str, Any], notes: dict[str, str]) -> None:
    rates = [rate for rate in one.rates if rate > 0]
    if not rates or one.silent:
        latched = all(end.durability == "transient_local" for end in one.publishers)
        if one.problem:
            notes.setdefault("name", f"`rate` is not learned: {one.problem}")
        elif latched and not rates:
            values["rate"] = 0
            notes["rate"] = (
                f"no message in {watched_s:.0f} s, and its publishers keep the last one: assumed to be latched"
            )
        else:
            notes.setdefault("name", f"`rate` is not learned: it was silent for a part of {watched_s:.0f} s")
        return
    usual = statistics.median(rates)
    deviations = [abs(rate - usual) for rate in rates]
    spread = max(*deviations, one.error_hz) / usual * 100
    wanted = MARGIN * spread
    default = float(TopicSettings.model_fields["tolerance"].default)
    if wanted > MOST_PERCENT:
        notes.setdefault("name", f"`rate` is not learned: it varied by {spread:.0f} % around {_short(usual)} Hz")
        return
    values["rate"] = _short(usual)
    if wanted > default:
        values["tolerance"] = math.ceil(wanted)
    if spread > STEADY_PERCENT:
        notes["rate"] = f"varied by {spread:.0f} % within {watched_s:.0f} s"
    elif watched_s < SHORT_S or len(rates) < FEW:
        notes["rate"] = f"measured for {watched_s:.0f} s only: its spread is uncertain"


def _short(hz: float) -> float | int:
    """Three digits, and a whole number where it is within 1 %."""
    if hz >= 1 and abs(hz - round(hz)) <= 0.01 * hz:
        return round(hz)
    return float(f"{hz:.3g}")


# ---------------------------------------------------------------- MAVLink


def _agent(seen: Observations, agent_id: int | None) -> Learned:
    systems = sorted({one.system for one in seen.autopilots})
    if len(systems) != 1 or systems[0] == agent_id:
        return Learned({})
    return Learned(
        {"id": systems[0]}, {"id": f"the MAVLink system id of the only autopilot that was received; was {agent_id}"}
    )


def _mavlink(seen: Observations) -> Learned:
    if not seen.autopilots:
        return Learned({})
    values: dict[str, Any] = {"autopilot": True}
    notes: dict[str, str] = {}
    if len({one.system for one in seen.autopilots}) > 1:
        ids = ", ".join(str(one.system) for one in seen.autopilots)
        return Learned({}, {"": f"autopilots {ids} were received: set agent.id to that of this vehicle"})
    longest_s = max(one.longest_s for one in seen.autopilots)
    default = float(MavlinkSettings.model_fields["autopilot_timeout"].default)
    if TIMEOUT_HEARTBEATS * longest_s > default:
        values["autopilot_timeout"] = float(min(60, math.ceil(TIMEOUT_HEARTBEATS * longest_s)))
        notes["autopilot_timeout"] = f"its heartbeats were up to {longest_s:.1f} s apart"
    return Learned(values, notes)


def _general(seen: Observations) -> tuple[str, ...]:
    mapped = {mapping.host_path for one in seen.containers for mapping in one.fact.devices}
    left = [name for name, stays in sorted(seen.nodes.items()) if not stays]
    notes = list(seen.problems)
    notes += [
        f"device {path} of {one.key} is left out, since PHM does not see it: mount the host's /dev for PHM and set host.dev_root"
        for one in seen.containers
        for path in one.unseen_devices
    ]
    notes += [
        f"{path} of {one.key} is left out, since it is a folder or a block device: name the character devices in it"
        for one in seen.containers
        for path in one.other_devices
    ]
    notes += [
        f"serial port {port.path} ({port.description or 'no description'}) is not mapped into a container"
        for port in seen.ports
        if port.path not in mapped
    ]
    notes += [f"node {name} was not there all the time, and is left out" for name in left if not _TOOLS.search(name)]
    notes += [f"topic {name} appeared during the measurement, and is left out" for name in seen.late_topics]
    return tuple(notes)
