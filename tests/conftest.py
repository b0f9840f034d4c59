"""Rules for all tests: what each needs is marked, and nothing is skipped."""

from __future__ import annotations

import pytest

SKIPPED_IS_FAILED = "tests were skipped: what a test needs is set up by scripts/test, so a skipped test is a failed one"


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """A run in which something was skipped has failed, and says so."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and reporter.stats.get("skipped"):
        reporter.write_line(SKIPPED_IS_FAILED, red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
