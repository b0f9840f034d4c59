"""Facts as flat lists of JSON for the pipe between daemon and child, and back with every type checked.

A fact is written as the list of its fields in order, so a new field in `phm.ros_facts` needs no line here. Both
sides are the same PHM: the layout is no contract with anyone else.
"""

from __future__ import annotations

import functools
import math
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

T = TypeVar("T")


def pack(fact: Any) -> Any:
    """JSON-able form of a fact: dataclasses and tuples as lists, mappings as objects."""
    if is_dataclass(fact):
        return [pack(getattr(fact, name)) for name in _names(cast(Any, type(fact)))]
    if isinstance(fact, (list, tuple)):
        return [pack(item) for item in fact]
    if isinstance(fact, Mapping):
        return {key: pack(item) for key, item in fact.items()}
    return fact


def unpack(kind: Any, data: Any) -> Any:
    """The fact that `pack` wrote. Raises TypeError or ValueError for anything else."""
    hints = _hints(kind)
    if not isinstance(data, list) or len(data) != len(hints):
        raise ValueError(f"not a {kind.__name__}: {len(hints)} fields expected")
    return kind(*(value(hint, item) for hint, item in zip(hints, data, strict=True)))


def value(hint: Any, data: Any) -> Any:
    """`data` as the type that `hint` names. Raises TypeError or ValueError."""
    if is_dataclass(hint):
        return unpack(hint, data)
    origin = get_origin(hint)
    if origin in (types.UnionType, Union):
        return None if data is None else value(next(arg for arg in get_args(hint) if arg is not type(None)), data)
    if origin is tuple:
        return tuple(value(get_args(hint)[0], item) for item in _of(list, data))
    if origin is not None and issubclass(origin, Mapping):
        item_hint = get_args(hint)[1]
        return {_of(str, key): value(item_hint, item) for key, item in _of(dict, data).items()}
    if hint is float:
        if isinstance(data, bool) or not math.isfinite(data):
            raise ValueError(f"{data!r} is no number of ours")
        return float(data)
    return _of(hint, data)


def _of(kind: type[T], data: Any) -> T:
    # type(), not isinstance: True is an int for Python and none for us.
    if type(data) is not kind:
        raise TypeError(f"{kind.__name__} expected, not {type(data).__name__}")
    return data


@functools.cache
def _hints(kind: Any) -> tuple[Any, ...]:
    hints = get_type_hints(kind)
    return tuple(hints[name] for name in _names(kind))


@functools.cache
def _names(kind: Any) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))
