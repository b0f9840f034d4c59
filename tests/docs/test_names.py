"""Conditions, actions, phases and layers in the documents exist in the code."""

from __future__ import annotations

import re
from functools import cache
from typing import get_args

import pytest

from phm.checking import registry
from phm.core.model import Layer, Phase
from phm.core.settings.mavlink import EndpointSettings
from phm.core.settings.recovery import ManualStopSettings
from phm.recovery.base import Action
from tests.docs.examples import ROOT, pages
from tests.docs.messages import texts

NAME = re.compile(r"`([a-z]+(?:_[a-z]+)*)`")
COMPOSED = frozenset({"diagnostic_warn", "diagnostic_error"})
"""Names that the code makes of two parts."""


@cache
def constants() -> frozenset[str]:
    """All strings of the code that are one word."""
    return COMPOSED | frozenset(text for text in texts() if re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", text))


def cells(header: str) -> list[tuple[str, str]]:
    """(place, cell) of each table column with this header."""
    found = []
    for page in pages():
        column: int | None = None
        for number, line in enumerate(page.read_text("utf-8").splitlines(), 1):
            if not line.startswith("|"):
                column = None
                continue
            row = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            if column is None:
                column = row.index(header) if header in row else -1
            elif column >= 0 and not set(line) <= set("|-: "):
                found.append((f"{page.relative_to(ROOT)}:{number}", row[column]))
    return found


@pytest.mark.parametrize("header", ["condition", "action"])
def test_names_in_tables_exist(header: str) -> None:
    """Each name in such a column is a string of the code."""
    unknown = [(place, name) for place, cell in cells(header) for name in NAME.findall(cell) if name not in constants()]
    assert unknown == []


def test_each_action_is_described() -> None:
    """docs/reference/recovery.md names every installed action, and `docs` no phase that does not exist."""
    text = (ROOT / "docs" / "reference" / "recovery.md").read_text("utf-8")
    base: type = Action
    for found in registry.find(registry.ACTIONS, base):
        assert re.search(rf"\b{found.name}\b", text), f"{found.name} is not described"
    logs = (ROOT / "docs" / "reference" / "logs.md").read_text("utf-8")
    assert [phase for phase in Phase if f"`{phase.value}`" not in logs] == []
    assert [layer for layer in Layer if f"`{layer.value}`" not in logs] == []


def test_the_rules_of_a_manual_stop_are_those_of_the_configuration() -> None:
    """The table of `recovery.on_manual_stop` lists exactly the values that the configuration accepts."""
    text = (ROOT / "docs" / "reference" / "recovery.md").read_text("utf-8")
    table = text.split("| rule | alarm | action | default |", 1)[1].split("\n\n", 1)[0]
    described = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    assert sorted(described) == sorted(get_args(ManualStopSettings.model_fields["ground"].annotation))


def test_each_value_of_leads_to_is_in_the_guide() -> None:
    """The table of the guide lists exactly the values that the configuration accepts."""
    text = (ROOT / "docs" / "guides" / "get-started.md").read_text("utf-8")
    table = text.split("| `leads_to` | at the other end |", 1)[1].split("\n\n", 1)[0]
    described = re.findall(r"^\| `(\w+)`", table, re.MULTILINE)
    assert sorted(described) == sorted(get_args(EndpointSettings.model_fields["leads_to"].annotation))


def test_the_layers_are_those_of_the_import_contract() -> None:
    """docs/development/architecture.md lists the layers of pyproject.toml, in their order."""
    contract = (ROOT / "pyproject.toml").read_text("utf-8").partition("layers = [")[2].partition("]")[0]
    wanted = [re.findall(r"\w+", line) for line in contract.splitlines() if line.strip()]
    page = (ROOT / "docs" / "development" / "architecture.md").read_text("utf-8")
    table = page.partition("<!-- layers: begin -->")[2].partition("<!-- layers: end -->")[0]
    rows = [row for row in table.splitlines() if row.startswith("| `")]
    assert [re.findall(r"`(\w+)`", row.split("|")[1]) for row in rows] == wanted
