"""The page's pictures of README and docs can be taken, and show what their captions say."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.docs.pictures import catalog
from tests.gcs.web.browser import pictures

pytestmark = pytest.mark.browser


@pytest.mark.long
def test_the_screenshots_show_what_the_captions_say(browser: Browser, tmp_path: Path) -> None:
    """All of them, by the code that writes those of the documents; `take` reads each page before it takes its picture."""
    folder, state = tmp_path / "pictures", tmp_path / "state"
    folder.mkdir()
    state.mkdir()
    pictures.take(browser, state, folder)
    catalog.check_files(folder, catalog.PAGE)
    assert {path.read_bytes()[:8] for path in folder.iterdir()} == {b"\x89PNG\r\n\x1a\n"}
