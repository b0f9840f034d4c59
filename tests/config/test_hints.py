"""A hint, followed as it is written, makes the file valid."""

from __future__ import annotations

import re

import pytest

from phm.config import ConfigError, loads

FOLLOWED = [
    ("ros: {topics: [{name: /a/b, rate: 1, publishers: /a/b}]}\n", "publishers: /a/b", "[/a/b]"),
    ("ros: {topics: [{name: /a/b, rate: 1, publishers: '/a/b, /a/c'}]}\n", "publishers: '/a/b, /a/c'", "[/a/b, /a/c]"),
    ("mavlink: {pilots: 255}\n", "pilots: 255", "[255]"),
    ("containers: [ros_app]\n", "ros_app", "{name: ros_app}"),
    ("containers:\n  - ros_app\n", "ros_app", "{name: ros_app}"),
    ("containers: ros_app\n", "containers: ros_app", "[{name: ros_app}]"),
    ("ros: {nodes: [/a/b]}\n", "/a/b", "{name: /a/b}"),
    ("mavlink: {endpoints: ['tcp:a:1']}\n", "'tcp:a:1'", "{url: tcp:a:1}"),
    ("containers: [{name: app, files: [/x/y]}]\n", "/x/y", "{path: /x/y}"),
]
WITHOUT = [
    ("custom: [abc]\n", "expected a section with keys"),
    ("agent: abc\n", "expected a section with keys"),
    ("containers: [3]\n", "expected a section with keys"),
    ("containers: [a b]\n", "expected a section with keys"),
    (
        "ros: {topics: [{name: /a/b, rate: 1, publishers: '/a: b'}]}\n",
        "expected a list (write the entries between '[' and ']')",
    ),
    ("custom: abc\n", "expected a list (write the entries between '[' and ']')"),
]


def message(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        loads(text, "phm.yaml", environ={})
    (problem,) = caught.value.problems
    return problem.message


@pytest.mark.parametrize(("text", "wrong", "right"), FOLLOWED)
def test_a_followed_hint_makes_the_file_valid(text: str, wrong: str, right: str) -> None:
    """Inside [] and {}, too, where '- ' is not allowed."""
    assert message(text).endswith(f" (write {right})")
    key = re.match(r"\w+: ", wrong)
    loads(text.replace(wrong, f"{key[0] if key else ''}{right}"), "phm.yaml", environ={})


@pytest.mark.parametrize(("text", "end"), WITHOUT)
def test_where_the_entry_is_unclear_the_hint_is_general(text: str, end: str) -> None:
    """The entry may need other keys, the value may not be text, or it needs quotes."""
    assert message(text).endswith(end)
