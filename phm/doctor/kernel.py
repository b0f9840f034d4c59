"""Features of the kernel that PHM uses where they exist."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from phm.doctor.context import DoctorContext
from phm.doctor.row import Row, limited, ok

CHILD_LIMIT_S = 10.0
LEAST_WATCHES, LEAST_INSTANCES = 8192, 128
"""Defaults of small machines; other programs of the same user share them."""
_SANDBOX = "from phm.probes.ros import sandbox; print(sandbox.enter())"


def rows(context: DoctorContext) -> Iterator[Row]:
    name = os.uname()
    yield ok("kernel", f"{name.sysname} {name.release}, {name.machine}")
    yield _cgroups(context)
    yield _pressure(context.proc)
    yield _sandbox()
    yield _inotify(context.proc)


def _cgroups(context: DoctorContext) -> Row:
    root = Path(context.environ.get("PHM_CGROUP_ROOT") or context.settings.pressure.cgroups)
    if (root / "cgroup.controllers").exists():
        return ok("cgroups", f"version 2 at {root}")
    if (root / "cpu").exists() or (root / "memory").exists():
        text = f"version 1 at {root}: no pressure figures for each container"
        return limited(
            "cgroups", text, "systemd.unified_cgroup_hierarchy=1 on the kernel command line selects version 2"
        )
    text = f"none at {root}: PHM asks the engine for statistics, which costs more and shows less"
    return limited("cgroups", text, "mount /sys/fs/cgroup there, as the compose file of `phm init` does")


def _pressure(proc: Path) -> Row:
    try:
        (proc / "pressure" / "cpu").read_text(encoding="ascii")
    except OSError:
        return limited("PSI", "the kernel does not count how long tasks wait", "psi=1 on the kernel command line")
    return ok("PSI", "the kernel counts how long tasks wait for CPU, memory and I/O")


def _sandbox() -> Row:
    """Tried in a separate process, since it cannot be undone."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", _SANDBOX], capture_output=True, text=True, timeout=CHILD_LIMIT_S, check=True
        )
    except (OSError, subprocess.SubprocessError) as error:
        return limited(
            "Landlock, seccomp", f"could not be tried: {type(error).__name__}", "report this as a defect of PHM"
        )
    lacking = done.stdout.strip()
    if lacking:
        text = f"the ROS child is not fully restricted: {lacking}"
        return limited(
            "Landlock, seccomp", text, "Linux 5.13 or later with Landlock enabled: lsm=landlock,... on its command line"
        )
    return ok("Landlock, seccomp", "the ROS child is restricted in files, sockets and system calls")


def _inotify(proc: Path) -> Row:
    folder = proc / "sys" / "fs" / "inotify"
    try:
        watches, instances = (int((folder / f"max_user_{name}").read_text()) for name in ("watches", "instances"))
    except (OSError, ValueError):
        return limited("inotify", "its limits cannot be read", "PHM compares files every 5 s instead")
    text = f"{watches} watches and {instances} instances for each user"
    if watches < LEAST_WATCHES or instances < LEAST_INSTANCES:
        remedy = f"sysctl fs.inotify.max_user_watches={LEAST_WATCHES} fs.inotify.max_user_instances={LEAST_INSTANCES}"
        return limited("inotify", text, remedy)
    return ok("inotify", text)
