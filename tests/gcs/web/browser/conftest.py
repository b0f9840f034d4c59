"""One browser for the tests of this folder that run one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from tests.gcs.web.browser.scene import LIMIT_MS, chromium

expect.set_options(timeout=LIMIT_MS)
FOLDER = Path(__file__).parent


class Shared:
    """A Chromium that is started when a test needs it: a start costs as much CPU as a tab. Each test has its own context in it."""

    def __init__(self) -> None:
        self._opened: AbstractContextManager[Browser] | None = None
        self._browser: Browser | None = None

    def get(self) -> Browser:
        if self._browser is not None and not self._browser.is_connected():  # it hung, and `tab` killed it
            self.close()
        if self._browser is None:
            self._opened = chromium()
            self._browser = self._opened.__enter__()
        return self._browser

    def close(self) -> None:
        opened, self._opened, self._browser = self._opened, None, None
        if opened is not None:
            opened.__exit__(None, None, None)


SHARED = Shared()


@pytest.fixture
def browser() -> Browser:
    return SHARED.get()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(nextitem: pytest.Item | None) -> Iterator[None]:
    """Close it before a test of another folder: while playwright runs, no other event loop can run in this thread."""
    try:
        yield
    finally:
        if nextitem is None or FOLDER not in nextitem.path.parents:
            SHARED.close()
