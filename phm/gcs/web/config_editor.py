"""The Checks page without HTTP: reads, checks, edits and saves configurations of agents.

Variables of a configuration are the agent's, so none of this computer's environment is ever put into one: its values could be secrets.
"""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from phm.checking.plan import CheckPlan, unit_rows
from phm.config import ConfigError, Problem
from phm.config.atomic_write import replace
from phm.config.editor import MAX_EDITS, Edit, EditError, apply, diff, values
from phm.config.loader import read_file
from phm.config.schema import schema
from phm.config.yaml_tree import MAX_BYTES

MAX_VARIABLES, MAX_VARIABLE = 64, 4096
MAX_PROBLEMS = 200
NO_NAME = "agent.yaml"
TURN_S = 5.0

Json = dict[str, Any]
PlanOf = Callable[[str, str, Mapping[str, str]], CheckPlan]
"""The plan of a configuration by text, name of the file and variables. Raises ConfigError."""


class NotSaved(Exception):
    """The file was not written; the message says why and what to do."""


class ConfigEditor:
    """files: those of this computer that may be read and written; no other file is ever opened. Thread-safe."""

    def __init__(self, plan_of: PlanOf, files: Sequence[str] = ()) -> None:
        self._plan_of = plan_of
        # A link that is changed later does not lead to another file.
        self._files = {name: Path(name).resolve() for name in files}
        self._lock = threading.Lock()
        """Allows one check at a time, because a check keeps a core busy."""

    def files(self) -> list[str]:
        """The names of the files, as given on the command line."""
        return list(self._files)

    def schema(self) -> Json:
        """The JSON schema of phm.yaml."""
        return schema()

    def open(self, name: str) -> Json:
        """`name`, `text`, and `version` for `save`. Raises ConfigError, and KeyError for a file that is not one of them."""
        text = read_file(self._path(name))
        return {"name": name, "text": text, "version": _version(text)}

    def saved(self, name: str, version: str) -> str:
        """The text of a file whose content is still that of `version`. Raises NotSaved, and as `open`."""
        found = self.open(name)
        if found["version"] != version:
            raise NotSaved(f"{name} was changed by another program meanwhile: load it again")
        return str(found["text"])

    def check(self, body: Mapping[str, Any]) -> Json:
        """Apply `edits` to `text`, and say what it is then; `base` is the text to compare with.

        `text`, `values` as written, `problems` with `line`, `key` and `message`, `units` with `change`, `diff`, `refused` (why the edits
        were not applied). Raises ValueError for a body that is not as described.
        """
        text, base = _text(body, "text"), _text(body, "base")
        name = str(body.get("name") or NO_NAME)[:255]
        variables, edits = _variables(body.get("variables")), body.get("edits") or []
        if not isinstance(edits, list) or len(edits) > MAX_EDITS:
            raise ValueError(f"edits must be a list of at most {MAX_EDITS}")
        with self._turn():
            refused = ""
            try:
                text = apply(text, [Edit.from_json(edit) for edit in edits])
            except EditError as error:
                refused = str(error)
            raw, broken = values(text, name)
            units, problems = self._units(text, name, variables)
            before, _ = self._units(base, name, variables) if base != text else (units, ())
        return {
            "text": text,
            "values": raw,
            "usable": bool(raw) or not broken,
            "problems": [_problem(each) for each in problems[:MAX_PROBLEMS]],
            "units": _compared(before, units),
            "diff": diff(base, text, name),
            "refused": refused,
        }

    def save(self, name: str, text: str, version: str, variables: object, *, anyway: bool) -> Json:
        """Write one of the files, whose content must still be that of `version`; the new `version`.

        anyway: also with problems, e.g. because a check is installed on the agent only. Raises NotSaved; KeyError as
        `open`; ValueError as `check`.
        """
        path, text = self._path(name), _text({"text": text}, "text")
        _, broken = values(text, name)
        _, problems = self._units(text, name, _variables(variables))
        if broken or not text.strip():
            raise NotSaved("the YAML is not correct: correct it first")
        if problems and not anyway:
            raise NotSaved(f"the configuration has problems, the first: {problems[0]}")
        with self._turn():
            try:
                present = read_file(path)
            except ConfigError as error:
                raise NotSaved(str(error)) from None
            if _version(present) != version:
                raise NotSaved(f"{name} was changed by another program meanwhile: load it again, and repeat the change")
            if "\r\n" in present:
                text = text.replace("\r\n", "\n").replace("\n", "\r\n")
            try:
                replace(path, text.encode("utf-8"))
            except OSError as error:
                raise NotSaved(f"{name} cannot be written: {error.strerror or error}") from None
        return {"name": name, "text": text, "version": _version(text)}

    def _path(self, name: str) -> Path:
        """Raises KeyError, also if its place has been taken by a link to another file."""
        path = self._files[name]
        if os.path.realpath(path) != str(path):
            raise KeyError(name)
        return path

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """Raises ValueError when the ones before take too long."""
        if not self._lock.acquire(timeout=TURN_S):
            raise ValueError("other configurations are being checked: try again")
        try:
            yield
        finally:
            self._lock.release()

    def _units(self, text: str, name: str, variables: Mapping[str, str]) -> tuple[list[Json], Sequence[Problem]]:
        if not text.strip():
            return [], ()
        try:
            return unit_rows(self._plan_of(text, name, variables)), ()
        except ConfigError as error:
            return [], error.problems


def _version(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def _text(body: Mapping[str, Any], key: str) -> str:
    text = body.get(key, "")
    if not isinstance(text, str):
        raise ValueError(f"{key} must be text")
    try:
        size = len(text.encode("utf-8"))
    except UnicodeEncodeError:
        raise ValueError(f"{key} is not valid Unicode") from None
    if size > MAX_BYTES:
        raise ValueError(f"{key} is larger than {MAX_BYTES // 1024} KiB")
    return text


def _variables(data: object) -> dict[str, str]:
    data = {} if data is None else data
    if not isinstance(data, dict) or len(data) > MAX_VARIABLES:
        raise ValueError(f"variables must be an object of at most {MAX_VARIABLES}")
    if not all(isinstance(value, str) and len(key) + len(value) <= MAX_VARIABLE for key, value in data.items()):
        raise ValueError(f"a variable must be text of at most {MAX_VARIABLE} characters")
    return data


def _problem(problem: Problem) -> Json:
    return {"line": problem.line, "key": problem.key, "message": problem.message, "text": str(problem)}


def _compared(before: Sequence[Json], after: Sequence[Json]) -> list[Json]:
    """The units with `change`: new, gone (only in `before`), changed (in itself: what it blocks follows from others), or nothing."""

    def change(row: Json) -> str:
        known = old.get(row["unit"])
        return "new" if known is None else "changed" if {**known, "blocks": 0} != {**row, "blocks": 0} else ""

    old = {row["unit"]: row for row in before}
    rows = [{**row, "change": change(row)} for row in after]
    here = {row["unit"] for row in after}
    gone = [{**row, "change": "gone"} for row in before if row["unit"] not in here] if after else []
    return rows + gone
