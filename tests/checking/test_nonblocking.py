"""Checks that share a thread read only what PHM has in memory."""

from __future__ import annotations

import ast
from importlib.util import find_spec
from pathlib import Path

import pytest

from phm.api import Check
from phm.checking.registry import checks

IN_MEMORY = {"clock", "daemon", "links", "ros", "swarm"}
"""Probes whose snapshots neither wait nor read a file."""
WAITS = {"users"}
"""The method of `links` that reads /proc."""
SHARED = sorted(kind.__module__ for kind in checks().values() if not kind.blocking)


def _used(module: str, seen: set[str]) -> set[str]:
    """What this module, and the modules of checks that it imports, use of `world`."""
    if module in seen:
        return set()
    seen.add(module)
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    tree = ast.parse(Path(spec.origin).read_text())
    used = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "world":
            used.add(node.attr)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute) and node.value.attr == "links":
            used |= WAITS & {node.attr}
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("phm_checks."):
            used |= _used(str(node.module), seen)
    return used


def test_some_checks_share_a_thread() -> None:
    """Otherwise the next test has nothing to look at."""
    assert "phm_checks.peers" in SHARED
    assert Check.blocking


@pytest.mark.parametrize("module", SHARED)
def test_a_check_that_shares_a_thread_asks_nothing_that_may_wait(module: str) -> None:
    """It would delay the others: the Docker Engine, files and devices may not answer for seconds."""
    assert _used(module, set()) <= IN_MEMORY
