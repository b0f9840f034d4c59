"""Where limits of a container's disk are written, for both cgroup versions."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from sitl.faults import _cgroups

V1 = "7:blkio:/docker/abc\n2:cpu,cpuacct:/docker/abc\n0::/docker/abc\n"


def container(pid: int) -> Any:
    return SimpleNamespace(name="app", attrs={"State": {"Pid": pid}}, reload=lambda: None)


@pytest.fixture
def proc(tmp_path: Path) -> Path:
    (tmp_path / "proc" / "42").mkdir(parents=True)
    return tmp_path / "proc"


def test_version_1_has_a_folder_for_each_controller(tmp_path: Path, proc: Path) -> None:
    """Also for controllers that are mounted together; one that is not mounted is an error that names it."""
    (proc / "42" / "cgroup").write_text(V1)
    assert _cgroups.cgroup(container(42), "blkio", tmp_path, proc) == tmp_path / "blkio" / "docker" / "abc"
    assert _cgroups.cgroup(container(42), "cpu", tmp_path, proc) == tmp_path / "cpu,cpuacct" / "docker" / "abc"
    with pytest.raises(LookupError, match="no cgroup of the controller pids"):
        _cgroups.cgroup(container(42), "pids", tmp_path, proc)


def test_version_2_has_one_folder(tmp_path: Path, proc: Path) -> None:
    """For every controller."""
    (tmp_path / "cgroup.controllers").write_text("cpu io memory pids\n")
    (proc / "42" / "cgroup").write_text("0::/system.slice/docker-abc.scope\n")
    assert _cgroups.cgroup(container(42), "blkio", tmp_path, proc) == tmp_path / "system.slice" / "docker-abc.scope"


def test_a_stopped_container_has_no_cgroup(tmp_path: Path) -> None:
    """Its process id is 0."""
    with pytest.raises(LookupError, match="does not run"):
        _cgroups.cgroup(container(0), "cpu", tmp_path, tmp_path)


def test_a_container_whose_process_is_ending_has_no_cgroup(tmp_path: Path, proc: Path) -> None:
    """Version 1 shows the root for it: its counters are those of the entire machine."""
    (proc / "42" / "cgroup").write_text("7:blkio:/\n2:cpu,cpuacct:/\n0::/docker/abc\n")
    with pytest.raises(LookupError, match="no cgroup of the controller cpuacct"):
        _cgroups.cgroup(container(42), "cpuacct", tmp_path, proc)


def test_a_disk_is_throttled_and_released_on_version_2(tmp_path: Path) -> None:
    """`io.max` has both directions in one line, and `max` removes the limit."""
    (tmp_path / "io.max").touch()
    _cgroups.throttle(tmp_path, "8:0", 1024)
    assert (tmp_path / "io.max").read_text() == "8:0 rbps=1024 wbps=1024\n"
    assert _cgroups.throttled(tmp_path, "8:0")
    assert not _cgroups.throttled(tmp_path, "8:16")
    _cgroups.throttle(tmp_path, "8:0", 0)
    assert (tmp_path / "io.max").read_text() == "8:0 rbps=max wbps=max\n"
    assert not _cgroups.throttled(tmp_path, "8:0")


def test_a_partition_is_throttled_by_its_disk(tmp_path: Path) -> None:
    """The kernel accepts limits only for a disk."""
    number = os.stat(tmp_path).st_dev
    part = tmp_path / "sda" / "sda1"
    part.mkdir(parents=True)
    (tmp_path / "sda" / "dev").write_text("8:0\n")
    (tmp_path / f"{os.major(number)}:{os.minor(number)}").symlink_to(part)
    assert _cgroups.disk(str(tmp_path), tmp_path) == f"{os.major(number)}:{os.minor(number)}"
    (part / "partition").write_text("1\n")
    assert _cgroups.disk(str(tmp_path), tmp_path) == "8:0"


def test_a_file_system_in_memory_cannot_be_throttled(tmp_path: Path) -> None:
    """It has no block device."""
    with pytest.raises(LookupError, match="not on a block device"):
        _cgroups.disk(str(tmp_path), tmp_path)
