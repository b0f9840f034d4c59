"""Reads files inside containers: through a volume that PHM can access too, otherwise through the engine.

A volume is cheap and works while the engine hangs; the engine reaches all files.
"""

from __future__ import annotations

import hashlib
import os
import stat
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, Final

from phm.core.clock import Clock
from phm.core.settings import DockerSettings
from phm.facts import CannotTell, ContainerFact, DockerProbe, FileFact, Mount, TreeFact
from phm.probes.docker_facts import TimeBudget
from phm.probes.file_stamp import settled, stamp
from phm.probes.file_tree import TreeListing, TreeReader
from phm.probes.inotify import FileWatcher
from phm.probes.tree_comparison import Comparison, Manifests
from phm.probes.volume_path import MAX_LINKS, OutsideVolumes, SeenAt, join, normal, real_path, resolve
from phm.transport.docker import DockerEngine, EngineMissing

MAX_BYTES = 1 << 30
DIGEST_S = 15.0
"""Deadline for reading an entire file; the rest of a scan has the engine's timeout."""
FRESH_S = 0.2
"""A response of the engine of this age is sufficient for the next file of a container."""
_SUMS = 256
_TOO_LARGE = "too large"
"""Stored instead of a checksum: the file is not read again until it has changed."""
_PIECE = 1 << 20
_GO_DIRECTORY, _GO_LINK, _GO_OTHER = 1 << 31, 1 << 27, 1 << 26 | 1 << 25 | 1 << 24 | 1 << 21 | 1 << 19
_GO_SPECIAL = ((1 << 23, stat.S_ISUID), (1 << 22, stat.S_ISGID), (1 << 20, stat.S_ISVTX))
_NOT_SEEN_BY_ENGINE: Final = ("/proc", "/sys", "/dev")


