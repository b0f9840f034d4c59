"""Whether a file is the one that was read before, from its status alone."""

from __future__ import annotations

import os
from time import time

Stamp = tuple[int, int, int, int, int]
COARSEST_S = 2.0
"""Resolution of the times of FAT; those of ext4 have that of the kernel's tick, up to 10 ms."""


def stamp(info: os.stat_result) -> Stamp:
    """Differs after a change, if the file was `settled` before it."""
    return info.st_dev, info.st_ino, info.st_size, info.st_mtime_ns, info.st_ctime_ns


def settled(info: os.stat_result) -> bool:
    """Whether a change from now on gets other times. Ask before reading; a file that is not settled must be read again.

    A change of equal size within the resolution of the times is not visible in them: "racy Git" in Git's documentation. The
    times are of the kernel's wall clock; those of a file from before a step of the clock are far from now, too.
    """
    return abs(time() - max(info.st_mtime, info.st_ctime)) >= COARSEST_S
