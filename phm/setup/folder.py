"""Writes the folders of `phm init` and `phm new-check`; files that exist are replaced only on request."""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from collections.abc import Mapping
from itertools import takewhile
from pathlib import Path

PHM_USER = 10001
"""The user id and the group id of PHM's image."""


class FilesExist(Exception):
    """Files that would be overwritten. `names` lists them."""

    def __init__(self, folder: Path, names: list[str]) -> None:
        self.names = names
        super().__init__(f"{folder} already has {', '.join(names)}: nothing was written; --force replaces these files")


def existing(folder: Path, names: Mapping[str, str]) -> list[str]:
    """Those of `names` that are in the folder."""
    return sorted(name for name in names if os.path.lexists(folder / name))


def check(folder: Path, texts: Mapping[str, str], *, force: bool) -> None:
    """Raises FilesExist."""
    found = existing(folder, texts)
    if found and not force:
        raise FilesExist(folder, found)


def write(folder: Path, texts: Mapping[str, str], *, force: bool) -> None:
    """Write all files, by their paths in the folder, readable for PHM's user whatever the umask is. As root, e.g. in a container, they
    and new folders belong to the owner of the folder they are in, who edits them later. Raises FilesExist before anything is
    written, and OSError."""
    check(folder, texts, force=force)
    new = list(takewhile(lambda one: not one.exists(), (folder, *folder.parents)))
    where = (new[-1].parent if new else folder).stat()
    if not folder.is_dir():
        folder.mkdir(parents=True)
        folder.chmod(0o755)
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        beside = path.with_name(f".{path.name}.new")
        beside.write_text(text, encoding="utf-8")
        beside.chmod(0o644)
        os.replace(beside, path)
    if os.geteuid() == 0:
        for path in (*new, *(folder / name for name in texts)):
            with contextlib.suppress(PermissionError):  # a file system without owners
                os.chown(path, where.st_uid, where.st_gid, follow_symlinks=False)


def make_key(path: Path) -> None:
    """Write a random key that only its owner can read. One that exists stays: the ground station has it. Raises OSError."""
    with contextlib.suppress(FileExistsError), open(path, "x", encoding="ascii", opener=_private) as stream:
        stream.write(f"{secrets.token_hex(32)}\n")


def _private(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


def give_to_phm(folder: Path) -> bool:
    """Make PHM's user the owner of a folder and its files; False if this process may not. Raises OSError."""
    try:
        for path in (*folder.iterdir(), folder):
            os.chown(path, PHM_USER, PHM_USER, follow_symlinks=False)
    except PermissionError:
        return False
    return True


def write_new(folder: Path, texts: Mapping[str, str]) -> None:
    """Write files into a folder that does not exist yet. Paths are relative to it. Raises FileExistsError, and OSError."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir()
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")


def make_log_folder(path: Path) -> bool:
    """Make a folder that PHM's user may write to: its own where this process may say so, else one that everyone may write
    to, as /tmp. A folder that exists stays unchanged. Returns whether it is PHM's or everyone may write to it. Raises OSError."""
    if not path.is_dir():
        path.mkdir(parents=True)
        try:
            os.chown(path, PHM_USER, PHM_USER)
            path.chmod(0o755)
        except PermissionError:
            with contextlib.suppress(PermissionError):
                path.chmod(0o1777)
    found = path.stat()
    return found.st_uid == PHM_USER or bool(found.st_mode & stat.S_IWOTH)
