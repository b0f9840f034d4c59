"""The message class of a type's name, where its package is installed beside PHM."""

from __future__ import annotations

import importlib
from typing import Any


class UnknownType(Exception):
    """The package of a message type is not installed beside PHM."""


def load_type(name: str) -> Any:
    """The message class of `package/msg/Type`. Raises UnknownType."""
    package, _, rest = name.partition("/")
    kind, _, short = rest.partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), short)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise UnknownType(f"type unknown: {name} is not installed beside PHM") from error
