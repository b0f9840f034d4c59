"""Rules for all tests: what each needs is marked, and nothing is skipped."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings as hypothesis_settings

ROOT = Path(__file__).resolve().parent
NEEDS = {"system": ("engine", "ros"), "ros": ("ros",), "interop": ("interop",)}
"""What all tests of a folder need; a test elsewhere carries its own mark. `scripts/test` runs those without any of these
marks on every Python of the machine, with no ROS and no engine there."""
SKIPPED_IS_FAILED = "tests were skipped: what a test needs is set up by scripts/test, so a skipped test is a failed one"

# How long one example takes says something about the machine, not about PHM. The same examples in each run of the same code:
# a run that fails says something about the change. New ones are looked for with --hypothesis-profile=explore and scripts/fuzz.
hypothesis_settings.register_profile("phm", deadline=None, derandomize=True, database=None)
hypothesis_settings.register_profile("explore", deadline=None, print_blob=True)
hypothesis_settings.load_profile("phm")


def pytest_configure() -> None:
    """Programs that tests start find no terminal width in their environment, in a terminal as in a pipe."""
    os.environ.pop("COLUMNS", None)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark by folder; in any folder, a file named `test_real_*` or `test_*_real` talks to a real engine."""
    for item in items:
        if ROOT not in item.path.parents:
            continue
        folder, name = item.path.relative_to(ROOT).parts[0], item.path.stem
        for mark in NEEDS.get(folder, ()):
            item.add_marker(mark)
        if "real" in name.split("_"):
            item.add_marker("engine")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """A run in which something was skipped has failed, and says so."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and reporter.stats.get("skipped"):
        reporter.write_line(SKIPPED_IS_FAILED, red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
