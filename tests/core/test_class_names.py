"""Unique names of classes."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_no_two_public_classes_of_phm_have_the_same_name() -> None:
    """A name in a log, a traceback or a search leads to one class."""
    trees = (ast.parse(file.read_text("utf-8")) for file in (ROOT / "phm").rglob("*.py"))
    names = Counter(node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef))
    assert names["Tracker"] == 1
    assert [name for name, count in names.items() if count > 1 and not name.startswith("_")] == []
