"""What is measured of the processes of PHM."""

from __future__ import annotations

from pathlib import Path

import pytest

from sitl.soak.process_tree import Wakeups, descriptors, memory_mb, tree


def process(proc: Path, pid: int, parent: int, name: str, switches: dict[int, int]) -> None:
    """What /proc has of a process."""
    folder = proc / str(pid)
    (folder / "fd").mkdir(parents=True, exist_ok=True)
    (folder / "fd" / "0").touch()
    (folder / "comm").write_text(f"{name}\n")
    (folder / "stat").write_text(f"{pid} ({name}) ) S {parent} 1 1 0\n")
    (folder / "smaps_rollup").write_text(
        "0 r\nRss: 2000 kB\nPrivate_Clean: 100 kB\nPrivate_Dirty: 400 kB\n".replace("0 r\n", "")
    )
    for thread, made in switches.items():
        (folder / "task" / str(thread)).mkdir(parents=True, exist_ok=True)
        (folder / "task" / str(thread) / "status").write_text(f"Name:\tx\nvoluntary_ctxt_switches:\t{made}\n")


def test_a_health_check_is_not_counted_as_phm(tmp_path: Path) -> None:
    """It is in the container, and no descendant of its first process."""
    process(tmp_path, 50, 1, "tini", {50: 1})
    process(tmp_path, 60, 50, "python", {60: 10, 61: 5})
    process(tmp_path, 70, 60, "python", {70: 0})
    process(tmp_path, 80, 1, "phm health", {80: 9})
    found = tree(50, [50, 60, 70, 80], tmp_path)
    assert (list(found.pids), found.daemon) == ([50, 60, 70], "50/60")
    assert memory_mb(found.pids, tmp_path) == pytest.approx((3 * 2000 * 1024 / 1e6, 3 * 500 * 1024 / 1e6))
    assert descriptors(found.pids, tmp_path) == 3
    with pytest.raises(LookupError, match="has ended"):
        tree(51, [60], tmp_path)


def test_wakeups_never_fall_when_a_thread_ends(tmp_path: Path) -> None:
    """A new thread counts from its start; the first count begins at 0."""
    process(tmp_path, 60, 1, "python", {60: 10, 61: 500})
    meter = Wakeups()
    assert (meter.take([60], tmp_path), meter.total) == (2, 0)
    process(tmp_path, 60, 1, "python", {60: 15, 62: 3})
    (tmp_path / "60" / "task" / "61" / "status").unlink()
    assert (meter.take([60], tmp_path), meter.total) == (2, 8)
