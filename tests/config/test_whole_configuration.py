"""Each part of PHM receives its section of the configuration."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "development" / "architecture.md"


def names_settings(source: str) -> bool:
    """Whether a module names `Settings`, the class of the whole configuration."""
    if "Settings" not in source:
        return False  # most modules, without parsing them
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.alias) and node.name.rpartition(".")[2] == "Settings":
            return True
        if isinstance(node, ast.Attribute) and node.attr == "Settings":
            return True
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and re.fullmatch(r"[\w.]*\bSettings", node.value)
        ):
            return True
    return False


def listed() -> list[str]:
    """The modules in the table of the page."""
    table = PAGE.read_text("utf-8").partition("<!-- settings: begin -->")[2].partition("<!-- settings: end -->")[0]
    first = (row.split("|")[1] for row in table.splitlines() if row.startswith("|"))
    return [name for cell in first for name in re.findall(r"`(phm/[\w/]+\.py)`", cell)]


def test_only_the_listed_modules_receive_the_whole_configuration() -> None:
    """docs/development/architecture.md lists each module that names `Settings`, with the reason. Checks are plug-ins."""
    defined = ROOT / "phm" / "core" / "settings" / "__init__.py"
    found = [
        str(path.relative_to(ROOT))
        for path in sorted((ROOT / "phm").rglob("*.py"))
        if path != defined and names_settings(path.read_text("utf-8"))
    ]
    assert sorted(listed()) == found


@pytest.mark.parametrize(
    ("source", "named"),
    [
        ("from phm.core.settings import AgentSettings, Settings", True),
        ("from phm.core.settings import Settings as Everything", True),
        ("from phm.core import settings\ndef build(made: settings.Settings) -> None: ...", True),
        ("def build(made: 'Settings') -> None: ...", True),
        ("def later() -> None:\n    from phm.core.settings import Settings", True),
        ("from phm.core.settings import AgentSettings\nTEXT = 'all Settings'", False),
    ],
)
def test_each_form_of_the_name_is_found(source: str, named: bool) -> None:
    """Imported, renamed, as an attribute, or as text of an annotation."""
    assert names_settings(source) is named
