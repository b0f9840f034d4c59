"""Restore a file in a container, from the container's own image or from a golden copy."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import posixpath
import stat

from phm.core.model import Fault
from phm.core.settings import FileSettings
from phm.facts import ContainerFact
from phm.recovery.actions._paths import open_plain
from phm.recovery.base import (
    Action,
    ActionContext,
    ActionFailed,
    ActionSettings,
    Impact,
    NotNeeded,
    Target,
    container_settings,
    present,
)
from phm.transport.docker import DockerEngine, EngineMissing, FileCopy

LIMIT = 16 << 20
"""Size of the largest file that is restored: it is held in memory, beside the archive that contains it."""
LABEL = "phm.restore"
"""Label, with the value 1, of the container created temporarily to read a file of an image."""
_GO_DIRECTORY, _GO_LINK = 1 << 31, 1 << 27
_GO_NOT_REGULAR = _GO_DIRECTORY | _GO_LINK | 1 << 26 | 1 << 25 | 1 << 24 | 1 << 21 | 1 << 19
"""Bits of Go's FileMode: folder, link, device, pipe, socket, character device, anything else."""


class RestoreFile(Action):
    """Restore every file of the container that has a `restore` and is missing, not executable or altered.

    A copy with another SHA-256 than the configured one is refused: a bad file is not replaced by another.
    """

    name = "restore_file"
    starts = False
    impact = Impact.NOTHING
    deadline_s = 90.0

    @classmethod
    def applies(cls, target: Target, fault: Fault, settings: ActionSettings) -> bool:
        """Whether the file at fault can be restored; if the check does not name it, whether any file can."""
        path = fault.result.evidence.file
        container = target.container
        if container is None:
            return False
        return any(file.restore and file.present and path in ("", file.path) for file in container.files)

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        done, problems = [], []
        for file in container_settings(target).files:
            if not file.restore or not file.present:
                continue
            try:
                if put_back(file, fact, context.engine):
                    done.append(f"{file.path} from {'its image' if file.restore == 'image' else file.restore}")
            except ActionFailed as error:
                problems.append(str(error))
        if problems:
            raise ActionFailed("; ".join([*problems, *(f"restored {words}" for words in done)]))
        if not done:
            return NotNeeded(f"the files of {target.key} are as configured")
        return f"restored in {target.key}: {', '.join(done)}"


def put_back(file: FileSettings, fact: ContainerFact, engine: DockerEngine) -> bool:
    """Restore one file; False if it is as expected. Raises ActionFailed and the engine's errors."""
    place = _place(engine, fact.id, file.path)
    if _as_configured(engine, fact.id, place, file):
        return False
    copy = _from_image(engine, fact, file.path) if file.restore == "image" else _golden(file.restore or "")
    if file.sha256 and hashlib.sha256(copy.data).hexdigest() != file.sha256.lower():
        raise ActionFailed(
            f"the copy of {file.path} from {file.restore} does not have the configured SHA-256 and is not used"
        )
    mode = copy.mode | 0o111 if file.executable else copy.mode
    engine.put_file(fact.id, place, copy.data, mode, copy.uid, copy.gid, base=_base(engine, fact.id, place))
    return True


def _place(engine: DockerEngine, container: str, path: str) -> str:
    """The target of a path in the container: the end of a symbolic link, otherwise the path itself."""
    path = posixpath.normpath(path)
    try:
        seen = engine.stat_path(container, path)
    except EngineMissing:
        return path
    return posixpath.normpath(str(seen["linkTarget"])) if int(seen["mode"]) & _GO_LINK else path


def _as_configured(engine: DockerEngine, container: str, path: str, file: FileSettings) -> bool:
    """Whether nothing needs to be done. Raises ActionFailed if it is not a regular file."""
    try:
        seen = engine.stat_path(container, path)
    except EngineMissing:
        return False
    if int(seen["mode"]) & _GO_NOT_REGULAR:
        raise ActionFailed(f"{path} is not a regular file now and is not replaced: remove it")
    if file.executable and not int(seen["mode"]) & 0o111:
        return False
    if file.sha256 is None:
        return True
    if int(seen["size"]) > LIMIT:
        return False
    digest = hashlib.sha256()
    engine.copy_file(container, path, digest.update, limit=LIMIT)
    return digest.hexdigest() == file.sha256.lower()


def _base(engine: DockerEngine, container: str, path: str) -> str:
    """The nearest existing folder above `path`: missing ones below it are created."""
    folder = posixpath.dirname(path)
    while folder != "/":
        try:
            if int(engine.stat_path(container, folder)["mode"]) & (_GO_DIRECTORY | _GO_LINK):
                return folder
            raise ActionFailed(f"{folder} is not a folder, so {path} cannot be restored")
        except EngineMissing:
            folder = posixpath.dirname(folder)
    return folder


def _from_image(engine: DockerEngine, fact: ContainerFact, path: str) -> FileCopy:
    """The file of the image, read from a container that is created for this and never started."""
    image = str(engine.inspect(fact.id).get("Image", ""))
    name = f"phm-restore-{fact.id[:12]}"
    with contextlib.suppress(EngineMissing):
        engine.remove(name)  # left by a PHM that was killed meanwhile; only one PHM recovers a container
    made = engine.create_from_image(image, {LABEL: "1"}, name)
    try:
        return engine.fetch_file(made, _place(engine, made, path), LIMIT)
    except EngineMissing as error:
        raise ActionFailed(f"{path} is not in the image of {fact.name}: give another `restore`") from error
    finally:
        with contextlib.suppress(EngineMissing):
            engine.remove(made)


def _golden(path: str) -> FileCopy:
    """The copy that PHM sees at `path`. Raises ActionFailed if it does not exist, is behind a link, not a regular file
    or too large."""
    try:
        # Without read permission at first: opening a device may have side effects.
        place = open_plain(path, os.O_PATH)
        try:
            seen = os.fstat(place)
            if not stat.S_ISREG(seen.st_mode):
                raise ActionFailed(f"the golden copy {path} is not a regular file")
            with open(f"/proc/self/fd/{place}", "rb") as file:
                data = file.read(LIMIT + 1)
        finally:
            os.close(place)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENOTDIR):
            raise ActionFailed(
                f"the golden copy {path} is reached through a link or is not a file: give its real path in `restore`"
            ) from error
        raise ActionFailed(f"the golden copy {path} cannot be read: {error.strerror or error}") from error
    if len(data) > LIMIT:
        raise ActionFailed(f"the golden copy {path} has more than the {LIMIT >> 20} MiB that PHM puts back")
    return FileCopy(data, stat.S_IMODE(seen.st_mode), seen.st_uid, seen.st_gid)
