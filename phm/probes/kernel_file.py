"""Reads small files of the kernel (/proc, /sys) with one system call."""

from __future__ import annotations

import os


def head(path: str, most: int = 1024) -> str:
    """The first `most` bytes; the last line may be incomplete. Raises OSError."""
    number = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return os.read(number, most).decode("ascii", "replace")
    finally:
        os.close(number)
