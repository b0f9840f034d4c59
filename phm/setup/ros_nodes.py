"""The nodes of the ROS graph as `phm init` lists them, each with the container in which its process runs."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence

from phm.facts import CannotTell
from phm.probes.ros.sandbox import PROFILE_VARIABLES
from phm.setup.machine import Application
from phm.transport.docker import DockerEngine

DISCOVERY_S = 4.0
"""Fast DDS announces itself every 3 s by default."""
LIMIT_S = DISCOVERY_S + 15.0
_CONFIGURATION = frozenset(("CYCLONEDDS_URI", "FASTDDS_ENVIRONMENT_FILE", *PROFILE_VARIABLES))
"""Variables of the application that name configuration of its middleware. An image could have files written by it, with the
rights of the user of `phm init`; their paths are of the container anyway."""
_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_LAUNCHERS = re.compile(r"/(?:launch_ros_\d+|ros2cli\w*|transform_listener_impl_\w+|rviz2?|rqt\w*)$")
"""Nodes of tools, and nodes with a number that changes with each start."""


class NoGraph(Exception):
    """The ROS graph was not read; the message says why."""


def nodes(environment: Mapping[str, str]) -> tuple[str, ...]:
    """Names of the nodes that a participant with these ROS variables finds within DISCOVERY_S. Raises NoGraph."""
    # The application's shared memory cannot be read by another user in another container.
    safe = {name: value for name, value in environment.items() if name not in _CONFIGURATION}
    environ = {**os.environ, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", **safe}
    argv = [sys.executable, "-m", "phm.probes.ros.graph_listing", f"{DISCOVERY_S:g}"]
    try:
        done = subprocess.run(argv, env=environ, capture_output=True, timeout=LIMIT_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NoGraph(f"the ROS graph could not be read: {type(error).__name__}") from error
    if done.returncode == 3:
        raise NoGraph("rclpy is not installed here")
    if done.returncode != 0:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise NoGraph(f"the ROS graph could not be read: {lines[-1] if lines else f'exit code {done.returncode}'}")
    try:
        names = json.loads(done.stdout)["nodes"]
    except (ValueError, KeyError, TypeError) as error:
        raise NoGraph("the ROS graph could not be read: no list of nodes") from error
    return tuple(name for name in names if _NAME.fullmatch(str(name)) and not _LAUNCHERS.search(str(name)))


def placed(
    names: Sequence[str], applications: Sequence[Application], engine: DockerEngine
) -> tuple[tuple[str, str], ...]:
    """Each node with the name of its container: the only one, or the only one with a process that names the node; else empty."""
    if len(applications) == 1:
        return tuple((name, applications[0].name) for name in names)
    words = {one.name: _words(engine, one) for one in applications}
    found = []
    for name in names:
        base = name.rpartition("/")[2]
        wanted = {base, f"__node:={base}", f"__name:={base}"}
        holders = [container for container, used in words.items() if used & wanted]
        found.append((name, holders[0] if len(holders) == 1 else ""))
    return tuple(found)


def _words(engine: DockerEngine, application: Application) -> set[str]:
    """The words of all command lines in a container."""
    if not application.fact.running:
        return set()
    try:
        answer = engine.top(application.fact.id)
    except CannotTell:
        return set()
    rows = answer.get("Processes") or ()
    return {word for row in rows if isinstance(row, list) for cell in row for word in str(cell).split()}
