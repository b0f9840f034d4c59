"""Rules for all tests: their requirements are marked, and nothing is skipped."""

from __future__ import annotations

import gc
import os
import re
import signal
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings as hypothesis_settings

ROOT = Path(__file__).resolve().parent
NEEDS = {"system": ("engine", "ros"), "ros": ("ros",), "interop": ("interop",)}
"""What all tests of a folder need; a test elsewhere carries its own mark. `scripts/test` runs those without any of these
marks on other Pythons, too, with no ROS and no engine there."""
NEED_MARKS = ("engine", "ros", "packaging", "interop")
IN_TEXT = re.compile(rf"pytest\.mark\.({'|'.join(NEED_MARKS)})\b")
SKIPPED_IS_FAILED = "tests were skipped: what a test needs is set up by scripts/test, so a skipped test is a failed one"
SKIPPED_CODE = 8
"""Exit code of such a run, which none of pytest's own are: `scripts/test` makes no second attempt then."""

# The duration of one example depends on the machine, not on PHM. Equal code has equal examples in each run, so that
# a failure is caused by a change. --hypothesis-profile=explore and scripts/fuzz search for new ones.
hypothesis_settings.register_profile("phm", deadline=None, derandomize=True, database=None)
hypothesis_settings.register_profile("explore", deadline=None, print_blob=True)
hypothesis_settings.load_profile("phm")


def pytest_configure() -> None:
    """Give the programs that tests start the same terminal width in a terminal and in a pipe, and Ctrl-C also where the shell has
    started the tests in the background, which then ignore it and all that they start."""
    os.environ.pop("COLUMNS", None)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.disable()  # what is collected here stays until the end


def pytest_collection_finish() -> None:
    """From here on, garbage is collected, without a look at the millions of objects that are not."""
    gc.freeze()
    gc.enable()


@cache
def _marks(path: Path) -> tuple[str, ...]:
    """The marks of all tests of a file, by its place and name."""
    if ROOT not in path.parents:
        return ()
    engine = ("engine",) if "real" in path.stem.split("_") else ()
    return (*NEEDS.get(path.relative_to(ROOT).parts[0], ()), *engine)


@cache
def _may_need(path: Path) -> bool:
    """Whether a test of this file can have one of these marks: by its place or name, or since its text has one."""
    return bool(_marks(path)) or IN_TEXT.search(path.read_text("utf-8")) is not None


def pytest_addoption(parser: pytest.Parser) -> None:
    """Reading all files costs each process 19 s of CPU time, those with the tests of an engine 3 s."""
    parser.addoption("--marked-files", action="store_true", help="read only files whose tests may need something")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files for `--marked-files`."""
    skipped = config.getoption("marked_files", default=False) and collection_path.name.startswith("test_")
    return True if skipped and collection_path.suffix == ".py" and not _may_need(collection_path) else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark by directory; in any directory, a file named `test_real_*` or `test_*_real` uses a real engine.

    With `--dist loadgroup` (scripts/test), a file is a group, and tests that are marked `long` come first and alone.
    """
    for item in items:
        for mark in _marks(item.path):
            item.add_marker(mark)
        if not _may_need(item.path) and any(map(item.get_closest_marker, NEED_MARKS)):
            raise pytest.UsageError(
                f"{item.nodeid}: write its mark as `pytest.mark.NAME` in this file, or --marked-files skips it"
            )
    if getattr(config.option, "loadgroup", False):
        items.sort(key=lambda item: item.get_closest_marker("long") is None)
        for item in items:
            if item.get_closest_marker("long") is None:
                item.add_marker(pytest.mark.xdist_group(item.path.relative_to(ROOT).as_posix()))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a run in which something was skipped, with a message."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and reporter.stats.get("skipped"):
        reporter.write_line(SKIPPED_IS_FAILED, red=True)
        session.exitstatus = SKIPPED_CODE
