"""Ends a process with its parent, also one that hangs or whose parent was killed."""

from __future__ import annotations

import ctypes
import os

_PR_SET_PDEATHSIG, _SIGKILL = 1, 9


def die_with_parent(parent: int) -> None:
    """Let the kernel kill this process when its parent ends; without effect where the kernel is not Linux.

    It ends immediately if the parent, the process with this id, has already ended.
    """
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, _SIGKILL, 0, 0, 0)
    except (OSError, AttributeError, TypeError):  # no such function; TypeError: Windows, where None is not a library
        return
    if os.getppid() != parent:
        os._exit(0)
