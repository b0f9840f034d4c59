"""Messages of MAVLink and their fields, read from the text of pymavlink's modules: nothing of them is imported or executed.

`phm validate` uses it. The classes that pymavlink generates contain names, types and lengths as literals. The dialect is
ArduPilot's, which contains the common one.
"""

from __future__ import annotations

import ast
import difflib
import functools
import importlib.util
import re
from collections.abc import Mapping
from pathlib import Path

MODULES = ("common.py", "ardupilotmega.py")
MAX_BYTES = 10_000_000
_NEAR = 3
_CLASS = re.compile(r'^    msgname = "(\w+)"$', re.MULTILINE)
_LITERALS = ("fieldnames", "fieldtypes", "ordered_fieldnames", "array_lengths")
"""Types are in the order of the first, lengths in the order of the third."""
_PATH = re.compile(r"(\w+?)(?:\[(\d+)\])?")


class UnknownMavlinkField(ValueError):
    """No such message or field; the text names similar ones."""


def demand_field(message: str, path: str, *, number: bool, instance: bool = False) -> None:
    """Raises UnknownMavlinkField unless the message has the field `name` or `name[0]`.

    number: it must be one, not a text. instance: the message must have a field that numbers its sources.
    """
    messages = _messages()
    if not messages:
        return  # pymavlink is not installed: then MAVLink does not work at all
    if message not in messages:
        raise UnknownMavlinkField(f"unknown message {message}{_similar(message, messages)}")
    fields = _fields(messages[message])
    match = _PATH.fullmatch(path)
    name, index = (match[1], match[2]) if match else (path, None)
    if name not in fields:
        raise UnknownMavlinkField(
            f"{message} has no field {name}{_similar(name, fields) or f': it has {_listed(fields)}'}"
        )
    kind, length = fields[name]
    if kind == "char":
        if number or index:
            raise UnknownMavlinkField(f"{name} of {message} is a text: only 'equals' with a text applies to it")
    elif index and not length:
        raise UnknownMavlinkField(f"{name} of {message} is not an array: remove the index")
    elif index and int(index) >= length:
        raise UnknownMavlinkField(f"{name} of {message} has {length} elements: the highest index is {length - 1}")
    elif length and not index:
        raise UnknownMavlinkField(
            f"{name} of {message} is an array: name one element, {name}[0] to {name}[{length - 1}]"
        )
    elif not number:
        raise UnknownMavlinkField(f"{name} of {message} is a number: compare it with a number")
    if instance and not re.search(r'^    instance_field = "', messages[message], re.MULTILINE):
        raise UnknownMavlinkField(f"{message} has no field that numbers its sources: remove 'instance'")


@functools.cache
def _messages() -> Mapping[str, str]:
    """The text of the class of each message, by name."""
    found: dict[str, str] = {}
    for module in MODULES:
        text = _text(module)
        matches = list(_CLASS.finditer(text))
        ends = [match.start() for match in matches[1:]] + [len(text)]
        for match, end in zip(matches, ends, strict=False):
            found.setdefault(match[1], text[match.start() : end].partition("    def __init__(")[0])
    return found


def _text(module: str) -> str:
    try:
        spec = importlib.util.find_spec("pymavlink")
        for folder in (spec.submodule_search_locations if spec else None) or ():
            path = Path(folder, "dialects", "v20", module)
            if path.stat().st_size <= MAX_BYTES:
                return path.read_text(encoding="utf-8")
    except (OSError, ImportError, ValueError):
        return ""
    return ""


def _fields(text: str) -> Mapping[str, tuple[str, int]]:
    """Type and length (0: not an array) of each field, by name."""
    values = []
    for key in _LITERALS:
        match = re.search(rf"^    {key} = (\[.*\])$", text, re.MULTILINE)
        values.append(ast.literal_eval(match[1]) if match else [])
    names, kinds, ordered, lengths = values
    length_of = dict(zip(ordered, lengths, strict=True))
    return {name: (kind, length_of[name]) for name, kind in zip(names, kinds, strict=True)}


def _similar(name: str, known: Mapping[str, object]) -> str:
    near = difflib.get_close_matches(name, known, _NEAR, 0.7)
    near += [other for other in known if name in other and other not in near][: _NEAR - len(near)]
    return f"; similar: {', '.join(near)}" if near else ""


def _listed(names: Mapping[str, object]) -> str:
    return ", ".join(list(names)[:15])
