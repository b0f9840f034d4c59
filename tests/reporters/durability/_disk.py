"""A real ext4 file system in a file: it can be full, read-only, or lose its power."""

from __future__ import annotations

import contextlib
import filecmp
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

SIZE = 24 << 20


class Disk:
    """image: the disk as its device sees it, i.e. what survives a power cut. path: where it is mounted."""

    def __init__(self, folder: Path, name: str = "disk") -> None:
        self.image, self.path = folder / f"{name}.img", folder / name

    def make(self) -> None:
        with open(self.image, "wb") as file:
            file.truncate(SIZE)
        _run("mkfs.ext4", "-q", "-F", str(self.image))

    def mount(self, options: str = "") -> None:
        assert os.geteuid() == 0, "these tests mount their own file system: run them as root"
        self.path.mkdir(exist_ok=True)
        _run("mount", "-o", ",".join(filter(None, ("loop", options))), str(self.image), str(self.path))

    def remount(self, options: str) -> None:
        _run("mount", "-o", f"remount,{options}", str(self.path))

    def unmount(self) -> None:
        _run("umount", str(self.path))

    def snapshot(self, folder: Path, name: str) -> Disk:
        """The disk after a power cut at this moment: what its device has, without the memory of the kernel.

        Copied until two copies are equal: a real disk has one state at a time.
        """
        found = Disk(folder, name)
        other = folder / f"{name}.again"
        for _ in range(50):
            shutil.copyfile(self.image, found.image)
            shutil.copyfile(self.image, other)
            if filecmp.cmp(found.image, other, shallow=False):
                other.unlink()
                return found
        raise AssertionError("the kernel writes to the disk without a pause")


@contextlib.contextmanager
def mounted(disk: Disk, options: str = "") -> Iterator[Path]:
    disk.mount(options)
    try:
        yield disk.path
    finally:
        disk.unmount()


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stderr.strip()}"
