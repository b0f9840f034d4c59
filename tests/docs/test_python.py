"""Python and TOML of the documents: it can be parsed, and its names, parameters and entry points exist."""

from __future__ import annotations

import ast
import inspect
import re
from dataclasses import fields
from importlib import import_module
from typing import Any

import pytest

from sitl.simulation.channel_model import Conditions
from sitl.swarm.control import LinkEmulatorClient
from tests.docs.blocks import Block, blocks
from tests.docs.examples import ROOT

INTEROP = "".join(path.read_text("utf-8") for path in sorted((ROOT / "tests" / "interop").rglob("*.py")))
GROUPS = ("phm.checks", "phm.reporters", "phm.actions", "phm.verbs")


@pytest.mark.parametrize("block", blocks("python"), ids=str)
def test_a_python_block_imports_existing_names(block: Block) -> None:
    """It can be parsed, and each name from phm, or from an alias of it, exists."""
    tree = ast.parse(block.text)
    modules: dict[str, Any] = {}
    for node in ast.walk(tree):
        for package, part in foreign(node):
            if package.partition(".")[0] == "mavsdk":  # in .venv-interop: tests/interop runs the same names
                assert part in INTEROP, f"{block}: {part}"
                continue
            modules[package] = import_module(package)
            assert not part or hasattr(modules[package], part), f"{block}: {package}.{part}"
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "phm":
            module = import_module(node.module or "")
            for name in node.names:
                assert hasattr(module, name.name) or import_module(f"{node.module}.{name.name}"), str(block)
                if node.module == "phm":
                    modules[name.asname or name.name] = import_module(f"phm.{name.name}")
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            assert hasattr(modules[node.value.id], node.attr), f"{block}: {node.value.id}.{node.attr}"
        if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("swarm.air."):
            of_air(node, str(block))
    for listed in re.findall(r"# also ([\w, ]+)", block.text):
        assert set(listed.split(", ")) <= {field.name for field in fields(Conditions)}, f"{block}: {listed}"


def foreign(node: ast.AST) -> list[tuple[str, str]]:
    """Module and name, of each import from another project; the name is empty for a module."""
    if isinstance(node, ast.Import):
        return [(name.name, "") for name in node.names]
    if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] != "phm":
        return [(node.module or "", name.name) for name in node.names]
    return []


def of_air(node: ast.Call, place: str) -> None:
    """A call of the client of the link emulator has its parameters; the link has these values."""
    method = getattr(LinkEmulatorClient, ast.unparse(node.func).rpartition(".")[2])
    given = {word.arg or "": ast.literal_eval(word.value) for word in node.keywords}
    inspect.signature(method).bind(None, *map(ast.literal_eval, node.args), **given)
    if method.__name__ == "set":
        Conditions().change(given)
        assert node.args[1].value in ("ground", "peers") or set(given) == {"off"}, place  # type: ignore[attr-defined]


@pytest.mark.parametrize("block", blocks("toml"), ids=str)
def test_an_entry_point_is_of_a_group_that_phm_reads(block: Block) -> None:
    """Its table is one of PHM's groups, and its object is in a block of the page."""
    names = [line.partition(":")[2].rstrip('"') for line in block.text.splitlines() if " = " in line]
    for name in names:  # a class of a block of the same page; a verb is what click calls
        defined = any(f"class {name}(" in other.text for other in blocks("python") if other.page == block.page)
        assert defined or name == "command", f"{block}: no block of the page has {name}"
    heads = [line for line in block.text.splitlines() if line.startswith("[")]
    assert heads and all(any(f'"{group}"' in head for group in GROUPS) for head in heads), str(block)
