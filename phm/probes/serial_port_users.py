"""Which programs have a serial port open. Only processes in PHM's own PID namespace are visible, and only its own
user's unless it is root."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

MOST = 5


def users(path: str, proc: Path = Path("/proc")) -> tuple[str, ...]:
    """`name (pid)` of each other program that has `path` open, at most MOST."""
    wanted, found = os.path.realpath(path), []
    for process in _processes(proc):
        # Only the text of the link: following it would hang on a dead network mount.
        if wanted in _open_files(process):
            name = "unknown"
            with contextlib.suppress(OSError):
                name = (process / "comm").read_text(errors="replace").strip()
            found.append(f"{name} ({process.name})")
            if len(found) == MOST:
                break
    return tuple(found)


def _processes(proc: Path) -> Iterator[Path]:
    for name in sorted(os.listdir(proc)):
        if name.isdigit() and int(name) != os.getpid():
            yield proc / name


def _open_files(process: Path) -> set[str]:
    found = set()
    with contextlib.suppress(OSError):  # it has ended meanwhile, or PHM has no permission
        for number in os.listdir(process / "fd"):
            with contextlib.suppress(OSError):
                found.add(os.readlink(process / "fd" / number))
    return found
