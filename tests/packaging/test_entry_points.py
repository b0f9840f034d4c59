"""Files, declared and installed entry points agree; they may differ because the last are fixed at installation."""

from __future__ import annotations

import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest

from phm.api import Check
from phm.checking.registry import ACTIONS, CHECKS, REPORTERS, find
from phm.recovery.base import Action
from phm.reporters.base import Reporter

if sys.version_info >= (3, 11):
    import tomllib
else:  # the same module, before it was part of Python
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
GROUPS: dict[str, type] = {CHECKS: Check, REPORTERS: Reporter, ACTIONS: Action}


def declared(group: str) -> dict[str, str]:
    """Name -> `module:class` as pyproject.toml has it."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        return dict(tomllib.load(file)["project"]["entry-points"][group])


@pytest.mark.parametrize("group", GROUPS)
def test_declared_entry_points_are_installed(group: str) -> None:
    """The installed distribution has exactly the entry points that pyproject.toml declares."""
    points = distribution("phm-sidecar").entry_points.select(group=group)
    assert {point.name: point.value for point in points} == declared(group), "run scripts/venv: the install is old"


@pytest.mark.parametrize("group", GROUPS)
def test_declared_entry_points_can_be_loaded(group: str) -> None:
    """Every declared entry point can be imported, is of the right kind and has its own name."""
    problems = {entry.name: entry.problem for entry in find(group, GROUPS[group]) if entry.name in declared(group)}
    assert set(problems) == set(declared(group))
    assert not any(problems.values()), problems


def test_each_check_file_is_declared() -> None:
    """A file in checks/phm_checks whose name has no leading underscore is one check, with an entry point of its name."""
    files = {path.stem for path in (ROOT / "checks" / "phm_checks").glob("*.py") if not path.stem.startswith("_")}
    assert files == set(declared(CHECKS))
    assert {value.partition(":")[0] for value in declared(CHECKS).values()} == {f"phm_checks.{name}" for name in files}