class Files:
    """Implements `phm.facts.FileProbe`. Thread-safe.

    changed: called when something may have changed in a volume on the path to a file that was looked up.
    """

    def __init__(
        self,
        docker_probe: DockerProbe,
        engine: DockerEngine,
        settings: DockerSettings,
        clock: Clock,
        watcher: FileWatcher | None = None,
        changed: Callable[[], None] = lambda: None,
    ) -> None:
        self._docker, self._engine, self._clock = docker_probe, engine, clock
        self._changed = changed
        self._watch = watcher.on(changed, content=True) if watcher is not None else lambda directory, name: False
        # With tcp:// the engine may be on another machine, whose paths do not exist here.
        self._same_host = settings.socket.startswith("unix:")
        self._last: dict[str, tuple[ContainerFact, ContainerFact | None]] = {}
        self._sums: OrderedDict[Hashable, str] = OrderedDict()
        self._lock = threading.Lock()
        self._trees: dict[tuple[str, str, tuple[str, ...]], TreeReader] = {}
        self._trees_lock = threading.Lock()
        self._manifests = Manifests()
        self._comparisons: dict[tuple[str, str, str, tuple[str, ...]], Comparison] = {}

    def inspect(self, container: str, path: str, *, digest: bool) -> FileFact | None:
        """Raises CannotTell if the container does not exist, or the file is too large or too slow to read."""
        path = normal(path)
        try:
            fact, me = self._docker.container(container, FRESH_S), self._docker.own_container()
        except CannotTell as error:
            return self._without_engine(container, path, digest, error)
        if fact is None:
            self._last.pop(container, None)
            raise CannotTell(f"the container {container} does not exist")
        self._last[container] = (fact, me)
        try:
            return self._through_volume(fact, me, path, digest)
        except OutsideVolumes:
            return self._through_engine(fact, path, digest)

    def _without_engine(self, container: str, path: str, digest: bool, error: CannotTell) -> FileFact | None:
        """Read through a volume, with the mounts of the engine's last response. Raises `error` if that is not possible."""
        last = self._last.get(container)
        if last is None:
            raise error
        try:
            return self._through_volume(*last, path, digest)
        except OutsideVolumes:
            raise error from None

    # ------------------------------------------------------------ folder

    def tree(self, container: str, path: str, *, manifest: str, ignore: Sequence[str]) -> TreeFact | None:
        """See `phm.facts.FileProbe`."""
        expected = self._manifests.read(manifest)
        found = self.listing(container, path, ignore)
        if found is None:
            return None
        with self._trees_lock:
            key = container, path, manifest, tuple(ignore)
            comparison = self._comparisons.setdefault(key, Comparison(key[-1]))
        return comparison.of(expected, found)

    def listing(
        self, container: str, path: str, ignore: Sequence[str], *, fresh: bool = False, partly: bool = False
    ) -> TreeListing | None:
        """The files of a folder of the container, with the checksums that could be calculated in this scan.

        fresh: do not use the listing of an earlier scan. partly: also if something is mounted in it that PHM does not see.
        """
        path = normal(path)
        try:
            fact, me = self._docker.container(container), self._docker.own_container()
        except CannotTell:
            if container not in self._last:
                raise
            fact, me = self._last[container]
        if fact is None:
            raise CannotTell(f"the container {container} does not exist")
        self._last[container] = (fact, me)
        roots = self._roots(fact, me)
        mounts = {normal(mount.destination): roots.get(mount.destination) for mount in fact.mounts}
        try:
            number = resolve(path, mounts)
        except OutsideVolumes:
            raise CannotTell(
                f"{path} is not in a volume that PHM sees: mount that volume or host folder for PHM, too, or list single files"
            ) from None
        if number is None:
            return None
        try:
            if not stat.S_ISDIR(os.fstat(number).st_mode):
                raise CannotTell(f"{path} is not a folder: a manifest describes a folder")
            with self._trees_lock:
                reader = self._trees.setdefault((container, path, tuple(ignore)), TreeReader(self._clock))
            # Without the lock: a volume that hangs delays only the looks at its own folders.
            with ExitStack() as opened:
                below = _mounts_below(path, mounts, opened)
                return reader.read(number, ignore, below, fresh=fresh, partly=partly)
        except OSError as error:
            raise CannotTell(f"{path} cannot be read: {error.strerror}") from None
        finally:
            os.close(number)

    # ------------------------------------------------------------ volume

    def _through_volume(
        self, fact: ContainerFact, me: ContainerFact | None, path: str, digest: bool
    ) -> FileFact | None:
        roots = self._roots(fact, me)
        fresh: list[str] = []

        def passing(directory: int, name: str) -> None:
            if self._watch(f"/proc/self/fd/{directory}", name):
                fresh.append(name)

        mounts = {mount.destination: roots.get(mount.destination) for mount in fact.mounts}
        number = resolve(path, mounts, passing)
        if fresh:
            self._changed()  # it may have changed between the inspection and the start of the watch
        if number is None:
            return None
        try:
            info = os.fstat(number)
            sha256 = self._sum_of_file(number, info, path) if digest and stat.S_ISREG(info.st_mode) else ""
        finally:
            os.close(number)
        return _file_fact(path, info.st_mode, info.st_size, sha256, "volume")

    def _roots(self, fact: ContainerFact, me: ContainerFact | None) -> dict[str, SeenAt]:
        """Where PHM sees the mounts of a container, by destination in the container."""
        mounts = [mount for mount in fact.mounts if mount.kind in ("bind", "volume") and mount.source]
        seen: dict[str, SeenAt | None]
        if me is not None:
            seen = {mount.destination: _my_view(mount, me.mounts) for mount in mounts}
        else:
            here = self._same_host
            seen = {mount.destination: SeenAt(mount.source) if here and not mount.subpath else None for mount in mounts}
        return {destination: here for destination, here in seen.items() if here}

    def _sum_of_file(self, number: int, info: os.stat_result, path: str) -> str:
        """SHA-256 of an open path. Raises Outside if PHM may not read it: the engine may."""
        key, lasts = stamp(info), settled(info)
        known = self._known(key)
        if info.st_size > MAX_BYTES or known == _TOO_LARGE:
            raise _too_large(path, info.st_size)
        if known:
            return known
        until = self._clock.mono() + DIGEST_S
        total, size = hashlib.sha256(), 0
        try:
            # The path was opened without read permission; /proc leads to the same file.
            with open(f"/proc/self/fd/{number}", "rb", buffering=0) as content:
                while piece := content.read(_PIECE):
                    total.update(piece)
                    size += len(piece)
                    if size > MAX_BYTES or self._clock.mono() > until:
                        self._keep(key, _TOO_LARGE)
                        raise _too_large(path, size)
                now = os.fstat(content.fileno())
        except OSError as error:
            raise OutsideVolumes(f"{path}: {error}") from error
        if key != stamp(now):
            raise CannotTell(f"{path} changed while it was read")
        return self._keep(key, total.hexdigest()) if lasts else total.hexdigest()

    # ------------------------------------------------------------ engine

    def _through_engine(self, fact: ContainerFact, path: str, digest: bool) -> FileFact | None:
        budget = TimeBudget(self._clock, self._engine.timeout_s)
        found = self._follow(fact, path, budget)
        if found is None:
            return None
        real, status = found
        mode = _posix_mode(int(status.get("mode", 0)))
        size = int(status.get("size", 0))
        wanted = digest and stat.S_ISREG(mode)
        if wanted and size > MAX_BYTES:
            raise _too_large(path, size)
        sha256 = self._sum_by_engine(fact, real, (size, str(status.get("mtime", "")))) if wanted else ""
        return _file_fact(path, mode, size, sha256, "engine")

    def _follow(self, fact: ContainerFact, path: str, budget: TimeBudget) -> tuple[str, dict[str, Any]] | None:
        """The path after all links, and the engine's information about it."""
        real = path
        for _ in range(MAX_LINKS):
            try:
                status = self._engine.stat_path(fact.id, real, deadline_s=budget.left_s())
            except EngineMissing:
                self._must_be_visible(fact, real)
                return None
            if not int(status.get("mode", 0)) & _GO_LINK:
                return real, status
            target = str(status.get("linkTarget", ""))
            if not target:
                return None
            real = join(os.path.dirname(real), target)
        return None

    def _must_be_visible(self, fact: ContainerFact, path: str) -> None:
        """Raises CannotTell if the engine's `not found` is not conclusive."""
        hidden = [mount.destination for mount in fact.mounts if mount.kind == "tmpfs"]
        for root in (*hidden, *_NOT_SEEN_BY_ENGINE):
            if path == root or path.startswith(root.rstrip("/") + "/"):
                raise CannotTell(
                    f"{path} is in memory ({root}), which the Docker Engine cannot read: move it to a volume"
                )
        if self._docker_gone(fact):
            raise CannotTell(f"{fact.name} was removed while PHM looked for {path}")

    def _docker_gone(self, fact: ContainerFact) -> bool:
        try:
            self._engine.inspect(fact.id)
        except EngineMissing:
            return True
        return False

    def _sum_by_engine(self, fact: ContainerFact, path: str, version: tuple[int, str]) -> str:
        key = (fact.generation, path, *version)
        known = self._known(key)
        if known:
            return known
        total = hashlib.sha256()
        self._engine.copy_file(fact.id, path, total.update, limit=MAX_BYTES, deadline_s=DIGEST_S)
        return self._keep(key, total.hexdigest())

    # ------------------------------------------------------------ sums

    def _known(self, key: Hashable) -> str:
        with self._lock:
            if key in self._sums:
                self._sums.move_to_end(key)
            return self._sums.get(key, "")

    def _keep(self, key: Hashable, sha256: str) -> str:
        with self._lock:
            self._sums[key] = sha256
            while len(self._sums) > _SUMS:
                self._sums.popitem(last=False)
        return sha256


