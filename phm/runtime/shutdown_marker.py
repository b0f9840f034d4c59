"""Whether the PHM before this one ended in good order: a file in `state_dir` that only an orderly end removes."""

from __future__ import annotations

import contextlib
from pathlib import Path

from phm.wire.status_file import place

NAME = "running"


class ShutdownMarker:
    """The machine's boot id stands in the file: a power cut is no crash of PHM, and vehicles are switched off like that.

    A folder that cannot be written is told by whoever keeps more there (`phm.recovery.persistence.state_file`).
    """

    def __init__(self, directory: str, boot: str | None = None) -> None:
        self._file = Path(directory) / NAME
        self._boot = place()["machine_boot"] if boot is None else boot

    def begin(self) -> bool:
        """Note that PHM runs. True when an earlier one of this boot of the machine has not ended in good order."""
        try:
            left = self._file.read_text("ascii", errors="replace").strip()
        except OSError:
            left = ""
        with contextlib.suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self._file.write_text(f"{self._boot}\n", "ascii")
        return bool(left) and left == self._boot

    def end(self) -> None:
        """PHM ends because it was told to."""
        with contextlib.suppress(OSError):
            self._file.unlink(missing_ok=True)
