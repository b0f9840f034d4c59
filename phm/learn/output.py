"""Reads the configuration to update, and writes it with its manifests."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from phm.config.loader import loads
from phm.core.settings import Settings
from phm.learn.baseline import Baseline
from phm.wire import manifest

_EMPTY = "agent: {}\n"


def settings_of(text: str, file: str, environ: Mapping[str, str]) -> Settings:
    """The settings in a configuration that may be empty. Raises ConfigError."""
    return loads(text if text.strip() else _EMPTY, file, environ=environ)


def check(text: str, file: str, environ: Mapping[str, str]) -> None:
    """Raises ConfigError if what was written is not valid."""
    loads(text, file, environ=environ)


def check_folder(path: Path) -> None:
    """Raises OSError if the folder of this file, or the one in which it would be made, cannot be written to. Leaves nothing there."""
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    number, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=folder)
    os.close(number)
    os.unlink(temporary)


def write(path: Path, text: str, baseline: Baseline) -> list[Path]:
    """Write the configuration and its manifests beside it; returns what was written. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    written = []
    for name, folder in baseline.manifests.items():
        comment = f"Files of {folder.container}:{folder.path}, written by `phm learn`; `sha256sum -c` reads it in that folder."
        _replace(path.parent / name, manifest.encode(folder.files, comment))
        written.append(path.parent / name)
    _replace(path, text.encode())
    return [*written, path]


def _replace(path: Path, data: bytes) -> None:
    """Replace the file atomically, so that no reader finds half of it. A file that is mounted by itself can only be written to."""
    mode = path.stat().st_mode & 0o777 if path.exists() else 0o644
    number, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(number, "wb") as stream:
            stream.write(data)
            os.fchmod(stream.fileno(), mode)
        try:
            os.replace(temporary, path)
        except OSError:
            path.write_bytes(data)
            os.unlink(temporary)
    except BaseException:  # also Ctrl-C must leave no temporary file
        Path(temporary).unlink(missing_ok=True)
        raise
