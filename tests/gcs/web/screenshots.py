"""Write the pictures of README and docs: `python -m tests.gcs.web.screenshots`. A real ground station, real frames, a real browser."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Page

from tests.gcs.web.browser.scene import ROOT, a_bad_day, chromium, fleet, ground, tab

FOLDER = ROOT / "docs" / "pictures"
DOCKED, WIDE, LOW = {"width": 1310, "height": 620}, {"width": 1240, "height": 640}, {"width": 1100, "height": 560}
SETTLE_MS = 3000


def main(folder: Path) -> None:
    """Write each picture into this folder."""
    with (
        tempfile.TemporaryDirectory() as state,
        ground(Path(state)) as station,
        fleet(station.mavlink, range(1, 13)) as agents,
        chromium() as browser,
    ):
        with tab(browser, station.url, viewport=WIDE, color_scheme="light") as page:
            page.locator(".rows .row").nth(11).wait_for()
            page.wait_for_timeout(SETTLE_MS)
            a_bad_day(agents)
            page.wait_for_timeout(20_000)
            agents.silent.add(11)
            page.locator(".row[data-name=A11].r-lost").wait_for()
            page.wait_for_timeout(SETTLE_MS)
            _write(page, folder / "web-swarm.png")
        with tab(browser, f"{station.url}#/agent/A07", viewport=DOCKED, color_scheme="dark") as page:
            page.locator(".path").wait_for()
            page.wait_for_timeout(SETTLE_MS)
            _write(page, folder / "web-agent.png")
        with tab(browser, f"{station.url}#/views", viewport=LOW, color_scheme="light") as page:
            page.wait_for_timeout(SETTLE_MS)
            _write(page, folder / "web-views.png")
        with tab(browser, f"{station.url}#/events", viewport=LOW, color_scheme="dark") as page:
            page.wait_for_timeout(SETTLE_MS)
            _write(page, folder / "web-events.png")


def checks(folder: Path) -> None:
    """Write the picture of the Checks page."""
    with (
        tempfile.TemporaryDirectory() as state,
        ground(Path(state), "--edit", "config/phm.yaml") as station,
        chromium() as browser,
        tab(browser, f"{station.url}checks", viewport=WIDE, color_scheme="light") as page,
    ):
        page.get_by_label("Type of a new entry of custom").select_option("tcp")
        page.get_by_role("button", name="Add to custom").click()
        for key, text in (("name", "planner"), ("host", "127.0.0.1"), ("port", "80800")):
            field = page.locator(f'[data-key="custom[0].{key}"] input')
            field.fill(text)
            field.press("Tab")
        page.locator('[data-key="custom[0].port"] .problem', has_text="65535").wait_for()
        page.locator("#diff .added", has_text="80800").wait_for()
        page.evaluate("scrollTo(0, 0)")
        _write(page, folder / "web-checks.png")


def _write(page: Page, path: Path) -> None:
    page.screenshot(path=path)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
    checks(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
