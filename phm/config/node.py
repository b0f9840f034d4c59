"""Access to a tree that may be invalid anywhere: a value of the wrong type counts as absent.

So the rules between keys find their problems in addition to pydantic's, and the user sees all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from phm.config.problems import Path, Problem, dotted
from phm.config.yaml_tree import Tree


@dataclass(frozen=True, slots=True)
class ConfigNode:
    """One place in the tree. `problems` is shared by all nodes of a tree."""

    tree: Tree
    file: str
    problems: list[Problem]
    path: Path = ()
    value: Any = None

    def get(self, *keys: str) -> ConfigNode:
        """The place under `keys`, whether or not it exists."""
        value: Any = self.value
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        return ConfigNode(self.tree, self.file, self.problems, (*self.path, *keys), value)

    def entries(self) -> Iterator[ConfigNode]:
        """The entries of a list."""
        for index, entry in enumerate(self.value if isinstance(self.value, list) else ()):
            yield ConfigNode(self.tree, self.file, self.problems, (*self.path, index), entry)

    def records(self) -> Iterator[ConfigNode]:
        """The entries of a list that are mappings."""
        return (entry for entry in self.entries() if isinstance(entry.value, dict))

    def items(self) -> Iterator[tuple[str, ConfigNode]]:
        """Keys of a mapping and their places."""
        for key in self.value if isinstance(self.value, dict) else ():
            yield key, self.get(key)

    @property
    def text(self) -> str:
        """The text, stripped as the models do; empty when there is none."""
        return self.value.strip() if isinstance(self.value, str) else ""

    @property
    def texts(self) -> list[ConfigNode]:
        """The entries of a list that are text."""
        return [entry for entry in self.entries() if entry.text]

    def quantity(self, kind: Any, default: float) -> float | None:
        """The value as a number of `kind` (`Seconds`, `Percent`, ...); `default` when absent, None when invalid."""
        if self.value is None:
            return default
        try:
            return float(TypeAdapter(kind).validate_python(self.value))
        except (ValidationError, TypeError, OverflowError):
            return None

    @property
    def given(self) -> bool:
        return self.value is not None

    @property
    def line(self) -> int:
        return self.tree.line(self.path)

    def add_problem(self, message: str) -> None:
        """Report a mistake at this place of the file. message: what is wrong and what is allowed, without the name of the key."""
        self.problems.append(Problem(self.file, self.line, dotted(self.path), message))
