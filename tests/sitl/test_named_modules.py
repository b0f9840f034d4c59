"""Compose files, scripts, code and documents refer only to existing modules and files of `sitl`."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted(
    path
    for folder in ("docker", "scripts", "docs", "sitl", ".")
    for path in (ROOT / folder).glob("*" if folder == "." else "**/*")
    if path.is_file()
    and path.name != "CHANGELOG.md"
    and path.suffix in ("", ".py", ".yaml", ".md")
    and "locks" not in path.parts
)
MODULE = re.compile(r"""(?:-m\s+|"-m",\s+"|-\s+)(sitl(?:\.\w+)*)\b""")
PATH = re.compile(r"(?<!tests/)\bsitl/[\w/]+\.py\b")


def _named(pattern: re.Pattern[str]) -> list[str]:
    return sorted({name for path in FILES for name in pattern.findall(path.read_text("utf-8"))})


@pytest.mark.parametrize("name", _named(MODULE))
def test_a_module_named_after_m_can_be_run(name: str) -> None:
    """A package needs a `__main__`."""
    spec = importlib.util.find_spec(name)
    assert spec is not None
    if spec.submodule_search_locations:
        assert importlib.util.find_spec(f"{name}.__main__") is not None


@pytest.mark.parametrize("name", _named(PATH))
def test_a_named_file_exists(name: str) -> None:
    """Also as a path of the image, /opt/app/sitl/..."""
    assert (ROOT / name).is_file()
