"""Tests mirror the source tree: where the tests of a package are, and of which package a test is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"

NO_PACKAGE = {
    "docs": "commands, examples and names in docs/ and the README",
    "fakes": "stand-ins and benches that several tests use; no tests",
    "fuzz": "hostile input at each boundary of the daemon, of whatever package",
    "gcs/web/browser": "phm.gcs.web in Chromium: one fixture with a page",
    "interop": "ground software of others",
    "metrics": "metrics of the agent and of the ground station, which Prometheus reads together",
    "packaging": "the wheel, the images and their entry points",
    "probes/docker": "probes that use the Docker Engine, and its client: one fixture with an engine and its containers",
    "probes/links": "probes that use MAVLink links; scripts/test runs them on one Python alone",
    "reporters/durability": "log files of a process that is killed",
    "ros": "phm.probes.ros and phm.beacon with real ROS nodes; its tests without nodes are in probes/ros",
    "system": "a whole agent in containers, or a swarm",
}
"""Folders of tests that are no package, each with what is in it. A folder below one of them needs no entry."""

ELSEWHERE = {
    "phm/facts": "records without behaviour; tested with the probes that make them",
}
"""Packages without a folder of tests, each with where they are tested."""


def packages() -> Iterator[str]:
    """Folders with code, such as `phm/core` and `sitl/faults`."""
    for root in ("phm", "checks/phm_checks", "sitl"):
        for file in (ROOT / root).rglob("__init__.py"):
            yield file.parent.relative_to(ROOT).as_posix()


def folders() -> Iterator[str]:
    """Folders below tests/ with Python files."""
    yield from sorted({file.parent.relative_to(TESTS).as_posix() for file in TESTS.rglob("*.py")} - {"."})


def folder_of(package: str) -> str:
    """Where the tests of a package are, below tests/. A private package has its name without the underscore."""
    known = {"checks/phm_checks": "checks", "sitl": "sitl"}
    for source, tests in known.items():
        if package == source or package.startswith(f"{source}/"):
            return (tests + package[len(source) :]).replace("/_", "/")
    return package.partition("/")[2]


def left_out(folder: str) -> bool:
    return any(folder == name or folder.startswith(f"{name}/") for name in NO_PACKAGE)


def test_each_folder_of_tests_is_that_of_a_package() -> None:
    """One that is not has an entry with what is in it; an entry without a folder is removed."""
    mirrored = {folder_of(package) for package in packages()}
    assert [folder for folder in folders() if folder not in mirrored and not left_out(folder)] == []
    assert [name for name in NO_PACKAGE if not (TESTS / name).is_dir() or name in mirrored] == []


@pytest.mark.parametrize("root", ["phm", "sitl"])
def test_each_package_has_a_folder_of_tests(root: str) -> None:
    """Packages directly below `phm` and `sitl`; those without one have an entry with where they are tested."""
    direct = {package for package in packages() if package.startswith(f"{root}/") and package.count("/") == 1}
    missing = {package for package in direct if not (TESTS / folder_of(package)).is_dir()}
    assert sorted(missing) == sorted(name for name in ELSEWHERE if name.startswith(f"{root}/"))
