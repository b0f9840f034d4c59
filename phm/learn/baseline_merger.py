"""Writes a learned baseline into a configuration and keeps everything else in it: comments, order, variables, other keys.

Rules: an entry that the file has is updated, one that it lacks is added, and none is removed. An entry that was not observed
is marked by a comment. Keys that identify an entry, and keys about which nothing was learned, are never changed.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from phm.config.env_expansion import Expander, ExpandError
from phm.learn import yaml_comments
from phm.learn.baseline import Baseline, Learned

if TYPE_CHECKING:
    from ruamel.yaml.comments import CommentedMap, CommentedSeq

MARK = "learned:"
"""Begins each comment that `phm learn` writes, so that it replaces its own comments and no others."""
NOT_SEEN = "not seen while watching"
RATE_PERCENT = 2.0
"""A configured rate that is so close to the learned one stays."""
_IDENTITY = ("name", "path", "label", "alias")
_HEADER = "Written by `phm learn`. Comments with `learned:` say where it is not certain: check these."


def merge(text: str, baseline: Baseline, environ: Mapping[str, str]) -> str:
    """The text of the configuration with the baseline in it. text: the existing file, or empty. environ: for its variables."""
    yaml = _yaml(text)
    tree = yaml.load(text) if text.strip() else None
    if tree is None:
        tree = _empty()
    _Merger(Expander(environ)).write(tree, baseline)
    stream = io.StringIO()
    yaml.dump(tree, stream)
    return _general_notes(stream.getvalue(), baseline.notes)


def _yaml(text: str) -> Any:
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.brace_single_entry_mapping_in_flow_sequence = True
    yaml.width = 4096
    if re.search(r": null\b", text):
        yaml.representer.add_representer(
            type(None), lambda target, _: target.represent_scalar("tag:yaml.org,2002:null", "null")
        )
    indented = re.search(r"^( *)[^\s#-][^\n]*:[ ]*(?:#[^\n]*)?\n(?:[ ]*#[^\n]*\n|\n)*( *)- ", text, re.MULTILINE)
    offset = 0 if indented is not None and len(indented[1]) == len(indented[2]) else 2
    yaml.indent(mapping=2, sequence=2 + offset, offset=offset)
    return yaml


def _empty() -> CommentedMap:
    from ruamel.yaml.comments import CommentedMap

    tree = CommentedMap()
    tree.yaml_set_start_comment(_HEADER)
    return tree


def _general_notes(text: str, notes: Sequence[str]) -> str:
    """Replace the notes at the end of the text."""
    lines = text.splitlines()
    while lines and lines[-1].startswith(f"# {MARK} "):
        lines.pop()
    return "\n".join([*lines, *(f"# {MARK} {_line(note)}" for note in notes)]) + "\n"


class _Merger:
    def __init__(self, expander: Expander) -> None:
        self._expander = expander
        self._seen: frozenset[str] = frozenset()

    def write(self, tree: CommentedMap, baseline: Baseline) -> None:
        self._section(tree, "agent", baseline.agent)
        self._seen = baseline.seen
        self._list(tree, "containers", baseline.containers)
        if baseline.nodes or baseline.topics or "ros" in tree:
            ros = _child(tree, "ros")
            self._list(ros, "nodes", baseline.nodes, mark=baseline.ros_watched)
            self._list(ros, "topics", baseline.topics, mark=baseline.ros_watched)
            if not ros:
                del tree["ros"]
        self._section(tree, "mavlink", baseline.mavlink)

    def _section(self, tree: CommentedMap, key: str, learned: Learned) -> None:
        if not learned.values and not learned.notes:
            return
        section = _child(tree, key)
        self._update(section, learned)
        why = learned.notes.get("")
        if why is not None:
            self._note(tree, key, why)

    def _list(self, parent: CommentedMap, key: str, learned: Sequence[Learned], *, mark: bool = False) -> None:
        """mark: entries of which nothing was seen."""
        if not learned and not (mark and isinstance(parent.get(key), list)):
            return
        from ruamel.yaml.comments import CommentedMap, CommentedSeq

        if not isinstance(parent.get(key), list):
            parent[key] = CommentedSeq()
        entries = parent[key]
        known = {self._identity(entry): entry for entry in entries if isinstance(entry, CommentedMap)}
        for one in learned:
            entry = known.get(_bare(one.name))
            if entry is not None:
                self._update(entry, one)
                continue
            after = yaml_comments.take_following(entries)
            entry = CommentedMap()
            self._update(entry, one)
            entries.append(entry)
            yaml_comments.put_following(entries, after)
        for name, entry in known.items():
            if mark and name not in self._seen and entry:
                self._note(entry, next(iter(entry)), NOT_SEEN)

    def _update(self, entry: CommentedMap, learned: Learned) -> None:
        for key in entry:
            yaml_comments.remove(entry, key, MARK)
        for key, value in learned.values.items():
            if key in _IDENTITY and any(known in entry for known in _IDENTITY):
                continue
            if isinstance(value, Mapping) and isinstance(entry.get(key), dict):
                self._update(entry[key], Learned(value))
            elif key not in entry or not self._same(key, entry[key], value):
                self._set(entry, key, value)
        for key, below in learned.nested.items():
            self._list(entry, key, below)
        for key, why in learned.notes.items():
            if key:
                self._note(entry, key if key in entry else next(iter(entry)), why)

    @staticmethod
    def _set(entry: CommentedMap, key: str, value: Any) -> None:
        if isinstance(value, list) and isinstance(entry.get(key), list) and entry[key]:
            yaml_comments.replace_items(entry[key], [_node(one) for one in value])
        elif key in entry or not entry:
            entry[key] = _node(value)
        else:
            after = yaml_comments.take_following([entry])
            entry[key] = _node(value)
            yaml_comments.put_following([entry], after)

    @staticmethod
    def _note(entry: CommentedMap, key: str, why: str) -> None:
        yaml_comments.add(entry, key, f"{MARK} {_line(why)}")

    def _identity(self, entry: Mapping[str, Any]) -> str:
        """As `ContainerSettings.key` for a container; the name or path of another entry."""
        for key in ("alias", "name", "path"):
            if isinstance(entry.get(key), str):
                return _bare(self._expanded(entry[key]))
        return self._expanded(str(entry.get("label") or "")).rpartition("=")[2]

    def _same(self, key: str, old: Any, new: Any) -> bool:
        """Whether the configured value already says what was learned."""
        if isinstance(old, str):
            old = self._expanded(old)
        if isinstance(new, bool):
            return str(old).lower() == str(new).lower()
        if key == "rate":
            hz = _number(old)
            return hz is not None and abs(hz - new) <= RATE_PERCENT / 100 * max(hz, new)
        if key in ("tolerance", "autopilot_timeout"):
            number = _number(old)
            return number is not None and number >= new  # a wider one was chosen for a reason
        if isinstance(old, list) and isinstance(new, list):
            known = {_bare(self._expanded(str(one))) for one in old}
            return (
                {_bare(str(one)) for one in new} <= known
                if key == "ignore"
                else known == {_bare(str(one)) for one in new}
            )
        return bool(old == new)

    def _expanded(self, text: str) -> str:
        try:
            return self._expander.expand(text)
        except ExpandError:
            return text


def _child(tree: CommentedMap, key: str) -> CommentedMap:
    from ruamel.yaml.comments import CommentedMap

    if not isinstance(tree.get(key), dict):
        tree[key] = CommentedMap()
    found: CommentedMap = tree[key]
    return found


def _node(value: Any) -> Any:
    """Lists and mappings in one line, and text that YAML would take for something else in quotes."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq
    from ruamel.yaml.scalarstring import DoubleQuotedScalarString

    if isinstance(value, list):
        sequence: CommentedSeq = CommentedSeq([DoubleQuotedScalarString(_literal(one)) for one in value])
        sequence.fa.set_flow_style()
        return sequence
    if isinstance(value, Mapping):
        mapping: CommentedMap = CommentedMap({key: _node(one) for key, one in value.items()})
        mapping.fa.set_flow_style()
        return mapping
    return _literal(value) if isinstance(value, str) else value


def _literal(text: str) -> str:
    """As the configuration must have it to mean just this text: a variable in it is none."""
    return text.replace("${", "$${")


def _number(value: Any) -> float | None:
    """The number in ``10``, ``10Hz``, ``15%`` or ``3.5s``; None for another unit."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return float(value)
    match = re.fullmatch(r"\s*([0-9.]+)\s*(?:Hz|%|s)?\s*", str(value))
    try:
        return float(match[1]) if match is not None else None
    except ValueError:
        return None


def _bare(name: str) -> str:
    """A ROS name without its first slash; a path keeps it, which makes no difference for comparing."""
    return name.lstrip("/").rstrip("/")


def _line(text: str) -> str:
    return " ".join("".join(char if char.isprintable() else "?" for char in text).split())


def unified_diff(old: str, new: str, name: str) -> Iterator[str]:
    """Lines of a unified diff without line ends."""
    from difflib import unified_diff as lines

    return (line.rstrip("\n") for line in lines(old.splitlines(True), new.splitlines(True), name, f"{name} (learned)"))
