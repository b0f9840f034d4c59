"""One file for a report of a problem: what is known about this agent, without secrets."""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import tarfile
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, cast

from phm.logs.secrets import MOST_LINE, Secrets, listed
from phm.wire import json_log

MOST_LOG_BYTES = 40_000_000
"""Of all logs of PHM together, not compressed; the newest files first."""
MOST_REMOVED = 1000
LIMIT_S = 120.0
"""After this, further logs are left out."""
_BROKEN = (OSError, EOFError, zlib.error)
_ROOT = "phm-bundle"

Tree = Callable[[], Any]


@dataclass
class Bundle:
    """Writes into an open tar. Texts and trees are cleaned on their way; learn the secrets first."""

    archive: tarfile.TarFile
    secrets: Secrets
    written: list[tuple[str, int]] = field(default_factory=list)
    """Name and bytes."""
    missing: list[tuple[str, str]] = field(default_factory=list)
    """What, and why it is not in it."""
    end: float = field(default_factory=lambda: time.monotonic() + LIMIT_S)

    def tree(self, name: str, tree: Any) -> None:
        """As JSON."""
        cleaned = json.dumps(self.secrets.clean_json(tree, name), indent=2, default=str)
        self._add(name, cleaned.encode() + b"\n")

    def text(self, name: str, text: str, *, urls: bool = False) -> None:
        """urls: what is behind the host of each URL is removed, too."""
        cleaned = "\n".join(self.secrets.clean_lines(text.split("\n"), name))
        self._add(name, (self.secrets.clean_urls(cleaned, name) if urls else cleaned).encode("utf-8", "replace"))

    def logs(self, directory: Path) -> None:
        """`phm.jsonl` and `phm.log` with what rotation made of them, the newest first, not compressed inside."""
        left = MOST_LOG_BYTES
        found = [(file, base) for base in ("phm.jsonl", "phm.log") for file in json_log.files(directory / base)[::-1]]
        if not found:
            self.missing.append(("logs", f"no phm.jsonl and no phm.log in {directory}"))
        for file, _base in sorted(found, key=lambda pair: _age(*pair)):
            if left <= 0 or time.monotonic() > self.end:
                why = "takes too long" if left > 0 else f"more than {MOST_LOG_BYTES // 1_000_000} MB of logs"
                self.missing.append((f"logs/{file.name}", why))
                continue
            left -= self._log(file, left)

    def removed(self) -> list[str]:
        return listed(self.secrets.removed)

    def finish(self) -> None:
        """Add REMOVED.txt and MISSING.txt."""
        lines = self.removed()
        more = [f"and {len(lines) - MOST_REMOVED} more"] if len(lines) > MOST_REMOVED else []
        head = "Secrets that `phm logs bundle` has removed, by file. Look through the bundle before you send it.\n\n"
        self._add("REMOVED.txt", (head + "\n".join([*lines[:MOST_REMOVED], *more]) + "\n").encode("utf-8", "replace"))
        if self.missing:
            text = "\n".join(f"{what}: {why}" for what, why in self.missing)
            self._add(
                "MISSING.txt", self.secrets.clean_urls(self.secrets.clean(text, "MISSING.txt"), "MISSING.txt").encode()
            )

    def _log(self, file: Path, limit: int) -> int:
        """Returns the bytes that were added."""
        name = f"logs/{file.name.removesuffix(json_log.COMPRESSED)}"
        with tempfile.TemporaryFile() as spool:
            try:
                for line in self._cleaned(_lines(file, limit), name):
                    spool.write(line.encode("utf-8", "surrogateescape") + b"\n")
                    if time.monotonic() > self.end:
                        self.missing.append((name, "its rest: takes too long"))
                        break
            except _BROKEN as error:
                self.missing.append((name, f"its rest: {getattr(error, 'strerror', None) or error}"))
            if spool.tell() >= limit:
                self.missing.append((name, "its rest: too long"))
            size = spool.tell()
            spool.seek(0)
            self._member(name, size, spool)
        return size

    def _cleaned(self, lines: Iterable[str], name: str) -> Iterable[str]:
        if ".jsonl" not in name:
            return self.secrets.clean_lines(lines, name)
        return (self.secrets.clean_event(line, name) for line in lines)

    def _add(self, name: str, data: bytes) -> None:
        self._member(name, len(data), io.BytesIO(data))

    def _member(self, name: str, size: int, content: IO[bytes]) -> None:
        member = tarfile.TarInfo(f"{_ROOT}/{name}")
        member.size, member.mode, member.mtime = size, 0o600, int(time.time())
        self.archive.addfile(member, content)
        self.written.append((name, size))


def write(path: Path, fill: Callable[[Bundle], None], secrets: Secrets) -> Bundle:
    """Write the file; it appears complete or not at all, and only its owner can read it. Raises OSError.

    fill: adds everything. An existing file is an error.
    """
    if path.exists():
        raise FileExistsError(17, "exists already: name another file", str(path))
    number, temporary = tempfile.mkstemp(prefix=".phm-bundle-", dir=path.parent)
    try:
        with os.fdopen(number, "wb") as target, tarfile.open(fileobj=target, mode="w:gz") as archive:
            made = Bundle(archive, secrets)
            fill(made)
            made.finish()
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
    return made


def file_name(text: str) -> str:
    """`text` as the name of a folder inside."""
    return re.sub(r"[^\w.\-]", "_", text)[:100].lstrip(".") or "_"


def chosen(environ: Mapping[str, str]) -> dict[str, str]:
    """The variables that PHM, ROS and Docker read."""
    prefixes = (
        "PHM_",
        "ROS_",
        "RMW_",
        "FASTRTPS",
        "FASTDDS",
        "CYCLONEDDS",
        "ZENOH_",
        "DOCKER_",
        "TZ",
        "LANG",
        "AMENT_",
    )
    return {name: value for name, value in sorted(environ.items()) if name.startswith(prefixes)}


def _age(file: Path, base: str) -> tuple[int, str]:
    return json_log.rotated_number(base, file.name) or 0, base


def _lines(file: Path, limit: int) -> Iterable[str]:
    """At most about `limit` bytes; long lines are cut."""
    if not file.is_file():
        raise OSError(22, "not a regular file")
    with file.open("rb") as plain:
        stream = cast(IO[bytes], gzip.GzipFile(fileobj=plain)) if file.name.endswith(json_log.COMPRESSED) else plain
        yield from _bounded(stream, limit)


def _bounded(stream: IO[bytes], limit: int) -> Iterator[str]:
    begun = False
    while limit > 0 and (part := stream.readline(MOST_LINE)):
        limit -= len(part)
        if not begun:
            yield part.rstrip(b"\n").decode("utf-8", "surrogateescape")
        begun = not part.endswith(b"\n")
