"""Edits of a configuration by place, as a form makes them: text in, text out, with comments kept.

The values of a form are those of the file before variables are replaced: `${PHM_AGENT}` stays unchanged.
"""

from __future__ import annotations

import copy
import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from phm.config import yaml_text
from phm.config.env_expansion import Expander
from phm.config.problems import Path, Problem, dotted
from phm.config.yaml_render import Unquoted, entry, item
from phm.config.yaml_tree import MAX_BYTES, MAX_DEPTH, parse

MAX_EDITS = 20
MAX_TEXT = 10_000
MAX_COMPARED = 5000
"""Lines of a text that is compared: the time grows with their square."""
DO = ("set", "add", "remove")


class EditError(Exception):
    """An edit is not possible; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Edit:
    """do: `set` a value, `add` an entry to a list, or `remove` a value. Sections on the way are created."""

    do: str
    path: Path
    value: Any = None

    @classmethod
    def from_json(cls, data: Any) -> Edit:
        """`{"do", "path", "value"}`; `{"$unquoted": TEXT}` is a text with a variable for a number. Raises EditError."""
        if not isinstance(data, Mapping) or data.get("do") not in DO:
            raise EditError(f"an edit needs 'do': {', '.join(DO)}")
        path = data.get("path")
        if not isinstance(path, list) or not 0 < len(path) <= MAX_DEPTH or not all(map(_is_step, path)):
            raise EditError(f"an edit needs 'path': a list of 1 to {MAX_DEPTH} keys and indexes")
        return cls(data["do"], tuple(path), _value(data.get("value"), MAX_DEPTH))


class _AsWritten(Expander):
    """Returns the text with its variables unchanged."""

    def __init__(self) -> None:
        super().__init__({})

    def expand(self, text: str) -> str:
        return text


def values(text: str, file: str = "phm.yaml") -> tuple[dict[str, Any], list[Problem]]:
    """The values as written, JSON-able, and what is wrong with the YAML. Empty when it cannot be read at all."""
    if not text.strip():
        return {}, []
    tree = parse(text, file, _AsWritten())
    usable = not tree.broken and isinstance(tree.data, dict)
    return (_finite(tree.data) if usable else {}), tree.problems


def apply(text: str, edits: Iterable[Edit]) -> str:
    """The text with the edits. Raises EditError."""
    ends = "\r\n" if "\r\n" in text else "\n"
    text = text.replace("\r\n", "\n")
    for edit in edits:
        text = _apply(text, edit)
        if len(text.encode("utf-8", "replace")) > MAX_BYTES:
            raise EditError(f"the configuration would be larger than {MAX_BYTES // 1024} KiB")
    return text.replace("\n", ends)


def diff(old: str, new: str, name: str) -> str:
    """A unified diff; empty when nothing changed."""
    before, after = (text.replace("\r\n", "\n").splitlines() for text in (old, new))
    if max(len(before), len(after)) > MAX_COMPARED:
        return f"--- {name}\n+++ {name}\n@@ more than {MAX_COMPARED} lines: not compared @@"
    return "\n".join(difflib.unified_diff(before, after, name, f"{name} (changed)", lineterm=""))


def _apply(text: str, edit: Edit) -> str:
    present, problems = values(text)
    if problems:
        raise EditError(f"the YAML must be correct first: line {problems[0].line}: {problems[0].message}")
    wanted = _plain(copy.deepcopy(present), edit)
    try:
        made = _rewrite(text, edit, wanted)
        after, problems = values(made)
    except (yaml_text.NotPossible, yaml.YAMLError, ValueError, IndexError) as error:
        raise _not_here(edit) from error
    if problems or after != _finite(_resolved(wanted)):
        raise _not_here(edit)
    return made


def _not_here(edit: Edit) -> EditError:
    return EditError(f"{dotted(edit.path)}: is written in a style that the form cannot change: change it in the YAML")


def _plain(data: dict[str, Any], edit: Edit) -> dict[str, Any]:
    """The edit in plain values. Raises EditError."""
    if edit.do == "add":
        current = _get(data, edit.path)
        if current is not None and not isinstance(current, list):
            raise EditError(f"{dotted(edit.path)}: is not a list")
        edit = Edit("set", edit.path, [*(current or []), edit.value])
    holder: Any = data
    for part in edit.path[:-1]:
        if isinstance(part, str) and isinstance(holder, dict) and holder.get(part) is None and edit.do == "set":
            holder[part] = {}
        holder = _step(holder, part, edit)
    last = edit.path[-1]
    if edit.do == "set" and isinstance(holder, dict) and isinstance(last, str):
        holder[last] = edit.value
        return data
    _step(holder, last, edit)
    if edit.do == "remove":
        del holder[last]
    else:
        holder[last] = edit.value
    return data


def _step(holder: Any, part: str | int, edit: Edit) -> Any:
    if isinstance(holder, dict) and isinstance(part, str) and part in holder:
        return holder[part]
    if isinstance(holder, list) and isinstance(part, int) and 0 <= part < len(holder):
        return holder[part]
    raise EditError(f"{dotted(edit.path)}: is not in the configuration (was it changed meanwhile?)")


def _get(data: Any, path: Path) -> Any:
    for part in path:
        if isinstance(data, dict) and isinstance(part, str):
            data = data.get(part)
        elif isinstance(data, list) and isinstance(part, int) and 0 <= part < len(data):
            data = data[part]
        else:
            return None
    return data


def _rewrite(text: str, edit: Edit, wanted: dict[str, Any]) -> str:
    path = edit.path
    place = yaml_text.place_of(text, path)
    if place is None:
        return _new(text, path, wanted)
    if edit.do == "set":
        return yaml_text.replace(text, place, edit.value)
    if edit.do == "add":
        if yaml_text.is_block(place.node) and isinstance(place.node, yaml.SequenceNode):
            return yaml_text.add_item(text, place.node, edit.value)
        return _whole(text, path, wanted)
    if place.parent is not None and yaml_text.is_block(place.parent) and len(place.parent.value) > 1:
        return yaml_text.remove(text, place)
    if len(path) == 1:
        raise yaml_text.NotPossible
    return _whole(text, path[:-1], wanted)


def _new(text: str, path: Path, wanted: dict[str, Any]) -> str:
    """A key that the text does not have, below the last section that it has."""
    for end in range(len(path) - 1, -1, -1):
        place, key = yaml_text.place_of(text, path[:end]), path[end]
        if place is None or not isinstance(key, str):
            continue
        value = _get(wanted, path[: end + 1])
        if isinstance(place.node, yaml.MappingNode) and yaml_text.is_block(place.node):
            return yaml_text.add_key(text, place.node, key, value)
        return _whole(text, path[:end], wanted)
    lines = [line for key, value in wanted.items() for line in entry(key, value, 0, 2)]
    return (text.rstrip("\n") + "\n" if text.strip() else "") + "\n".join(lines) + "\n"


def _whole(text: str, path: Path, wanted: dict[str, Any]) -> str:
    """Write a collection again: one in brackets, an empty one, or one that becomes empty."""
    place = yaml_text.place_of(text, path)
    value = _get(wanted, path)
    if place is None or place.parent is None:
        raise yaml_text.NotPossible
    if place.key is None and not yaml_text.is_block(place.parent):
        return _whole(text, path[:-1], wanted)  # in brackets within brackets
    if place.key is None and isinstance(value, dict) and value:
        return _entry_again(text, place, value)
    return yaml_text.replace(text, place, value)


def _entry_again(text: str, place: yaml_text.Place, value: dict[str, Any]) -> str:
    """An entry of a block list that was `{}` or in braces, as lines."""
    start, end = place.node.start_mark, place.node.end_mark
    made = "\n".join(item(value, start.column - 2, 2)).lstrip(" ")[2:]
    return text[: start.index] + made + text[end.index :]


def _is_step(part: Any) -> bool:
    return (isinstance(part, str) and len(part) <= MAX_TEXT) or (isinstance(part, int) and not isinstance(part, bool))


def _value(data: Any, depth: int) -> Any:
    """A value of JSON, limited. Raises EditError."""
    if depth == 0:
        raise EditError(f"a value is nested deeper than {MAX_DEPTH} levels")
    if isinstance(data, str) and len(data) > MAX_TEXT:
        raise EditError(f"a text has more than {MAX_TEXT} characters")
    if isinstance(data, float) and not math.isfinite(data):
        raise EditError("a number must be finite")
    if isinstance(data, list):
        return [_value(one, depth - 1) for one in data]
    if isinstance(data, dict):
        if set(data) == {"$unquoted"} and isinstance(data["$unquoted"], str):
            return Unquoted(data["$unquoted"][:MAX_TEXT])
        return {str(key): _value(one, depth - 1) for key, one in data.items()}
    return data


def _resolved(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _resolved(one) for key, one in data.items()}
    if isinstance(data, list):
        return [_resolved(one) for one in data]
    if isinstance(data, Unquoted):
        return data.value
    return data


def _finite(data: Any) -> Any:
    """Infinite numbers as text: JSON has none."""
    if isinstance(data, dict):
        return {key: _finite(one) for key, one in data.items()}
    if isinstance(data, list):
        return [_finite(one) for one in data]
    if isinstance(data, float) and not math.isfinite(data):
        return str(data)
    return data
