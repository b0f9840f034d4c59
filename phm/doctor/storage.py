"""The folders that PHM writes to, and the configuration if operators may deliver another one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator

from phm.doctor.context import DoctorContext
from phm.doctor.row import Row, limited, missing, ok


def rows(context: DoctorContext) -> Iterator[Row]:
    settings = context.settings
    needed = 2 * settings.log.files * settings.log.max_size
    for name, path, least in (("log", settings.log.directory, needed), ("state", settings.state_dir, 1e6)):
        yield _folder(name, path, least, context)
    if settings.delivery.listen is not None and context.configuration:
        yield _replaceable(os.path.realpath(context.configuration))


def _folder(name: str, path: str, least_bytes: float, context: DoctorContext) -> Row:
    if not os.path.isdir(path):
        text = f"{path} does not exist"
        if context.configuration:
            return missing(name, text, "create it, or mount a volume there")
        return limited(name, text, "`phm init` sets up folders for a container; else create it")
    if not os.access(path, os.W_OK | os.X_OK):
        remedy = f"chown {os.geteuid()} {path}"
        if context.in_container:
            owner = f"{os.geteuid()}:{os.getegid()}"
            remedy = f"on the host: `sudo chown -R {owner}` the folder that the Compose file mounts at {path}"
        return missing(name, f"{path} cannot be written by uid {os.geteuid()}", remedy)
    free = shutil.disk_usage(path).free
    text = f"{path} is writable, {free / 1e6:.0f} MB free"
    if free < least_bytes:
        return limited(name, text, f"free {least_bytes / 1e6:.0f} MB, or lower log.max_size and log.files")
    return ok(name, text)


def _replaceable(path: str) -> Row:
    """Whether PHM can put a delivered configuration into the place of this file: it renames another one over it."""
    folder = os.path.dirname(path)
    remedy = (
        "in a container, lay docker/compose.deliver.yaml over docker/compose.yaml, or write the folder with `phm init --deliver`; "
        f"else make {folder} writable for uid {os.geteuid()}; or remove delivery.listen"
    )
    if os.path.ismount(path):
        return limited("delivery", f"{path} is mounted alone and cannot be replaced", remedy)
    if not os.access(folder, os.W_OK | os.X_OK):
        return limited("delivery", f"{folder} cannot be written by uid {os.geteuid()}: deliveries are refused", remedy)
    return ok("delivery", f"{path} can be replaced by a delivered configuration")
