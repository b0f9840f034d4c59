"""Plain values as YAML that PHM reads as these values: text in quotes wherever YAML or a variable would make something else of it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import yaml

from phm.config.yaml_scalars import resolve

_PLAIN = re.compile(r"[A-Za-z0-9_/.][A-Za-z0-9_/.@+%°-]*( [A-Za-z0-9_/.@+%°-]+)*")
_KEY = re.compile(r"[A-Za-z_/][A-Za-z0-9_/.-]*")
_VARIABLE = re.compile(r"[A-Za-z0-9_/. -]*(\$\{[A-Za-z_][A-Za-z0-9_]*(:-[A-Za-z0-9_/.@+% -]*)?\}[A-Za-z0-9_/. -]*)+")


@dataclass(frozen=True, slots=True)
class Unquoted:
    """A text with a variable for a number or a truth value, so it must not be in quotes."""

    text: str

    @property
    def is_variable(self) -> bool:
        """Anything else could change the structure of the file, and is written in quotes."""
        return _VARIABLE.fullmatch(self.text) is not None

    @property
    def value(self) -> str:
        return self.text.strip() if self.is_variable else self.text


def scalar(value: Any, *, quote: str = "") -> str:
    """One value on one line. quote: the style that it had; text in quotes keeps them."""
    if isinstance(value, Unquoted):
        return value.value if value.is_variable else _quoted(value.value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "null"
    if isinstance(value, int | float):
        return repr(value)
    text = str(value)
    if not quote and _PLAIN.fullmatch(text) and isinstance(resolve(text), str):
        return text
    if quote == "'" and text.isprintable():
        return "'" + text.replace("'", "''") + "'"
    return _quoted(text)


def flow(value: Any) -> str:
    """Any value on one line: `[a, b]`, `{k: v}`."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)}: {flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(flow, value)) + "]"
    return _quoted(value.value) if isinstance(value, Unquoted) else scalar(value)


def entry(key: str, value: Any, column: int, step: int) -> list[str]:
    """Lines of `key: value` at a column. step: columns between a key and the '-' of its list."""
    head = f"{' ' * column}{_key(key)}:"
    if _is_inline(value):
        return [f"{head} {_inline(value)}"]
    if isinstance(value, dict):
        return [head, *(line for name, one in value.items() for line in entry(name, one, column + 2, step))]
    return [head, *(line for one in value for line in item(one, column + step, step))]


def item(value: Any, column: int, step: int) -> list[str]:
    """Lines of `- value` with the '-' at a column."""
    if _is_inline(value):
        return [f"{' ' * column}- {_inline(value)}"]
    if isinstance(value, list):
        return [f"{' ' * column}- {flow(value)}"]
    lines = list(_entries(value, column + 2, step))
    return [f"{' ' * column}- {lines[0].lstrip(' ')}", *lines[1:]]


def _entries(value: dict[str, Any], column: int, step: int) -> Iterator[str]:
    for key, one in value.items():
        yield from entry(key, one, column, step)


def _is_inline(value: Any) -> bool:
    if isinstance(value, list):
        return not any(isinstance(one, dict | list) and one for one in value)
    return not (isinstance(value, dict) and value)


def _inline(value: Any) -> str:
    return flow(value) if isinstance(value, dict | list) else scalar(value)


def _key(key: str) -> str:
    return key if _KEY.fullmatch(key) and isinstance(resolve(key), str) else _quoted(key)


def _quoted(text: str) -> str:
    made: str = yaml.dump(text, default_style='"', allow_unicode=True, width=float("inf"))
    return made.rstrip("\n")
