"""Encodes facts as flat JSON lists for the pipe between daemon and child, and decodes them with type checks.

A fact is the list of its fields in order, so a new field in `phm.facts.ros` needs no change here. Both sides are the
same PHM: the layout is not a public contract. The decoder of a type is created once and cached: doing it for each value
took a third of the child's Python time.
"""

from __future__ import annotations

import functools
import math
import types
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

T = TypeVar("T")

Read = Callable[[Any], Any]
_PLAIN = frozenset({str, int, bool, type(None)})


def pack(fact: Any) -> Any:
    """JSON-able form of a fact: dataclasses and tuples as lists, mappings as objects, and None for a number that is not finite:
    the reader would refuse it, and with it the entire message."""
    kind: Any = type(fact)
    return fact if kind in _PLAIN else _packer(kind)(fact)


@functools.cache
def _packer(kind: Any) -> Callable[[Any], Any]:
    """The function that encodes values of this type."""
    if issubclass(kind, float):
        return lambda number: number if math.isfinite(number) else None
    if is_dataclass(kind):
        parts = _parts(cast(Any, kind))
        return lambda fact: [pack(item) for item in parts(fact)]
    if issubclass(kind, (list, tuple)):
        return lambda items: [pack(item) for item in items]
    if issubclass(kind, Mapping):
        return lambda entries: {key: pack(item) for key, item in entries.items()}
    return lambda other: other


def value(hint: Any, data: Any) -> Any:
    """Decode `data`, written by `pack`, as the type `hint`. Raises TypeError or ValueError for anything else."""
    return _reader(hint)(data)


@functools.cache
def changer(kind: Callable[..., T], name: str) -> Callable[[T, Any], T]:
    """A function that copies a fact of this type with another value of one field: dataclasses.replace in half the time."""
    place = [field.name for field in fields(cast(Any, kind))].index(name)

    def change(fact: T, item: Any) -> T:
        parts = list(_parts(kind)(fact))
        parts[place] = item
        return kind(*parts)

    return change


@functools.cache
def _parts(kind: Any) -> Callable[[Any], tuple[Any, ...]]:
    names = [field.name for field in fields(kind)]
    # attrgetter of one name gives no tuple.
    return attrgetter(*names) if len(names) > 1 else lambda fact: tuple(getattr(fact, name) for name in names)


@functools.cache
def _reader(hint: Any) -> Read:
    """The function that decodes a value of this type."""
    if is_dataclass(hint):
        return _fact(hint)
    origin, args = get_origin(hint), get_args(hint)
    if origin in (types.UnionType, Union):
        return _optional(_reader(next(arg for arg in args if arg is not type(None))))
    if origin is tuple:
        item = _reader(args[0])
        return lambda data: tuple([item(part) for part in _of(list, data)])
    if origin is not None and issubclass(origin, Mapping):
        return _mapping(_reader(args[1]))
    if hint is float:
        return _float
    return functools.partial(_of, hint)


def _fact(kind: Any) -> Read:
    hints = get_type_hints(kind)
    readers = tuple(_reader(hints[field.name]) for field in fields(kind))
    count, name = len(readers), kind.__name__

    def read(data: Any) -> Any:
        if type(data) is not list or len(data) != count:
            raise ValueError(f"not a {name}: {count} fields expected")
        return kind(*[reader(item) for reader, item in zip(readers, data, strict=True)])

    return read


def _optional(read: Read) -> Read:
    return lambda data: None if data is None else read(data)


def _mapping(read: Read) -> Read:
    """JSON keys are always texts."""
    return lambda data: {key: read(item) for key, item in _of(dict, data).items()}


def _float(data: Any) -> float:
    if isinstance(data, bool) or not math.isfinite(data):
        raise ValueError(f"{data!r} is not a valid number")
    return float(data)


def _of(kind: Any, data: Any) -> Any:
    # type(), not isinstance: True is an int for Python and none for us.
    if type(data) is not kind:
        raise TypeError(f"{kind.__name__} expected, not {type(data).__name__}")
    return data
