"""Limits of a running container: the engine's (`docker update`) and, for disks, those of its cgroup, which the engine cannot change."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from docker.models.containers import Container

MOUNT, PROC, BLOCK = Path("/sys/fs/cgroup"), Path("/proc"), Path("/sys/dev/block")
UPDATE_LIMIT_S = 30.0
V1_CPU, V2_CPU = "cpuacct.usage", "cpu.stat"
V1_FILES = ("blkio.throttle.read_bps_device", "blkio.throttle.write_bps_device")


def update(container: Container, *options: str) -> None:
    """``docker update OPTIONS``. Raises RuntimeError with the engine's words when it refuses."""
    argv = ["docker", "update", *options, str(container.id)]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=UPDATE_LIMIT_S, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"docker update {' '.join(options)} of {container.name} failed: {done.stderr.strip()}")


def cgroup(container: Container, controller: str, mount: Path = MOUNT, proc: Path = PROC) -> Path:
    """The folder of a running container's cgroup for one controller; on cgroup v2 it is the same for all.

    Raises LookupError when the container does not run or has no such cgroup.
    """
    container.reload()
    pid = int(container.attrs["State"]["Pid"])
    if pid == 0:
        raise LookupError(f"{container.name} does not run, so it has no cgroup")
    unified = (mount / "cgroup.controllers").exists()
    for line in (proc / str(pid) / "cgroup").read_text("ascii").splitlines():
        _, controllers, path = line.split(":", 2)
        if path == "/":
            continue  # what version 1 shows of a process that is ending: the root, which has all processes of the machine
        if unified and not controllers:
            return mount / path.lstrip("/")
        if not unified and controller in controllers.split(","):
            return mount / controllers / path.lstrip("/")
    raise LookupError(f"{container.name} has no cgroup of the controller {controller}")


def cpu_of(folder: Path) -> float:
    """Seconds of CPU time that a cgroup has used. OSError when it is gone."""
    v1 = folder / V1_CPU
    if v1.exists():
        return int(v1.read_text("ascii")) / 1e9
    for line in (folder / V2_CPU).read_text("ascii").splitlines():
        name, _, value = line.partition(" ")
        if name == "usage_usec":
            return int(value) / 1e6
    raise OSError(f"{folder} does not say how much CPU time it has used")


def disk(path: str, block: Path = BLOCK) -> str:
    """``MAJOR:MINOR`` of the disk below a path; of a partition, of the disk that it is part of: only that can be throttled."""
    number = os.stat(path).st_dev
    name = f"{os.major(number)}:{os.minor(number)}"
    entry = (block / name).resolve()
    if not entry.exists():
        raise LookupError(f"{path} is not on a block device, so its speed cannot be limited")
    return (entry.parent / "dev").read_text("ascii").strip() if (entry / "partition").exists() else name


def throttle(folder: Path, device: str, bytes_s: int) -> None:
    """Limit reads and writes of a cgroup on one disk to this many bytes a second each; 0 lifts the limit."""
    if (folder / "io.max").exists():
        limit = str(bytes_s) if bytes_s else "max"
        (folder / "io.max").write_text(f"{device} rbps={limit} wbps={limit}\n", "ascii")
        return
    for name in V1_FILES:
        (folder / name).write_text(f"{device} {bytes_s}\n", "ascii")


def throttled(folder: Path, device: str) -> bool:
    """Whether `throttle` limits reads or writes of a cgroup on the disk."""
    files = [folder / "io.max"] if (folder / "io.max").exists() else [folder / name for name in V1_FILES]
    limits = (line.split() for file in files for line in file.read_text("ascii").splitlines())
    return any(words[0] == device and not {"0", "rbps=max"} & set(words[1:]) for words in limits)
