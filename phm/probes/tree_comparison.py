"""Compares a folder with its manifest. Part of `phm.probes.files`."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase

from phm.facts import CannotTell, TreeFact
from phm.probes.file_stamp import Stamp, settled, stamp
from phm.probes.file_tree import TreeListing
from phm.wire import manifest


class Manifests:
    """Manifest files by path, read again when they change."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[Stamp | None, dict[str, str]]] = {}

    def read(self, path: str) -> Mapping[str, str]:
        """Checksum by relative path. Raises CannotTell."""
        try:
            with open(path, "rb", opener=_without_blocking) as stream:
                info = os.fstat(stream.fileno())
                known = self._known.get(path)
                if known is None or known[0] != stamp(info):
                    key = stamp(info) if settled(info) else None
                    known = self._known[path] = (key, manifest.decode(stream.read(manifest.MAX_BYTES + 1)))
        except OSError as error:
            raise CannotTell(
                f"the manifest {path} cannot be read ({error.strerror}): mount it for PHM, or write it with `phm learn`"
            ) from None
        except ValueError as error:
            raise CannotTell(f"the manifest {path} {error}: write it again with `phm learn`") from None
        return known[1]


class Comparison:
    """Compares one folder with one manifest, and again only when one of them is another object: with 50 000 files this costs
    more than all the rest of a run of the check. Thread-safe."""

    def __init__(self, ignore: Sequence[str]) -> None:
        self._ignore = ignore
        self._lock = threading.Lock()
        self._expected: Mapping[str, str] | None = None
        self._wanted: dict[str, str] = {}
        self._last: tuple[TreeListing, TreeFact] | None = None

    def of(self, expected: Mapping[str, str], found: TreeListing) -> TreeFact:
        """Paths that are ignored do not count, even if the manifest has them.

        Raises CannotTell if nothing differs only because `ignore` covers all of the manifest.
        """
        with self._lock:
            if expected is not self._expected:
                self._wanted = {path: total for path, total in expected.items() if not _ignored(path, self._ignore)}
                self._expected, self._last = expected, None
            if self._last is None or self._last[0] is not found:
                self._last = found, compare(self._wanted, found)
            fact, nothing = self._last[1], bool(expected) and not self._wanted
        if nothing and not fact.new:
            raise CannotTell(
                "`ignore` covers all files of its manifest, so nothing is compared: remove patterns from `ignore`"
            )
        return fact


def compare(wanted: Mapping[str, str], found: TreeListing) -> TreeFact:
    unread = found.pending | found.unreadable
    changed = [path for path, total in found.sums.items() if path in wanted and wanted[path] != total]
    missing = [path for path in wanted if path not in found.sums and not _within(path, unread)]
    new = [path for path in (*found.sums, *found.pending) if path not in wanted]
    return TreeFact(
        len(found.sums) + len(found.pending),
        found.size,
        len(changed) + len(missing) + len(new),
        _first(changed),
        _first(missing),
        _first(new),
        len(found.pending),
        _first(found.unreadable),
    )


def _within(path: str, unread: set[str]) -> bool:
    """Whether the path, or a folder in which it is, could not be read."""
    if not unread:
        return False
    parts = path.split("/")
    return any("/".join(parts[:end]) in unread for end in range(1, len(parts) + 1))


def _ignored(path: str, patterns: Sequence[str]) -> bool:
    parts = path.split("/")
    paths = ["/".join(parts[:end]) for end in range(1, len(parts) + 1)]
    return any(fnmatchcase(name, pattern) for pattern in patterns for name in (*parts, *paths))


def _first(paths: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted(paths)[: TreeFact.MAX_NAMED])


def _without_blocking(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)
