"""Manifest of a folder: the SHA-256 of each file in it, in the format of `sha256sum`. Pure.

One line per file: checksum, two spaces, path relative to the folder. As in `sha256sum`, a line whose path contains a backslash
or a line break begins with a backslash and has them escaped. Lines that begin with ``#`` are comments. A symbolic link has the
checksum of its target's text, because links are not followed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

MAX_BYTES = 32 << 20
MAX_FILES = 50_000
_LINE = re.compile(r"(\\?)([0-9a-fA-F]{64}) [ *](.+)")
_ESCAPES = {"\\": "\\\\", "\n": "\\n", "\r": "\\r"}
_UNESCAPE = re.compile(r"\\([\\nr])")
_PLAIN = {"\\": "\\", "n": "\n", "r": "\r"}


def encode(files: Mapping[str, str], comment: str = "") -> bytes:
    """The text of a manifest. files: checksum by path; a path may hold any bytes (surrogateescape)."""
    lines = [f"# {line}" for line in comment.splitlines()]
    for path in sorted(files):
        escaped = "".join(_ESCAPES.get(char, char) for char in path)
        lines.append(f"{'' if escaped == path else chr(92)}{files[path]}  {escaped}")
    return "".join(f"{line}\n" for line in lines).encode("utf-8", "surrogateescape")


def decode(data: bytes) -> dict[str, str]:
    """Checksum by path. Raises ValueError with the number of a line that is invalid."""
    if len(data) > MAX_BYTES:
        raise ValueError(f"is larger than {MAX_BYTES >> 20} MiB")
    files: dict[str, str] = {}
    for number, line in enumerate(data.decode("utf-8", "surrogateescape").split("\n"), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        match = _LINE.fullmatch(line.rstrip("\r"))
        if match is None:
            raise ValueError(f"line {number} is not a checksum and a path, as sha256sum writes them")
        escaped, total, path = match.groups()
        path = (_UNESCAPE.sub(lambda found: _PLAIN[found[1]], path) if escaped else path).removeprefix("./")
        if path.startswith("/") or ".." in path.split("/"):
            raise ValueError(f"line {number} names a path outside of the folder")
        files[path] = total.lower()
        if len(files) > MAX_FILES:
            raise ValueError(f"has more than {MAX_FILES} files")
    return files
