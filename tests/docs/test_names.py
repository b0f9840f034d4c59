"""Conditions, actions, kinds and layers in the documents exist in the code, and its messages are quoted correctly."""

from __future__ import annotations

import ast
import re
from functools import cache

import pytest

from phm.checking import registry
from phm.core.model import Layer, Phase
from phm.recovery.base import Action
from phm.reporters.text_log_format import NOTE_KINDS
from tests.docs.blocks import blocks
from tests.docs.examples import ROOT, pages

NAME = re.compile(r"`([a-z]+(?:_[a-z]+)*)`")
KINDS = {*NOTE_KINDS, "SUCCESS", "BYPASS", "WARNING", "FAILURE", "STALE", "RESOLVED", "ESCALATED"}
LOG_LINE = re.compile(r"^(?:[\d-]+ [\d:.]+ ---- )?([A-Z]{3,}): (.*)$")
COMPOSED = frozenset({"diagnostic_warn", "diagnostic_error"})
"""Names that the code makes of two parts."""
LEAST = 7
"""Characters of a message that must be literal in the code for it to count as this message."""


@cache
def constants() -> frozenset[str]:
    """All strings of the code that are one word."""
    return COMPOSED | frozenset(text for text in _strings() if re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", text))


@cache
def messages() -> re.Pattern[str]:
    """All messages of the code as one expression: literals, with any text for inserted values."""
    found: set[str] = set()
    for tree in _trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.JoinedStr):
                parts = [part.value if isinstance(part, ast.Constant) else None for part in node.values]
                literal = sum(len(str(part)) for part in parts if part is not None)
                if literal >= LEAST:
                    found.add("".join(".*?" if part is None else re.escape(str(part)) for part in parts))
    found |= {re.escape(text) for text in _strings() if len(text) >= LEAST and " " in text}
    return re.compile("|".join(sorted(found, key=len, reverse=True)))


def _trees() -> list[ast.Module]:
    paths = [*(ROOT / "phm").rglob("*.py"), *(ROOT / "checks").rglob("*.py")]
    return [ast.parse(path.read_text("utf-8")) for path in paths]


def _strings() -> set[str]:
    return {
        node.value
        for tree in _trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }


WALKED = "docs/guides/write-a-check.md"
"""Its commands are run by `test_walk.py`, which compares the output with the real one."""


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


def quoted() -> list[tuple[str, str, str]]:
    """(place, kind, message) of each log line in blocks that are not generated."""
    found = []
    for block in blocks("text", "console"):
        if not block.generated and block.page != WALKED:
            matches = filter(None, map(LOG_LINE.match, block.text.splitlines()))
            found += [(str(block), match[1], match[2]) for match in matches]
    return found


@pytest.mark.parametrize(("place", "kind", "message"), quoted())
def test_a_quoted_log_line_is_a_message_of_the_code(place: str, kind: str, message: str) -> None:
    """Its kind exists, and its message contains one that the code has."""
    assert kind in KINDS, place
    assert messages().search(message), f"{place}: no message of the code is in {message!r}"


def outputs() -> list[tuple[str, str]]:
    """Each line of output in a console block that is not generated."""
    found = []
    for block in blocks("console"):
        if not block.generated and block.page != WALKED:
            lines = [line for line in block.text.splitlines() if line.strip() and not line.startswith("$ ")]
            found += [(str(block), line) for line in lines]
    return found


@pytest.mark.parametrize(("place", "line"), outputs())
def test_an_output_is_a_message_of_the_code(place: str, line: str) -> None:
    """A line that a console block shows contains a message of the code; single numbers are exit codes."""
    assert line.strip().isdecimal() or messages().search(line), f"{place}: {line!r} is not in the code"


def test_the_layers_are_those_of_the_import_contract() -> None:
    """docs/development/architecture.md lists the layers of pyproject.toml, in their order."""
    contract = (ROOT / "pyproject.toml").read_text("utf-8").partition("layers = [")[2].partition("]")[0]
    wanted = [re.findall(r"\w+", line) for line in contract.splitlines() if line.strip()]
    page = (ROOT / "docs" / "development" / "architecture.md").read_text("utf-8")
    table = page.partition("<!-- layers: begin -->")[2].partition("<!-- layers: end -->")[0]
    rows = [row for row in table.splitlines() if row.startswith("| `")]
    assert [re.findall(r"`(\w+)`", row.split("|")[1]) for row in rows] == wanted
