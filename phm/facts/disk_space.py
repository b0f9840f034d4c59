"""Disk usage, calculated like `df`: for the check and for the action that frees space, so that both use the same number."""

from __future__ import annotations

import os

from phm.facts import DiskFact


def space(path: str) -> DiskFact:
    """Return the usage of the disk that contains `path`. Blocks reserved for root count as neither used nor free.

    Raises OSError; can hang on a dead mount.
    """
    seen = os.statvfs(path)
    used = seen.f_blocks - seen.f_bfree
    usable = used + seen.f_bavail
    # Some file systems (btrfs) have no fixed number of inodes and report 0.
    inodes = 100.0 * (seen.f_files - seen.f_ffree) / seen.f_files if seen.f_files else 0.0
    percent, free = 100.0 * used / usable if usable else 0.0, seen.f_bavail * seen.f_frsize
    return DiskFact(path, percent, free, inodes, total_bytes=usable * seen.f_frsize)
