"""Conditions that installed checks can report, by the texts in their source code.

A check declares its conditions nowhere: each result names one. So a condition is known if it occurs in quotes in the
source of a check's package. This also finds the conditions of plug-ins.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from phm.api import Check

_WORD = re.compile(r"""["'}](_?[a-z][a-z0-9_]*)["'{]""")
"""A word in quotes, or the part of one before or after an inserted value, as in `diagnostic_{level}` and `{kind}_missing`."""


def unnamed(conditions: Iterable[str], checks: Iterable[type[Check]]) -> list[str]:
    """Those of `conditions` that no check names. Reads the source of the checks."""
    wanted = list(conditions)
    if not wanted:
        return []
    words = {word for file in _sources(checks) for word in _WORD.findall(_text(file))}
    before = tuple(word for word in words if word.endswith("_"))
    after = tuple(word for word in words if word.startswith("_"))
    return [
        condition
        for condition in wanted
        if condition not in words and not condition.startswith(before) and not condition.endswith(after)
    ]


def _sources(checks: Iterable[type[Check]]) -> set[Path]:
    """The files of each check's package; of a module without a package, its file."""
    return {file for module in {check.__module__ for check in checks} for file in _files(module)}


def _files(module: str) -> Iterator[Path]:
    package = sys.modules[module.partition(".")[0]]
    if hasattr(package, "__path__"):
        for folder in package.__path__:
            yield from Path(folder).rglob("*.py")
    elif package.__file__:
        yield Path(package.__file__)


def _text(file: Path) -> str:
    """Empty if it cannot be read: a package may be installed without its source."""
    try:
        return file.read_text("utf-8")
    except (OSError, ValueError):
        return ""
