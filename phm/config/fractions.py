"""Shares that are written as fractions: a bare number is percent, so 0.9 is 0.9 % and not 90 %."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from phm.config.env_expansion import Expander
from phm.config.problems import Path, Problem, dotted
from phm.config.schema_lookup import field_at, unit_of
from phm.config.yaml_tree import parse


def warnings(text: str, file: str, environ: Mapping[str, str]) -> list[str]:
    """One for each bare number above 0 and below 1 where percent are expected. text: of a valid file, which may mean it."""
    tree = parse(text, file, Expander(environ))
    return [
        str(Problem(file, tree.line(path), dotted(path), _sentence(number)))
        for path, number in _numbers(tree.data, ())
        if 0 < number < 1 and _is_share(path)
    ]


def _sentence(number: float) -> str:
    return f"{number:g} is {number:g} %: write {100 * number:g}%, or {number:g}% if that is meant"


def _is_share(path: Path) -> bool:
    field = field_at(path)
    return field is not None and unit_of(field) == "percent"


def _numbers(value: Any, path: Path) -> Iterator[tuple[Path, float]]:
    if isinstance(value, float):
        yield path, value
    elif isinstance(value, dict):
        for key, entry in value.items():
            yield from _numbers(entry, (*path, key))
    elif isinstance(value, list):
        for index, entry in enumerate(value):
            yield from _numbers(entry, (*path, index))
