"""Edits of a configuration's text by place."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

from phm.config import yaml_text, yaml_tree
from phm.config.editor import Edit, EditError, apply, diff, values

REFERENCE = (Path(__file__).parents[2] / "config" / "phm.yaml").read_text(encoding="utf-8")
SMALL = """\
# Who we are.
agent:
  name: "a1"   # on the tail
containers:
  - name: app
    # Only on the bench.
    recover: true
  - name: router
#interval: 20s
"""


def edited(text: str, *edits: tuple[Any, ...]) -> str:
    return apply(text, [Edit(*edit) for edit in edits])


SECTIONS = re.findall(r"^\w+:.*\n(?:(?!\w).*\n)*", REFERENCE, re.MULTILINE)
"""The reference in pieces: an edit parses all of its text several times."""


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every value below the top."""
    if path:
        yield path
    for key, value in data.items() if isinstance(data, dict) else enumerate(data if isinstance(data, list) else ()):
        yield from places(value, (*path, key))


def test_a_changed_value_changes_its_line_and_no_other() -> None:
    """The comment at the end of the line and the quotes stay."""
    assert edited(SMALL, ("set", ("agent", "name"), "a2")) == SMALL.replace('"a1"', '"a2"')


def test_a_new_entry_follows_the_others() -> None:
    """In the style of the file's lists, text in quotes where YAML would take it for something else."""
    made = edited(SMALL, ("add", ("containers",), {"name": "7", "recover": True, "networks": ["n1", "${NET}"]}))
    lines = ['  - name: "7"', "    recover: true", '    networks: [n1, "${NET}"]', "#interval: 20s"]
    assert made.endswith("\n".join(["  - name: router", *lines, ""]))


def test_a_new_key_takes_the_line_where_the_file_has_it_as_a_comment() -> None:
    """So the explanation above it stays with it."""
    made = edited(SMALL, ("set", ("interval",), "10s"))
    assert made == SMALL.replace("#interval: 20s", "interval: 10s")


def test_sections_on_the_way_are_created() -> None:
    """Also in a file that is empty."""
    assert edited("", ("set", ("ros", "nodes"), [{"name": "/a"}])) == "ros:\n  nodes:\n    - name: /a\n"
    made = edited(SMALL, ("set", ("containers", 1, "ready", "topics"), ["/t"]))
    assert "  - name: router\n    ready:\n      topics: [/t]\n" in made


def test_removing_a_key_keeps_the_comments_of_others() -> None:
    """A key of one line below its explanation becomes a comment, an entry goes with its own comments."""
    assert "    # Only on the bench.\n    #recover: true\n" in edited(SMALL, ("remove", ("containers", 0, "recover")))
    made = edited(SMALL, ("remove", ("containers", 0)))
    assert made == SMALL.replace("  - name: app\n    # Only on the bench.\n    recover: true\n", "")
    made = edited(SMALL, ("remove", ("containers", 0, "name")))
    assert values(made)[0]["containers"][0] == {"recover": True}
    assert "# Only on the bench." in made


def test_the_last_one_leaves_an_empty_list() -> None:
    """And an entry can be added to it again."""
    made = edited(SMALL, ("remove", ("containers", 1)), ("remove", ("containers", 0)))
    assert "containers: []\n" in made
    assert "containers:\n  - name: b\n" in edited(made, ("add", ("containers",), {"name": "b"}))


def test_collections_in_brackets_are_written_again() -> None:
    """What changes inside keeps them; with a new key the entries get separate lines."""
    text = "containers: [{name: app, networks: [a, b]}]\n"
    assert edited(text, ("remove", ("containers", 0, "networks", 0))) == "containers: [{name: app, networks: [b]}]\n"
    assert edited(text, ("set", ("containers", 0, "networks", 1), "${X}")) == text.replace(" b]", ' "${X}"]')
    made = edited(text, ("set", ("containers", 0, "recover"), True))
    assert made == "containers:\n  - name: app\n    networks: [a, b]\n    recover: true\n"


def test_a_variable_for_a_number_is_not_quoted() -> None:
    """And a text that only looks like one cannot change the structure of the file."""
    edit = Edit.from_json({"do": "set", "path": ["agent", "id"], "value": {"$unquoted": "${ID:-2}"}})
    assert "  id: ${ID:-2}\n" in apply(SMALL, [edit])
    hostile = Edit.from_json({"do": "set", "path": ["agent", "id"], "value": {"$unquoted": "1\nlog: {files: 1}"}})
    assert values(apply(SMALL, [hostile]))[0]["agent"]["id"] == "1\nlog: {files: 1}"


