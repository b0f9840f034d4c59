"""The page on a phone, 400 px wide."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from tests.fakes.until import until
from tests.gcs.web.browser.scene import fleet, ground, tab

pytestmark = pytest.mark.browser
COUNT = 12


def test_many_alarms_leave_room_for_the_agents(browser: Browser, tmp_path: Path) -> None:
    """When all agents ring, the worst one is still on the screen, and a line of the log has the whole width."""
    with (
        ground(tmp_path) as station,
        fleet(station.mavlink, range(1, COUNT + 1), 0.5) as agents,
        tab(browser, station.url, viewport={"width": 400, "height": 820}) as page,
    ):
        expect(page.locator(".rows .row")).to_have_count(COUNT)
        for number in agents.vehicles:
            agents.say(number, f"A{number:02d} FAIL 11111001 6 planner dead, and a text as long")
        expect(page.locator("#alarms li")).to_have_count(COUNT)
        expect(page.locator("#alarms button").first).to_be_in_viewport()
        expect(page.locator(".rows .row .name").first).to_be_in_viewport(ratio=1)
        page.goto(f"{station.url}#/events")
        # None while the page puts a new line in its place.
        words = until(page.locator(".log li .air").first.bounding_box, "a line", step=lambda: page.wait_for_timeout(50))
        assert words["width"] > 300
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
