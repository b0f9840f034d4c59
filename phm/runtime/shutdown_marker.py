"""Detects that the previous PHM terminated unexpectedly: a file in `state_dir` that only an orderly stop removes."""

from __future__ import annotations

import contextlib
from pathlib import Path

from phm.wire.status_file import place

NAME = "running"


class ShutdownMarker:
    """The file contains the machine's boot id: switching the vehicle off is not a crash of PHM.

    Errors of the directory are reported by `phm.recovery`, which keeps its state there.
    """

    def __init__(self, directory: str, boot: str | None = None) -> None:
        self._file = Path(directory) / NAME
        self._boot = place()["machine_boot"] if boot is None else boot

    def begin(self) -> bool:
        """Write the file. True when an earlier PHM terminated unexpectedly since the machine was booted."""
        try:
            left = self._file.read_text("ascii", errors="replace").strip()
        except OSError:
            left = ""
        with contextlib.suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self._file.write_text(f"{self._boot}\n", "ascii")
        return bool(left) and left == self._boot

    def end(self) -> None:
        """Remove the file: PHM stops in order."""
        with contextlib.suppress(OSError):
            self._file.unlink(missing_ok=True)
