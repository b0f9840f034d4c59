"""The word gate finds the listed words, and its list is valid."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

import pytest

from tests.docs.examples import ROOT

LIST = """
words:
  'foo(?:s|ed)?': 'bar'
  'in the foo of': 'by'
allow:
  - text: 'foo-fighter'
    reason: 'a name'
  - text: '(?m)^\\| foo .*$'
    path: 'docs/'
    reason: 'a table'
skip:
  - path: 'generated'
    reason: 'generated'
rewrite:
  old: 2
"""


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("check_words", ROOT / "scripts" / "check_words.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["check_words"] = module
    spec.loader.exec_module(module)
    return module


GATE = load()
RULES = GATE.Rules(LIST)


@pytest.mark.parametrize("text", ["foo", "Foos", "is_foo", "fooBar", "isFoo", "FOOED", "foo.", "x foo2"])
def test_a_word_is_found_in_text_and_in_names(text: str) -> None:
    """Case, underscores and digits do not hide it."""
    assert [hit.instead for hit in RULES.hits("a.py", text)] == ["bar"]


@pytest.mark.parametrize("text", ["food", "barfoo", "foo-fighter", "defoo"])
def test_a_part_of_a_word_is_not_found(text: str) -> None:
    """Nor text that an exception permits."""
    assert RULES.hits("a.py", text) == []


def test_a_phrase_is_found_across_lines() -> None:
    """A comment sign may be between its words."""
    assert len(GATE.Rules(LIST.replace("foo(?:s|ed)?", "other")).hits("a.py", "# in the\n    # foo of")) == 1


def test_an_exception_of_a_path_counts_only_there() -> None:
    """`path` is the prefix of a file's path."""
    assert RULES.hits("docs/a.md", "| foo |") == [] and len(RULES.hits("a.md", "| foo |")) == 1


def test_an_area_may_keep_its_hits_and_not_get_more() -> None:
    """Outside of the listed areas no hit is allowed."""
    hits = [GATE.Hit("old/a.py", 1, "foo", "bar")] * 2
    assert GATE.judge(RULES, hits) == []
    assert len(GATE.judge(RULES, [*hits, hits[0]])) == 1
    assert len(GATE.judge(RULES, [GATE.Hit("older.py", 1, "foo", "bar")])) == 1


def test_each_exception_has_a_reason() -> None:
    """Also each file that is not checked."""
    data = GATE.yaml.safe_load((ROOT / "scripts" / "words.yaml").read_text("utf-8"))
    assert all(entry["reason"] for entry in [*data["allow"], *data["skip"]])
