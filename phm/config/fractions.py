"""Shares that are written as fractions: a bare number is percent, so 0.9 is 0.9 % and not 90 %."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path as FilePath
from typing import Any

from phm.config.env_expansion import Expander
from phm.config.loader import read_file
from phm.config.problems import ConfigError, Path, Problem, dotted
from phm.config.schema_lookup import field_at, unit_of
from phm.config.yaml_tree import parse


def warnings(file: str, environ: Mapping[str, str]) -> list[str]:
    """One for each bare number above 0 and below 1 where percent are expected. The file is valid, and may mean it."""
    try:
        tree = parse(read_file(FilePath(file)), file, Expander(environ))
    except ConfigError:  # it was replaced since it was found to be valid
        return []
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
