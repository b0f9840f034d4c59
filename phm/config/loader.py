"""Reads a file and the environment into `Settings`, or raises every problem in them.

Opens nothing but the file, and the definitions of installed message types that `ros.topics[].data` names fields of.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Collection, Mapping
from pathlib import Path as FilePath
from typing import Any

from pydantic import ValidationError

from phm.config import rules
from phm.config.env_expansion import Expander
from phm.config.error_messages import of_alternatives, sentence
from phm.config.node import ConfigNode
from phm.config.problems import ConfigError, Path, Problem, dotted
from phm.config.schema_lookup import without_alternatives, without_types
from phm.config.yaml_tree import MAX_BYTES, Tree, parse
from phm.core.settings import Settings

INSTALLED = FilePath("/etc/phm/phm.yaml")
DELIVERED = "/etc/phm-delivered"
"""Where the Compose files mount a folder for delivered configurations."""
IN_REPOSITORY = FilePath("config/phm.yaml")
INTERVAL_VARIABLE = "PHM_INTERVAL"
NO_CONFIGURATION = (
    f"file not found, nor {INSTALLED}: `phm init` writes a configuration for this machine; --config names another file"
)


def find(path: str | os.PathLike[str] | None = None) -> FilePath:
    """The file to read: `path`, else /etc/phm/phm.yaml when it is there, else config/phm.yaml."""
    if path is not None:
        return FilePath(path)
    try:
        INSTALLED.stat()
    except (FileNotFoundError, NotADirectoryError):
        return IN_REPOSITORY
    except OSError:
        pass  # exists but is not readable: report that instead of silently using another file
    return INSTALLED


UnitsOf = Callable[[Settings], tuple[Collection[str], Mapping[str, Collection[str]]]]
"""The ids of all units of valid settings, and by check the names of the checks that it needs by itself. Raises `ConfigError`."""


def load(
    path: str | os.PathLike[str] | None = None,
    *,
    environ: Mapping[str, str] | None = None,
    known_checks: Collection[str] | None = None,
    known_actions: Collection[str] | None = None,
    units_of: UnitsOf | None = None,
) -> Settings:
    """Read and validate one file. Raises `ConfigError` with all problems.

    environ:      for `${VAR}` and PHM_INTERVAL; default: that of the process.
    known_checks: names of the installed checks; None: names of checks are not validated. Likewise the actions of
                  `recovery.ladders`.
    units_of:     called once everything else is valid; with it, `needs` must name existing units and form no cycle with
                  built-in needs.
    """
    file = find(path)
    return loads(
        read_file(file),
        str(file),
        environ=os.environ if environ is None else environ,
        known_checks=known_checks,
        known_actions=known_actions,
        units_of=units_of,
    )


def loads(
    text: str,
    file: str = "phm.yaml",
    *,
    environ: Mapping[str, str],
    known_checks: Collection[str] | None = None,
    known_actions: Collection[str] | None = None,
    units_of: UnitsOf | None = None,
) -> Settings:
    """As `load`, from the text of a file called `file`."""
    tree = parse(text, file, Expander(environ))
    problems = list(tree.problems)
    interval, bad_interval = _interval(environ)
    problems += bad_interval
    if tree.broken:
        raise ConfigError(problems)
    _locate_manifests(tree.data, os.path.dirname(os.path.abspath(file)))
    settings, wrong = _validate(tree, file)
    problems += wrong
    root = ConfigNode(tree, file, problems, value=tree.data)
    rules.check_all(root)
    if known_checks is not None:
        rules.names_of_checks(root, known_checks, None)
    rules.names_of_recovery(root, known_actions)
    rules.needs_have_no_loop(root, {})
    if problems or settings is None:
        raise ConfigError(problems)
    if interval is not None:
        settings = settings.model_copy(update={"interval": interval})
    if units_of is not None:
        units, needs = units_of(settings)
        rules.names_of_checks(root, known_checks or (), units)
        rules.custom_needs_are_units(root, units)
        rules.needs_have_no_loop(root, {name: set(names) for name, names in needs.items()})
        if problems:
            raise ConfigError(problems)
    return settings


def _validate(tree: Tree, file: str) -> tuple[Settings | None, list[Problem]]:
    """Strict: `yes` is not a boolean and `"3"` not a number, so that no value is converted silently."""
    try:
        return Settings.model_validate(tree.data, strict=True), []
    except ValidationError as error:
        found: list[Any] = list(error.errors(include_url=False))
    problems = []
    alternatives: dict[Path, list[Any]] = {}
    for entry in found:
        # Pydantic marks a problem of a mapping's key.
        whole = tuple(part for part in entry["loc"] if part != "[key]")
        value = without_alternatives(whole)
        path = without_types(value)
        if str(entry["type"]).startswith("union_tag_"):
            path = (*path, "type")
        if any(path[:end] in tree.bad for end in range(1, len(path) + 1)):
            continue  # its cause is already reported
        if value != whole:
            alternatives.setdefault(path, []).append(entry)
        else:
            problems.append(Problem(file, tree.line(path), dotted(path), sentence(entry)))
    for path, entries in alternatives.items():
        problems.append(Problem(file, tree.line(path), dotted(path), of_alternatives(entries)))
    return None, problems


def _locate_manifests(data: Any, folder: str) -> None:
    """Make relative paths of manifests absolute: `phm learn` writes them beside the configuration, which may be mounted anywhere."""
    containers = data.get("containers") if isinstance(data, dict) else None
    for container in containers if isinstance(containers, list) else ():
        files = container.get("files") if isinstance(container, dict) else None
        for file in files if isinstance(files, list) else ():
            manifest = file.get("manifest") if isinstance(file, dict) else None
            if isinstance(manifest, str) and manifest.strip():
                file["manifest"] = os.path.join(folder, manifest.strip())


def _interval(environ: Mapping[str, str]) -> tuple[float | None, list[Problem]]:
    """PHM_INTERVAL in seconds; None when it is not set or blank, as Compose files like to leave it."""
    text = environ.get(INTERVAL_VARIABLE, "").strip()
    if not text:
        return None, []
    try:
        return Settings.model_validate({"interval": text}, strict=True).interval, []
    except ValidationError as error:
        where = f"environment {INTERVAL_VARIABLE}"
        return None, [Problem(where, 0, "interval", sentence(dict(entry))) for entry in error.errors(include_url=False)]


# Windows lacks the first two, and changes line ends without the third.
_READING = os.O_RDONLY | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def read_file(path: FilePath) -> str:
    """The file's text. Raises `ConfigError`; never blocks, whatever kind of file it is."""
    try:
        handle = os.open(path, _READING)
    except (OSError, ValueError) as error:
        if path == IN_REPOSITORY and isinstance(error, FileNotFoundError):
            raise _refused(path, NO_CONFIGURATION) from error
        raise _refused(path, _why(error)) from error
    try:
        mode = os.fstat(handle).st_mode
        if stat.S_ISDIR(mode):
            raise _refused(path, "is a directory: name the file in it")
        if not stat.S_ISREG(mode):
            raise _refused(path, "is not a regular file: name a file")
        with os.fdopen(handle, "rb", closefd=False) as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise _refused(path, _why(error)) from error
    finally:
        os.close(handle)
    if len(raw) > MAX_BYTES:
        raise _refused(
            path, f"is larger than {MAX_BYTES // 1024} KiB, which no configuration needs: is it the right file?"
        )
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError([Problem(str(path), line, "", "is not UTF-8: save it as UTF-8")]) from error


def _why(error: OSError | ValueError) -> str:
    number = error.errno if isinstance(error, OSError) else None
    if number in (errno.ENOENT, errno.ENOTDIR):
        return "file not found: correct the name; `phm init` writes a configuration for this machine"
    if number in (errno.EACCES, errno.EPERM):
        user = f" for user {os.getuid()}" if hasattr(os, "getuid") else ""
        return f"permission denied{user}: change its permissions"
    reason = os.strerror(number) if number is not None else str(error)
    return f"cannot be read: {reason}"


def _refused(path: FilePath, message: str) -> ConfigError:
    return ConfigError([Problem(str(path), 0, "", message)])
