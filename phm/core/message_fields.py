"""Fields of installed ROS message types, read from the text of their Python modules: no code of a package is executed.

`phm validate` uses it, in a process without ROS. The classes that rosidl generates contain their fields as a literal.
"""

from __future__ import annotations

import ast
import importlib.util
import re
from collections.abc import Callable, Mapping
from pathlib import Path

HEADER, TIME = "std_msgs/Header", "builtin_interfaces/Time"
STAMPS = frozenset({"stamp", "timestamp", "timestamp_sample"})
"""Names of stamps. Those of PX4's messages are numbers; a time with another name, e.g. `time_ref`, is content."""
INTEGER_BITS: Mapping[str, int] = {f"{sign}int{bits}": bits for sign in ("", "u") for bits in (8, 16, 32, 64)}
NUMBERS = frozenset({*INTEGER_BITS, "float", "double", "boolean"})
COUNTERS = frozenset({*INTEGER_BITS, "float", "double"})
MAX_BYTES = 1_000_000
"""Longest module that is read; those of common types have about 10 kB."""
_LISTED = 12

FieldsOf = Callable[[str], Mapping[str, str] | None]
"""The fields of `package/msg/Type` with their types, in order, as rosidl writes them; None: unknown."""

_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(?:msg/)?([A-Z][A-Za-z0-9]*)")
_LITERAL = re.compile(r"^    _fields_and_field_types = (\{.*?^    \})", re.DOTALL | re.MULTILINE)
_ARRAY = re.compile(r"(?:sequence<(.+?)(?:, \d+)?>|(.+)\[(\d+)\])")
_WORD_START = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


class UnknownField(ValueError):
    """A message type has no such field, or one of the wrong type; the text says what it has."""


def fields_of(type_name: str) -> Mapping[str, str] | None:
    """Implements `FieldsOf` for types installed beside PHM."""
    match = _TYPE.fullmatch(type_name)
    if match is None:
        return None
    package, short = match.groups()
    try:
        spec = importlib.util.find_spec(package)
        folders = (spec.submodule_search_locations if spec else None) or ()
        for folder in folders:
            module = Path(folder, "msg", f"_{_WORD_START.sub('_', short).lower()}.py")
            if module.is_file() and module.stat().st_size <= MAX_BYTES:
                return _fields(module.read_text(encoding="utf-8"))
    except (OSError, ImportError, ValueError, SyntaxError):
        return None
    return None


def has_header(type_name: str, of: FieldsOf = fields_of) -> bool | None:
    """Whether the type begins with std_msgs/Header; None: unknown."""
    fields = of(type_name)
    return None if fields is None else next(iter(fields.values()), "") == HEADER


def stamps(fields: Mapping[str, str], *, top: bool) -> frozenset[str]:
    """Names of the fields that only say when. top: of the message itself, where also a time that comes first is one, and numbers."""
    return frozenset(
        name
        for place, (name, kind) in enumerate(fields.items())
        if (kind == TIME and (name in STAMPS or (top and place == 0))) or (top and name in STAMPS and kind in COUNTERS)
    )


def has_other_stamps(type_name: str, of: FieldsOf = fields_of) -> bool | None:
    """Whether the type has stamps elsewhere than in a std_msgs/Header that it begins with; None: unknown. A header itself is nothing
    but a stamp, with a name that never changes."""
    fields = of(type_name)
    if fields is None:
        return None
    if type_name.replace("/msg/", "/") == HEADER:
        return False
    found, seen, inside = bool(stamps(fields, top=True)), set(), list(fields.values())
    if inside[:1] == [HEADER]:
        del inside[0]
    while inside and not found:
        kind = _inner(inside.pop())
        if "/" in kind and kind not in seen:
            seen.add(kind)
            fields = of(kind) or {}
            found = bool(stamps(fields, top=False))
            inside += fields.values()
    return found


def field_type(type_name: str, name: str, of: FieldsOf = fields_of) -> str | None:
    """Type of the field `a.b.c` or `a[0].b`; None if a type on the way is not installed. Raises UnknownField."""
    current = type_name
    for step in name.split("."):
        part, bracket, index = step.partition("[")
        if _ARRAY.fullmatch(current):
            raise UnknownField(
                f"{part!r} is a field of the elements of an array: only arrays of numbers can be examined"
            )
        fields = of(current)
        if fields is None:
            if "/" not in current:
                raise UnknownField(f"has no field {part!r}: it is of type {current}")
            return None
        if part not in fields:
            more = f" and {len(fields) - _LISTED} more" if len(fields) > _LISTED else ""
            raise UnknownField(f"{current} has no field {part!r}; it has {', '.join(list(fields)[:_LISTED])}{more}")
        current = fields[part]
        if bracket:
            current = _element(part, current, int(index.rstrip("]")))
    return current


def _element(name: str, array_type: str, index: int) -> str:
    """The type of the elements of an array. Raises UnknownField if it is none, or is too short."""
    array = _ARRAY.fullmatch(array_type)
    if array is None:
        raise UnknownField(f"{name} is of type {array_type}, not an array: remove the index")
    if array[3] and index >= int(array[3]):
        raise UnknownField(f"{name} has {array[3]} elements: the highest index is {int(array[3]) - 1}")
    return array[1] or array[2]


def _inner(kind: str) -> str:
    """The type of the elements of an array; another type is returned unchanged."""
    array = _ARRAY.fullmatch(kind)
    return array[1] or array[2] if array else kind


def demand_value(type_name: str, name: str, of: FieldsOf = fields_of, *, number: bool = False) -> None:
    """Raises UnknownField if the field is known not to be a number, an array of numbers or, unless `number`, a text."""
    found = field_type(type_name, name, of)
    if found is None or (not number and re.fullmatch(r"w?string(<\d+>)?", found)):
        return
    if _inner(found) not in NUMBERS:
        wanted = "a number" if number else "a number or a text"
        raise UnknownField(f"{name} of {type_name} is of type {found}, not {wanted}")


def demand_counter(type_name: str, name: str, of: FieldsOf = fields_of) -> int | None:
    """Bits of an integer counter; None for a floating-point number, or if unknown. Raises UnknownField."""
    found = field_type(type_name, name, of)
    if found is not None and found not in COUNTERS:
        raise UnknownField(f"{name} of {type_name} is of type {found}, not an integer")
    return INTEGER_BITS.get(found or "")


def _fields(module: str) -> Mapping[str, str] | None:
    match = _LITERAL.search(module)
    found = ast.literal_eval(match[1]) if match else None
    if isinstance(found, dict) and all(isinstance(text, str) for pair in found.items() for text in pair):
        return found
    return None