@pytest.mark.parametrize(
    "text", ["a: b", "- x", "# no", "${X}", "'", '"', "a\nb", "yes", "1e3", "null", "", "\u2028", "é ✓ 🛩", "\x7f"]
)
def test_every_text_is_read_back_as_it_was_given(text: str) -> None:
    """As a value, as an entry of a list, and as a key."""
    made = edited(SMALL, ("set", ("agent", "name"), text), ("add", ("x",), text), ("set", ("y", text), text))
    data, problems = values(made)
    assert problems == []
    assert (data["agent"]["name"], data["x"], data["y"]) == (text, [text], {text: text})


@pytest.fixture
def parsed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """An edit parses its text several times, and these tests edit the same text hundreds of times. No code changes the tree."""
    cached = lru_cache(maxsize=4)(yaml_tree.compose)
    for module in (yaml_tree, yaml_text):
        monkeypatch.setattr(module, "compose", cached)


@pytest.mark.usefixtures("parsed_once")
@pytest.mark.parametrize("text", SECTIONS, ids=[text.partition(":")[0] for text in SECTIONS])
def test_every_value_of_the_reference_can_be_set_and_removed(text: str) -> None:
    """Setting it to what it is changes nothing; removing it keeps every other value and every comment outside of it."""
    data, _ = values(text)
    for path in places(data):
        value: Any = data
        for part in path:
            value = value[part]
        if not isinstance(value, dict | list) and "${" not in str(value):
            assert edited(text, ("set", path, value)) == text, path
        made = edited(text, ("remove", path)) if 1 < len(path) < 4 else text
        gone = set(comments(text)) - set(comments(made))
        assert isinstance(value, dict | list) or not gone, path


@pytest.mark.usefixtures("parsed_once")
def test_every_section_of_the_reference_can_be_removed() -> None:
    """It keeps the others."""
    assert REFERENCE.endswith("".join(SECTIONS))
    data, _ = values(REFERENCE)
    for name in data:
        left, problems = values(edited(REFERENCE, ("remove", (name,))))
        assert (left, problems) == ({key: value for key, value in data.items() if key != name}, [])


def comments(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines() if re.match(r" *# ", line)]


def test_aliases_are_refused_where_a_change_would_reach_further() -> None:
    """The rest of such a file can be changed."""
    text = "containers:\n  - &c\n    name: app\n  - *c\nlog:\n  files: 3\n"
    with pytest.raises(EditError, match="change it in the YAML"):
        edited(text, ("set", ("containers", 1, "name"), "b"))
    assert "files: 4" in edited(text, ("set", ("log", "files"), 4))


@pytest.mark.parametrize(
    "edit",
    [
        {},
        {"do": "drop", "path": ["a"]},
        {"do": "set", "path": []},
        {"do": "set", "path": [True], "value": 1},
        {"do": "set", "path": ["a"] * 99, "value": 1},
        {"do": "set", "path": ["a"], "value": float("inf")},
        {"do": "set", "path": ["a"], "value": "x" * 10_001},
        {"do": "remove", "path": ["nothing"]},
        {"do": "set", "path": ["containers", 9, "name"], "value": "x"},
        {"do": "set", "path": ["containers", "app", "name"], "value": "x"},
        {"do": "add", "path": ["agent"], "value": "x"},
    ],
)
def test_wrong_edits_are_refused(edit: dict[str, Any]) -> None:
    """Each with a sentence."""
    with pytest.raises(EditError):
        apply(SMALL, [Edit.from_json(edit)])


def test_line_ends_of_windows_stay() -> None:
    """Of every line."""
    made = edited(SMALL.replace("\n", "\r\n"), ("set", ("log", "files"), 4))
    assert made.count("\r\n") == made.count("\n") and "files: 4" in made


def test_the_diff_names_the_file() -> None:
    """And is empty when nothing changed."""
    assert diff(SMALL, SMALL, "a.yaml") == ""
    lines = diff(SMALL, edited(SMALL, ("set", ("agent", "name"), "a2")), "a.yaml").splitlines()
    assert lines[:2] == ["--- a.yaml", "+++ a.yaml (changed)"] and '+  name: "a2"   # on the tail' in lines
