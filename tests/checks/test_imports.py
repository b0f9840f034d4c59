"""The checks are written against `phm.api` alone, as those of a plug-in are."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

CHECKS = Path(__file__).resolve().parents[2] / "checks" / "phm_checks"
ALLOWED = "phm.api"


def imported(source: str) -> set[str]:
    """The modules of phm that a module imports, also within functions and under TYPE_CHECKING."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module == "phm":
            found |= {f"phm.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(str(node.module))
    return {name for name in found if name.partition(".")[0] == "phm"}


@pytest.mark.parametrize(
    "path", [pytest.param(path, id=str(path.relative_to(CHECKS))) for path in sorted(CHECKS.rglob("*.py"))]
)
def test_a_check_imports_the_api_alone(path: Path) -> None:
    """Every import of phm in a check is `phm.api`."""
    assert imported(path.read_text("utf-8")) <= {ALLOWED}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("from phm.api import Check", {"phm.api"}),
        ("from phm import api", {"phm.api"}),
        ("from phm import api, doctor", {"phm.api", "phm.doctor"}),
        ("import phm.review.times as times", {"phm.review.times"}),
        ("import phm", {"phm"}),
        ("from phm.learn import baseline", {"phm.learn"}),
        ("def later() -> None:\n    from phm.setup import report", {"phm.setup"}),
        ("from phm.api.inner import anything", {"phm.api.inner"}),
        ("from . import _text\nimport phmother\nimport phm_checks.nodes", set()),
    ],
)
def test_each_form_of_an_import_is_found(source: str, expected: set[str]) -> None:
    """An import counts in whatever form and wherever it is written."""
    assert imported(source) == expected
