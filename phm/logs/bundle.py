"""One file for a report of a problem: what is known about this agent, without secrets."""

from __future__ import annotations

import errno
import gzip
import io
import json
import os
import re
import stat
import tarfile
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, cast

from phm.logs.deadline import Deadline, Late
from phm.logs.secrets import MOST_LINE, Secrets, listed
from phm.wire import json_log

MOST_LOG_BYTES = 40_000_000
"""Of all logs of PHM together, not compressed; the newest files first."""
MOST_REMOVED = 1000
LIMIT_S = 180.0
"""For everything, unless the caller says another."""
LOGS_SHARE = 0.9
"""Share of the time limit after which further logs are left out."""
_BROKEN = (OSError, EOFError, zlib.error)
_READING = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_ROOT = "phm-bundle"


@dataclass
class Bundle:
    """Writes into an open tar. Texts and trees are cleaned on their way; learn the secrets first."""

    archive: tarfile.TarFile
    secrets: Secrets
    written: list[tuple[str, int]] = field(default_factory=list)
    """The name and the number of bytes of each file in the bundle."""
    missing: list[tuple[str, str]] = field(default_factory=list)
    """What is missing in the bundle, and why."""
    deadline: Deadline = field(default_factory=lambda: Deadline(LIMIT_S))

    def tree(self, name: str, tree: Any) -> None:
        """Add a value as a file of JSON."""
        cleaned = json.dumps(self.secrets.clean_json(tree, name), indent=2, default=str)
        self._add(name, cleaned.encode() + b"\n")

    def text(self, name: str, text: str, *, urls: bool = False) -> None:
        """urls: what is behind the host of each URL is removed, too."""
        cleaned = "\n".join(self.secrets.clean_lines(text.split("\n"), name))
        self._add(name, (self.secrets.clean_urls(cleaned, name) if urls else cleaned).encode("utf-8", "replace"))

    def logs(self, directory: Path) -> None:
        """`phm.jsonl` and `phm.log` with what rotation made of them, the newest first, not compressed inside."""
        left = MOST_LOG_BYTES
        try:
            found = self.deadline.within(LOGS_SHARE, lambda: _found(directory))
        except (OSError, Late) as error:
            self.missing.append(("logs", f"{directory}: {error}"))
            return
        if not found:
            self.missing.append(("logs", f"no phm.jsonl and no phm.log in {directory}"))
        for file, _base in sorted(found, key=lambda pair: _age(*pair)):
            if left <= 0 or not self.deadline.left(LOGS_SHARE):
                why = (
                    f"not reached within the time limit of {self.deadline.seconds:g} s"
                    if left > 0
                    else f"more than {MOST_LOG_BYTES // 1_000_000} MB of logs"
                )
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
        """Add a log; return the number of bytes that were added."""
        name = f"logs/{file.name.removesuffix(json_log.COMPRESSED)}"
        with tempfile.TemporaryFile() as raw, tempfile.TemporaryFile() as spool:
            try:
                broken = self.deadline.within(LOGS_SHARE, lambda: _copy(file, limit, raw, self.deadline))
            except (OSError, Late) as error:
                self.missing.append((name, getattr(error, "strerror", None) or str(error)))
                return 0
            if broken:
                self.missing.append((name, f"the rest of it: {broken}"))
            raw.seek(0)
            lines = (line.rstrip(b"\n").decode("utf-8", "surrogateescape") for line in raw)
            for line in self._cleaned(lines, name):
                spool.write(line.encode("utf-8", "surrogateescape") + b"\n")
                if not self.deadline.left(LOGS_SHARE):
                    self.missing.append(
                        (name, f"the rest of it: not reached within the time limit of {self.deadline.seconds:g} s")
                    )
                    break
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


def write(path: Path, fill: Callable[[Bundle], None], secrets: Secrets, deadline: Deadline | None = None) -> Bundle:
    """Write the file; it appears complete or not at all, and only its owner can read it. Raises OSError.

    fill: adds everything. deadline: of all parts. An existing file is an error.
    """
    if path.exists():
        raise FileExistsError(17, "exists already: name another file", str(path))
    number, temporary = tempfile.mkstemp(prefix=".phm-bundle-", dir=path.parent)
    try:
        with os.fdopen(number, "wb") as target, tarfile.open(fileobj=target, mode="w:gz") as archive:
            made = Bundle(archive, secrets, deadline=deadline or Deadline(LIMIT_S))
            fill(made)
            made.finish()
        os.replace(temporary, path)
    except BaseException:  # also at Ctrl-C: no half of a bundle stays
        os.unlink(temporary)
        raise
    return made


def file_name(text: str) -> str:
    """`text` as the name of a folder, of at most 100 bytes: file systems allow 255."""
    name = re.sub(r"[^\w.\-]", "_", text).encode()[:100].decode("utf-8", "ignore")
    return name.lstrip(".") or "_"


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


def _found(directory: Path) -> list[tuple[Path, str]]:
    """The files of both logs, each with the name of its log."""
    return [(file, base) for base in ("phm.jsonl", "phm.log") for file in json_log.files(directory / base)[::-1]]


def _copy(file: Path, limit: int, raw: IO[bytes], deadline: Deadline) -> str:
    """Its lines, not cleaned, and why they are not all. Runs in a thread that may hang, and then ends as `raw` is closed. Raises
    OSError if it cannot be opened."""
    with _opened(file) as plain:
        try:
            for line in _lines(plain, file.name.endswith(json_log.COMPRESSED), limit):
                raw.write(line.encode("utf-8", "surrogateescape") + b"\n")
                if not deadline.left(LOGS_SHARE):
                    return f"not reached within the time limit of {deadline.seconds:g} s"
        except _BROKEN as error:
            return str(getattr(error, "strerror", None) or error)
    return ""


def _opened(file: Path) -> IO[bytes]:
    """Only a regular file: a link in the folder could lead to any file that this user can read, and a pipe has no end. Raises
    OSError."""
    try:
        handle = os.open(file, _READING)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise OSError(error.errno, "a symbolic link, which is not followed") from None
        raise
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "not a regular file")
    return os.fdopen(handle, "rb")


def _lines(plain: IO[bytes], compressed: bool, limit: int) -> Iterable[str]:
    """At most about `limit` bytes; long lines are cut. Raises OSError if there is more."""
    stream = cast(IO[bytes], gzip.GzipFile(fileobj=plain)) if compressed else plain
    yield from _bounded(stream, limit)


def _bounded(stream: IO[bytes], limit: int) -> Iterator[str]:
    begun = False
    while part := stream.readline(MOST_LINE):
        if limit <= 0:
            raise OSError("too long")
        limit -= len(part)
        if not begun:
            yield part.rstrip(b"\n").decode("utf-8", "surrogateescape")
        begun = not part.endswith(b"\n")
