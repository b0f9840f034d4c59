"""Changes a value in the text of a YAML file, and only the lines that have it: comments, order and style of the rest stay.

Each function takes the text and where the value is, and returns the new text. `phm.config.editor` verifies the result, so what cannot be
done here in a rare style is refused there.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import yaml

from phm.config import yaml_render
from phm.config.problems import Path
from phm.config.yaml_tree import compose


class NotPossible(Exception):
    """The text has a style in which this change cannot be made."""


@dataclass(frozen=True, slots=True)
class Place:
    """A node, the one that contains it (None: it is the document), and its key node in a mapping or its index in a list."""

    node: yaml.Node
    parent: yaml.Node | None = None
    key: yaml.Node | None = None
    index: int = -1


def place_of(text: str, path: Path) -> Place | None:
    """Where a value is; None when it is not in the text."""
    root = compose(text)
    if root is None:
        return None
    found = Place(root)
    for part in path:
        step = _child(found.node, part)
        if step is None:
            return None
        found = step
    return found


def _child(node: yaml.Node, part: str | int) -> Place | None:
    if isinstance(node, yaml.MappingNode) and isinstance(part, str):
        for index, (key, value) in enumerate(node.value):
            if isinstance(key, yaml.ScalarNode) and key.value == part:
                return Place(value, node, key, index)
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and 0 <= part < len(node.value):
        return Place(node.value[part], node, None, part)
    return None


def replace(text: str, place: Place, value: Any) -> str:
    """Another value at the same place."""
    node = place.node
    start, end = node.start_mark.index, _end(node)
    if isinstance(node, yaml.ScalarNode) and not isinstance(value, dict | list):
        made = yaml_render.scalar(value, quote=node.style if node.style in ("'", '"') else "")
        if isinstance(place.parent, yaml.Node) and _is_flow(place.parent):
            made = yaml_render.flow(value) if made[:1] not in "'\"" else made
        return text[:start] + (" " if start and text[start - 1] == ":" else "") + made + text[end:]
    if place.parent is None:
        raise NotPossible
    if place.key is not None and not _is_flow(place.parent):
        colon = text.index(":", place.key.end_mark.index)
        lines = yaml_render.entry("x", value, place.key.start_mark.column, _step(text))
        if value == {}:  # its only key goes: the comments about its keys stay
            lines += [line for line in text[colon:end].split("\n")[1:] if line.lstrip(" ").startswith("#")]
        return text[: colon + 1] + "\n".join(lines).lstrip(" ")[2:] + text[end:]
    return text[:start] + yaml_render.flow(value) + text[end:]


def add_key(text: str, mapping: yaml.MappingNode, key: str, value: Any) -> str:
    """A new key at the end of a block mapping, or where the file has it as a comment (`#key: ...`)."""
    first, last = mapping.value[0][0], mapping.value[-1][1]
    column = first.start_mark.column
    lines = text.split("\n")
    behind = _behind(lines, _last_line(text, last), column)
    made = yaml_render.entry(key, value, column, _step(text))
    if len(made) == 1:
        for number in range(_above(lines, first.start_mark.line, column), behind):
            if re.match(rf" {{{column}}}#{re.escape(key)}:( |$)", lines[number]):
                lines[number] = made[0]
                return "\n".join(lines)
    spaced = column == 0 and "" in lines[:behind]
    return "\n".join([*lines[:behind], *([""] if spaced else []), *made, *lines[behind:]])


def add_item(text: str, sequence: yaml.SequenceNode, value: Any) -> str:
    """A new entry at the end of a block list."""
    column = sequence.start_mark.column
    lines = text.split("\n")
    behind = _behind(lines, _last_line(text, sequence.value[-1]), column + 1)
    return "\n".join([*lines[:behind], *yaml_render.item(value, column, _step(text)), *lines[behind:]])


def remove(text: str, place: Place) -> str:
    """Without a key or an entry of a block collection that has others."""
    lines = text.split("\n")
    if place.key is None:
        line = place.node.start_mark.line
        dash = place.parent.start_mark.column if place.parent else 0
        if lines[line][: dash + 1].strip() != "-":
            raise NotPossible
        return "\n".join([*lines[:line], *lines[_behind(lines, _last_line(text, place.node), dash + 1) :]])
    line, column, last = place.key.start_mark.line, place.key.start_mark.column, _last_line(text, place.node)
    if lines[line][:column].strip():
        return _remove_behind_dash(text, place, last)
    above = lines[line - 1] if line else ""
    if line == last and above.startswith(" " * column + "#") and not re.match(r" *#[\w-]+:( |$)", above):
        lines[line] = f"{' ' * column}#{lines[line][column:]}"  # the comment above stays true
        return "\n".join(lines)
    return "\n".join([*lines[:line], *lines[_behind(lines, last, column + 1) :]])


def _remove_behind_dash(text: str, place: Place, last: int) -> str:
    """The first key of an entry of a list, `- key: value`: the second one takes its place behind the dash."""
    assert place.key is not None and place.parent is not None
    following = place.parent.value[place.index + 1][0].start_mark
    lines = text.split("\n")
    line, column = place.key.start_mark.line, place.key.start_mark.column
    head, between = lines[line][:column], lines[last + 1 : following.line]
    return "\n".join(
        [*lines[:line], *between, head + lines[following.line][following.column :], *lines[following.line + 1 :]]
    )


def is_block(node: yaml.Node) -> bool:
    """A collection with entries on separate lines."""
    return isinstance(node, yaml.CollectionNode) and bool(node.value) and not _is_flow(node)


def _is_flow(node: yaml.Node) -> bool:
    return bool(getattr(node, "flow_style", False))


def _end(node: yaml.Node) -> int:
    """Index behind the last character: a block collection's own mark is behind the comments that follow it."""
    if is_block(node):
        last = node.value[-1]
        return _end(last[1] if isinstance(last, tuple) else last)
    return int(node.end_mark.index)


def _last_line(text: str, node: yaml.Node) -> int:
    """The line with its last character, from 0."""
    return text.rstrip("\n").count("\n", 0, max(node.start_mark.index, _end(node) - 1))


def _behind(lines: list[str], last: int, column: int) -> int:
    """The line behind one and the comments directly below it that are indented at least to a column."""
    line = last + 1
    while line < len(lines) and re.match(rf" {{{column},}}#", lines[line]):
        line += 1
    return line


def _above(lines: list[str], line: int, column: int) -> int:
    """The first of the comment lines directly above a line that are indented at least to a column."""
    while line and re.match(rf" {{{column},}}#", lines[line - 1]):
        line -= 1
    return line


def _step(text: str) -> int:
    """Columns between a key and the '-' of its list in this file."""
    found = re.search(r"^( *)[^\s#-][^\n]*:[ ]*(?:#[^\n]*)?\n(?:[ ]*#[^\n]*\n|\n)*( *)- ", text, re.MULTILINE)
    return 0 if found is not None and len(found[1]) == len(found[2]) else 2
