"""YAML as plain values with the line and column of each, and all problems instead of the first.

`yaml.compose` gives nodes with their positions; no object is constructed, so tags have no effect. Sizes are
limited before and while composing: characters, depth, and the number of values after following aliases.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import yaml

from phm.config.env_expansion import Expander, ExpandError
from phm.config.problems import Path, Problem, dotted, shown
from phm.config.yaml_errors import explain
from phm.config.yaml_scalars import resolve

MAX_BYTES = 256 * 1024
MAX_DEPTH = 24
MAX_VALUES = 20_000


@dataclass(frozen=True, slots=True)
class Mark:
    """A position in the file, both counted from 1."""

    line: int
    column: int


@dataclass(slots=True)
class Tree:
    """A document: plain `data`, and the positions of its keys and values.

    There may be `problems` although data is usable. broken: the data cannot be validated at all. bad: the places whose value is
    missing because of a problem already reported.
    """

    data: Any = None
    broken: bool = False
    bad: set[Path] = field(default_factory=set)
    keys: dict[Path, Mark] = field(default_factory=dict)
    values: dict[Path, Mark] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)

    def line(self, path: Path) -> int:
        """Line of a key or of a list's entry; for a path that is not in the file, of its closest parent."""
        while path:
            mark = self.keys.get(path) or self.values.get(path)
            if mark:
                return mark.line
            path = path[:-1]
        return 1


class _TooMuch(yaml.MarkedYAMLError):
    """A limit was exceeded, or an unsupported feature was used."""


class _Loader(yaml.SafeLoader):
    """Composes with limits. Plain scalars get no type: `phm.config.yaml_scalars` decides it, after expansion."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if self.depth >= MAX_DEPTH:
            raise _TooMuch(problem=f"is nested deeper than {MAX_DEPTH} levels", problem_mark=event.start_mark)
        if not isinstance(event, yaml.AliasEvent) and getattr(event, "tag", None) not in (None, "!"):
            sentence = f"the tag {shown(event.tag)} is not supported (write the value alone; quote it to keep it text)"
            raise _TooMuch(problem=sentence, problem_mark=event.start_mark)
        self.depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self.depth -= 1


def parse(text: str, file: str, expander: Expander) -> Tree:
    """Read one document. Never raises for anything in `text`: its problems are in `problems`, each with its line."""
    tree = Tree()
    node = None
    try:
        node = compose(text)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        problem = f"the character {shown(chr(error.character))} is not allowed in YAML: remove it"
        tree.problems.append(Problem(file, line, "", problem))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        stopped = mark.line + 1 if mark else 0
        line, problem = (stopped, str(error.problem)) if isinstance(error, _TooMuch) else explain(error, text)
        hint = " (inside [] and {} a text with ${...} needs quotes)" if "${" in _line(text, stopped) else ""
        tree.problems.append(Problem(file, line, "", problem + hint))
    else:
        if node is None:
            tree.problems.append(
                Problem(file, 0, "", "is empty: write at least one key (`phm init` writes a complete file)")
            )
        elif isinstance(node, yaml.MappingNode):
            tree.data = _Builder(tree, file, expander).build(node, ())
        else:
            message = "the top level is not a mapping: write keys such as 'agent:' and 'containers:'"
            tree.problems.append(Problem(file, node.start_mark.line + 1, "", message))
    tree.broken = tree.broken or not isinstance(node, yaml.MappingNode)
    return tree


def compose(text: str) -> yaml.Node | None:
    """The nodes of the document, within the limits; None when it is empty. Raises `yaml.YAMLError`."""
    loader = _Loader(text)
    try:
        return loader.get_single_node()
    except (ValueError, OverflowError) as error:  # an escape such as "\UFFFFFFFF", which PyYAML does not check
        raise _TooMuch(problem=f"invalid escape sequence ({error})", problem_mark=loader.get_mark()) from error
    except RecursionError as error:
        raise _TooMuch(problem="is nested too deeply", problem_mark=loader.get_mark()) from error
    finally:
        loader.dispose()


def _line(text: str, number: int) -> str:
    lines = text.split("\n")
    return lines[number - 1] if 0 < number <= len(lines) else ""


class _Builder:
    """Nodes -> plain values. Invariant: `left` counts every value that is made, also through aliases."""

    def __init__(self, tree: Tree, file: str, expander: Expander) -> None:
        self._tree, self._file, self._expander = tree, file, expander
        self._open: list[yaml.Node] = []
        self._left = MAX_VALUES

    def build(self, node: yaml.Node, path: Path) -> Any:
        self._tree.values[path] = _mark(node)
        if self._left <= 0:
            return None
        self._left -= 1
        if self._left == 0:
            self._tree.broken = True
            self._add_problem(
                node, (), f"contains more than {MAX_VALUES} values, counting aliases (split or shorten it)"
            )
            return None
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, path)
        if any(node is parent for parent in self._open):
            self._add_problem(node, path, "an alias is inside its own anchor: write the value out")
            return None
        if len(self._open) >= MAX_DEPTH:
            self._add_problem(node, path, f"is nested deeper than {MAX_DEPTH} levels, counting aliases")
            return None
        self._open.append(node)
        try:
            if isinstance(node, yaml.SequenceNode):
                return [self.build(entry, (*path, index)) for index, entry in enumerate(node.value)]
            return dict(self._entries(node, path))
        finally:
            self._open.pop()

    def _entries(self, node: yaml.Node, path: Path) -> Iterator[tuple[str, Any]]:
        seen: dict[str, int] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                self._add_problem(key_node, path, "a key is a list or a mapping, expected text")
                continue
            key = key_node.value
            here = (*path, key)
            if key in seen:
                self._add_problem(key_node, here, f"is defined twice, first in line {seen[key]}: keep one")
                continue
            if key == "<<":
                self._add_problem(key_node, here, "merge keys are not supported: write the keys out")
                continue
            seen[key] = line
            self._tree.keys[here] = _mark(key_node)
            yield key, self.build(value_node, here)

    def _scalar(self, node: yaml.ScalarNode, path: Path) -> Any:
        try:
            text = self._expander.expand(node.value)
        except ExpandError as error:
            self._add_problem(node, path, str(error))
            return None
        return resolve(text) if node.style is None else text

    def _add_problem(self, node: yaml.Node, path: Path, message: str) -> None:
        if path not in self._tree.keys or not message.startswith("is defined twice"):
            self._tree.bad.add(path)
        self._tree.problems.append(Problem(self._file, node.start_mark.line + 1, dotted(path), message))


def _mark(node: yaml.Node) -> Mark:
    return Mark(node.start_mark.line + 1, node.start_mark.column + 1)
