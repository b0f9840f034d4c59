"""One file in the format of the engine's archive calls: a tar with a single member, read as a stream or created in
memory."""

from __future__ import annotations

import io
import posixpath
import tarfile
from collections.abc import Callable
from dataclasses import dataclass

from requests.models import Response

from phm.facts import CannotTell

MOST_HEADER = 1 << 20
"""Bytes read before the content: tarfile holds an extended header in memory, whatever size it states."""
_PIECE = 64 << 10


@dataclass(frozen=True, slots=True)
class FileCopy:
    """A regular file: its content, permission bits and owner."""

    data: bytes
    mode: int
    uid: int
    gid: int


class _Reader:
    """`read(n)` over the pieces of a response, for tarfile's stream mode.

    in_header: the content has not begun; then there is a limit.
    """

    def __init__(self, response: Response, what: str) -> None:
        self._pieces, self._what = response.iter_content(_PIECE), what
        self._rest = b""
        self._asked = 0
        self.in_header = True

    def read(self, size: int) -> bytes:
        self._asked += size
        if self.in_header and self._asked > MOST_HEADER:
            raise CannotTell(f"{self._what} has a header of more than {MOST_HEADER} bytes")
        parts, missing = [], size
        while missing > 0:
            piece = self._rest or next(self._pieces, b"")
            if not piece:
                break
            parts.append(piece[:missing])
            self._rest, missing = piece[missing:], missing - len(parts[-1])
        return b"".join(parts)


def unpack(response: Response, sink: Callable[[bytes], object], what: str, limit: int) -> tarfile.TarInfo:
    """Pass the only file of the tar to `sink`. Returns its header. Raises CannotTell unless it is a file within
    `limit`."""
    reader = _Reader(response, what)
    with tarfile.open(fileobj=reader, mode="r|") as archive:  # type: ignore[call-overload]
        member: tarfile.TarInfo | None = archive.next()
        reader.in_header = False
        content = archive.extractfile(member) if member is not None and member.isreg() else None
        if member is None or content is None:
            raise CannotTell(f"{what} is not a regular file")
        if member.size > limit:
            raise CannotTell(f"{what} has {member.size} bytes, more than the {limit} that PHM reads")
        size = 0
        while piece := content.read(_PIECE):
            sink(piece)
            size += len(piece)
        if size != member.size:
            raise EOFError(f"got {size} of {member.size} bytes")
        return member


def pack(path: str, copy: FileCopy, now: float) -> bytes:
    """A tar that contains `copy` at the relative `path`, last changed at `now` (UTC seconds)."""
    member = tarfile.TarInfo(posixpath.normpath(path))
    member.size, member.mode, member.mtime = len(copy.data), copy.mode & 0o7777, int(now)
    member.uid, member.gid = copy.uid, copy.gid
    made = io.BytesIO()
    with tarfile.open(fileobj=made, mode="w", format=tarfile.PAX_FORMAT) as archive:
        archive.addfile(member, io.BytesIO(copy.data))
    return made.getvalue()
