"""Memory that the process no longer needs."""

from __future__ import annotations

import contextlib
import ctypes


def give_back() -> None:
    """Return what is free on the C library's heap to the system. Takes some ms; call it after the start. Only glibc can do that."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
