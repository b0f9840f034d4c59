"""ROS 2: PHM's own installation, and the environment of the application's containers beside PHM's."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from phm.doctor.context import Surroundings
from phm.doctor.row import Row, limited, missing, ok
from phm.facts import CannotTell
from phm.setup.discovery import PROFILE_VARIABLES, ROS_VARIABLES
from phm.setup.machine import Application

CHILD_LIMIT_S = 15.0
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108
DEFAULT_RMW = "rmw_fastrtps_cpp"
COMPARED = tuple(name for name in ROS_VARIABLES if name not in (*PROFILE_VARIABLES, "ROS_DISTRO"))
_DEFAULTS = {"ROS_DOMAIN_ID": "0", "RMW_IMPLEMENTATION": DEFAULT_RMW, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}


def rows(surroundings: Surroundings) -> Iterator[Row]:
    needed = bool(surroundings.settings.ros.nodes or surroundings.settings.ros.topics)
    yield _installation(needed=needed)
    own = _own(surroundings)
    yield ok("domain", f"ROS_DOMAIN_ID {own['ROS_DOMAIN_ID']}, {own['RMW_IMPLEMENTATION']}")
    yield _shared_memory()
    try:
        applications = surroundings.machine().applications
    except CannotTell:
        return
    for one in applications:
        if one.environment and one.fact.running:
            yield _compared(one, own)


def _installation(*, needed: bool) -> Row:
    try:
        done = subprocess.run(
            [sys.executable, "-m", "phm.probes.ros.installation"],
            capture_output=True,
            timeout=CHILD_LIMIT_S,
            check=False,
        )
        found = json.loads(done.stdout)
        text = f"{found['distribution'] or 'unknown distribution'}, rclpy {found['rclpy'] or 'of unknown version'}, {found['middleware']}"
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, TypeError):
        text = "rclpy cannot be used here, so nodes and topics are not monitored"
        remedy = "use PHM's image; or pip install 'phm-sidecar[ros]' on x86-64, or the Python of a ROS installation"
        return missing("PHM", text, remedy) if needed else limited("PHM", text, remedy)
    return ok("PHM", text)


def _own(surroundings: Surroundings) -> Mapping[str, str]:
    """PHM's variables with their defaults; the configuration's domain comes first."""
    own = {name: surroundings.environ[name] for name in COMPARED if surroundings.environ.get(name)}
    if surroundings.settings.ros.domain is not None:
        own["ROS_DOMAIN_ID"] = str(surroundings.settings.ros.domain)
    return {**_DEFAULTS, **own}


def _compared(one: Application, own: Mapping[str, str]) -> Row:
    theirs = {**_DEFAULTS, **{name: one.environment[name] for name in COMPARED if name in one.environment}}
    different = [name for name in COMPARED if theirs.get(name, "") != own.get(name, "")]
    distribution = one.environment.get("ROS_DISTRO", "")
    name = f"container {one.name}"
    if not different:
        return ok(name, f"{f'{distribution}, ' if distribution else ''}same ROS variables as PHM")
    first = different[0]
    text = ", ".join(
        f"{each}={theirs.get(each) or '(unset)'} (PHM: {own.get(each) or '(unset)'})" for each in different
    )
    line = f"set {first}={theirs[first]}" if theirs.get(first) else f"remove {first}"
    return limited(name, f"PHM may not see its nodes: {text}", f"{line} in PHM's agent.env")


def _shared_memory() -> Row:
    """Fast DDS in the application uses it; PHM does not."""
    if not os.access(SHARED_MEMORY, os.W_OK):
        return ok("shared memory", f"{SHARED_MEMORY} is not writable here; PHM uses UDP")
    segments = sum(1 for path in SHARED_MEMORY.iterdir() if path.name.startswith(("fastrtps_", "fastdds_")))
    free_mb = shutil.disk_usage(SHARED_MEMORY).free / 1e6
    return ok("shared memory", f"{SHARED_MEMORY}: {free_mb:.0f} MB free, {segments} files of Fast DDS; PHM uses UDP")
