"""ROS 2: PHM's own installation, and the environment of the application's containers beside PHM's."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from phm.core import extras
from phm.doctor.context import DoctorContext
from phm.doctor.row import Row, limited, missing, ok
from phm.facts import CannotTell, RosEnvironment
from phm.probes.ros.environment import of_container, of_phm
from phm.probes.ros.environment_differences import DEFAULT_RMW, differences, rmw
from phm.wire.text import one_line

CHILD_LIMIT_S = 15.0
MAX_NAME = 40
"""Characters of a name that are shown, e.g. of the command of a process."""
MAX_SAID = 200
"""Characters of an error of rclpy that are shown."""
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108
MAX_PROCESSES = 10
"""ROS processes of the host that are compared."""


def rows(context: DoctorContext) -> Iterator[Row]:
    settings = context.settings.ros
    chosen = context.environ.get("RMW_IMPLEMENTATION", "")
    yield _installation(chosen, needed=bool(settings.nodes or settings.topics))
    own = _own(context)
    yield from (ok("domain", f"ROS_DOMAIN_ID {one.variables.get('ROS_DOMAIN_ID', '0')}, {rmw(one)}") for one in own)
    yield _shared_memory()
    try:
        machine = context.machine()
    except CannotTell:
        return
    applications = [one.ros for one in machine.applications if one.ros.variables and one.fact.running]
    for one in [*applications, *machine.host_ros[:MAX_PROCESSES]]:
        yield _compared(one, own, configured_domain=settings.domain is not None)


def _installation(chosen: str, *, needed: bool) -> Row:
    """chosen: the middleware that RMW_IMPLEMENTATION names, empty for none."""
    said = ""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "phm.probes.ros.installation"],
            capture_output=True,
            timeout=CHILD_LIMIT_S,
            check=False,
        )
        said = done.stderr.decode("utf-8", "replace").strip()
        found = json.loads(done.stdout)
        unknown = "of unknown version"
        middleware = f"{found['middleware']} {found['middleware_version'] or unknown}"
        text = f"{found['distribution'] or 'unknown distribution'}, rclpy {found['rclpy'] or unknown}, {middleware}"
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, TypeError):
        text = "rclpy cannot be used here, so nodes and topics are not monitored"
        remedy = f"use PHM's image; or on x86-64 {extras.remedy('ros')}; or use the Python of a ROS installation"
        if chosen not in ("", DEFAULT_RMW) and said and "No module named 'rclpy'" not in said:
            last = said.rpartition("\n")[2][:MAX_SAID]
            text = one_line(f"rclpy cannot load {chosen[:MAX_NAME]}: {last}")
            image = "build PHM's image from a ROS base image that has it (BASE_IMAGE)"
            remedy = f"{image}, or set RMW_IMPLEMENTATION to the middleware of the application"
        return missing("PHM", text, remedy) if needed else limited("PHM", text, remedy)
    return ok("PHM", text)


def _own(context: DoctorContext) -> list[RosEnvironment]:
    """PHM's environment: of this process, or of each sidecar where this process runs on the host beside them."""
    settings, environ = context.settings.ros, context.environ
    try:
        sidecars = [one for one in context.machine().sidecars if one.running]
        container = context.own_container() if context.in_container else None
    except CannotTell:
        sidecars, container = [], None
    if not context.in_container and sidecars:
        return [replace(of_container(one, (), context.proc), name="PHM") for one in sidecars]
    own = of_phm(settings, environ, container)
    # In a container that the engine does not know, namespaces cannot be compared.
    unknown = context.in_container and container is None
    return [replace(own, network_namespace="", ipc_namespace="") if unknown else own]


def _compared(one: RosEnvironment, own: Sequence[RosEnvironment], *, configured_domain: bool) -> Row:
    """With that PHM of this machine that fits best: each agent of a simulated swarm has its own."""
    name = one.name[:MAX_NAME]
    installed = ", ".join(part for part in (one.variables.get("ROS_DISTRO", ""), rmw(one)) if part)
    found = min((differences(one, phm, configured_domain=configured_domain) for phm in own), key=len)
    if not found:
        return ok(name, f"{installed}; its ROS environment fits PHM's")
    what, _, remedy = found[0].text.partition(": ")
    certain = "PHM does not receive its nodes" if found[0].certain else "PHM may not receive its nodes"
    more = f", and {len(found) - 1} more" if len(found) > 1 else ""
    return limited(name, f"{installed}; {certain}: {what}{more}", remedy)


def _shared_memory() -> Row:
    """Fast DDS in the application uses it; PHM does not."""
    if not os.access(SHARED_MEMORY, os.W_OK):
        return ok("shared memory", f"{SHARED_MEMORY} is not writable here; PHM uses UDP")
    segments = sum(1 for path in SHARED_MEMORY.iterdir() if path.name.startswith(("fastrtps_", "fastdds_")))
    free_mb = shutil.disk_usage(SHARED_MEMORY).free / 1e6
    return ok("shared memory", f"{SHARED_MEMORY}: {free_mb:.0f} MB free, {segments} files of Fast DDS; PHM uses UDP")