def _too_large(path: str, size: int) -> CannotTell:
    return CannotTell(f"{path} is too large to be read: {size >> 20} MiB or more")


def _mounts_below(path: str, mounts: Mapping[str, SeenAt | None], opened: ExitStack) -> dict[str, int | None]:
    """What is mounted in the folder `path`: by relative path, its descriptor in `opened`, or None if PHM does not see it."""
    top = real_path(path, mounts).rstrip("/") + "/"
    below: dict[str, int | None] = {}
    for destination, seen in mounts.items():
        # Docker follows links on the way when it mounts.
        place = real_path(destination, {other: at for other, at in mounts.items() if other != destination})
        if not place.startswith(top):
            continue
        try:
            number = resolve(destination, {destination: seen})
        except OutsideVolumes:
            number = None
        if number is not None:
            opened.callback(os.close, number)
        below[place.removeprefix(top)] = number
    return below


def _my_view(mount: Mount, mine: tuple[Mount, ...]) -> SeenAt | None:
    """Where PHM's own container sees what `mount` shows to another one, or None.

    A subpath is not followed within a volume that PHM sees as a whole: the application could replace it by a link.
    """
    for own in mine:
        if mount.kind == "volume" == own.kind and mount.name and (mount.name, mount.subpath) == (own.name, own.subpath):
            return SeenAt(own.destination)
    if mount.subpath:
        return None
    whole = [own for own in mine if own.source and not own.subpath]
    covering = [own for own in whole if os.path.commonpath((own.source, mount.source)) == own.source]
    if not covering:
        return None
    nearest = max(covering, key=lambda own: len(own.source))
    rest = os.path.relpath(mount.source, nearest.source)
    return SeenAt(nearest.destination, "" if rest == "." else rest)


def _posix_mode(go_mode: int) -> int:
    """Convert Go's os.FileMode to st_mode."""
    kind = stat.S_IFDIR if go_mode & _GO_DIRECTORY else 0 if go_mode & _GO_OTHER else stat.S_IFREG
    special = sum(bit for go_bit, bit in _GO_SPECIAL if go_mode & go_bit)
    return kind | special | (go_mode & 0o777)


def _file_fact(path: str, mode: int, size: int, sha256: str, seen_through: str) -> FileFact:
    kind = "file" if stat.S_ISREG(mode) else "directory" if stat.S_ISDIR(mode) else "other"
    return FileFact(path, kind, size, stat.S_IMODE(mode), bool(mode & 0o111), sha256, seen_through)
