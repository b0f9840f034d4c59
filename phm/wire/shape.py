"""Whether a JSON document from outside has the types that its reader relies on. Pure, standard library only.

A shape is a type or a tuple of them (`float` takes every finite number), ``[shape]`` for a list of any length, `TableShape`
for an object with any keys, or a dict: these keys must have these shapes when they are there, further ones may be
anything. A key that ends in ``!`` must be there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

Shape = Any


@dataclass(frozen=True)
class TableShape:
    """An object whose values all have one shape."""

    values: Shape


def mismatch(value: object, shape: Shape, where: str = "") -> str:
    """Where `value` has another shape, as ``checks[3].slot is missing``; empty when it fits."""
    if isinstance(shape, list):
        if not isinstance(value, list):
            return f"{where or 'it'} is not a list"
        return _first(mismatch(entry, shape[0], f"{where}[{index}]") for index, entry in enumerate(value))
    if isinstance(shape, (dict, TableShape)):
        if not isinstance(value, dict):
            return f"{where or 'it'} is not an object"
        if isinstance(shape, TableShape):
            return _first(mismatch(entry, shape.values, f"{where}[{key!r}]") for key, entry in value.items())
        return _first(_member(value, key, inner, where) for key, inner in shape.items())
    kinds = shape if isinstance(shape, tuple) else (shape,)
    return "" if any(_is(value, kind) for kind in kinds) else f"{where or 'it'} is of the wrong type"


def _member(value: dict[str, Any], key: str, shape: Shape, where: str) -> str:
    name = key.removesuffix("!")
    path = f"{where}.{name}" if where else name
    if name in value:
        return mismatch(value[name], shape, path)
    return f"{path} is missing" if name != key else ""


def _is(value: object, kind: type) -> bool:
    if isinstance(value, bool):
        return kind is bool
    if kind is float:
        return isinstance(value, (int, float)) and abs(value) < 1e15 and math.isfinite(value)
    if kind is int:
        return isinstance(value, int) and abs(value) < 2**63
    return isinstance(value, kind)


def _first(found: Any) -> str:
    return next((text for text in found if text), "")
