"""JSON, Python and TOML of the documents: it can be parsed, and its names exist."""

from __future__ import annotations

import ast
import json
from importlib import import_module
from typing import Any

import pytest

from tests.docs.blocks import Block, blocks
from tests.docs.story import play

GROUPS = ("phm.checks", "phm.reporters", "phm.actions", "phm.verbs")


def objects(value: Any) -> list[dict[str, Any]]:
    """All objects in a JSON value."""
    if isinstance(value, list):
        return [found for item in value for found in objects(item)]
    if isinstance(value, dict):
        return [value, *(found for item in value.values() for found in objects(item))]
    return []


@pytest.mark.parametrize("block", blocks("json"), ids=str)
def test_a_json_block_has_the_keys_of_the_code(block: Block) -> None:
    """An event has exactly the keys that the log writes for it."""
    keys = {str(line["event"]): set(line) for line in play().record}
    for found in objects(json.loads(block.text)):
        if "event" in found:
            assert set(found) == keys[found["event"]], str(block)


@pytest.mark.parametrize("block", blocks("python"), ids=str)
def test_a_python_block_imports_existing_names(block: Block) -> None:
    """It can be parsed, and each name from phm, or from an alias of it, exists."""
    tree = ast.parse(block.text)
    modules: dict[str, Any] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "phm":
            module = import_module(node.module or "")
            for name in node.names:
                assert hasattr(module, name.name) or import_module(f"{node.module}.{name.name}"), str(block)
                if node.module == "phm":
                    modules[name.asname or name.name] = import_module(f"phm.{name.name}")
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            assert hasattr(modules[node.value.id], node.attr), f"{block}: {node.value.id}.{node.attr}"


@pytest.mark.parametrize("block", blocks("toml"), ids=str)
def test_an_entry_point_is_of_a_group_that_phm_reads(block: Block) -> None:
    """Its table is one of PHM's groups."""
    heads = [line for line in block.text.splitlines() if line.startswith("[")]
    assert heads and all(any(f'"{group}"' in head for group in GROUPS) for head in heads), str(block)
