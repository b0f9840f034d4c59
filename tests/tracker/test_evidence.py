"""Decisions follow from typed fields of a result, never from its `values`."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import phm

ROOT = Path(phm.__file__).parent
MODULES = [path for part in ("tracker", "recovery", "commands") for path in sorted((ROOT / part).rglob("*.py"))]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_decision_reads_values(path: Path) -> None:
    """`values` are for logs and reporters; the only attribute of that name that may be read is the method of a mapping."""
    tree = ast.parse(path.read_text())
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    read = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr == "values"]
    assert not [node.lineno for node in read if id(node) not in called]
