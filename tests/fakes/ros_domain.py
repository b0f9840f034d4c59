"""ROS domains for tests that run side by side: a PHM on this machine receives the applications of all containers, too."""

from __future__ import annotations

import fcntl
import itertools
import os
import tempfile
from pathlib import Path
from typing import IO

FIRST_DOMAIN, DOMAINS = 60, 42
"""Clear of 0, which others use, and up to 101: the ports of 102 are ephemeral ones, which any socket may have."""
_turns = itertools.count(os.getpid())


def claim_domain() -> tuple[int, IO[bytes]]:
    """A ROS domain that no other test on this machine uses while the file is open: the kernel releases it with the process."""
    for turn in itertools.islice(_turns, DOMAINS):
        domain = FIRST_DOMAIN + turn % DOMAINS
        lock = Path(tempfile.gettempdir(), f"phm-ros-domain-{domain}.lock").open("ab")  # noqa: SIM115 (it outlives this)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
        else:
            return domain, lock
    raise RuntimeError(f"all ROS domains from {FIRST_DOMAIN} to {FIRST_DOMAIN + DOMAINS - 1} are used by other tests")
