"""A recorded flight on the same page, with its controls."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from tests.fakes.until import until
from tests.gcs.web.browser.scene import fleet, ground, tab
from tests.gcs.web.replay.test_web_replay import flight

pytestmark = pytest.mark.browser


def test_a_record_is_shown_on_the_same_page(browser: Browser, tmp_path: Path) -> None:
    """The head has the moment of the flight and its speed, and the record is played to its end."""
    record = tmp_path / "flight.jsonl"
    with ground(tmp_path, "--record", str(record)) as station, fleet(station.mavlink, [1, 2], 0.5) as agents:
        until(lambda: record.exists() and record.read_text().count('"slots"') >= 2, "the record")
        agents.say(2, "A02 FAIL 11111011 6 planner dead")
        until(lambda: "planner dead" in record.read_text(), "the line in the record")
    folder = tmp_path / "replay"
    folder.mkdir()
    with ground(folder, "--replay", str(record)) as station, tab(browser, station.url) as page:
        bar = page.get_by_role("region", name="Replay")
        expect(bar).to_be_visible()
        bar.get_by_label("Speed").select_option("4")
        expect(bar.get_by_role("slider")).to_be_enabled()
        expect(page.locator(".row[data-name=A02] .line")).to_contain_text("planner dead")


def test_pause_a_jump_and_plots(browser: Browser, tmp_path: Path) -> None:
    """Paused, the moment is the same; a jump shows the state and the faults of its moment; an agent's levels are plotted."""
    record = tmp_path / "flight.jsonl"
    flight(record)
    with ground(tmp_path, "--replay", str(record), "--speed", "0.1") as station, tab(browser, station.url) as page:
        bar = page.get_by_role("region", name="Replay")
        bar.get_by_role("button", name="Pause").click()
        expect(bar.get_by_role("button", name="Play")).to_be_visible()
        slider = bar.get_by_role("slider")
        begin = float(slider.get_attribute("min") or 0)
        state = page.locator(".row[data-name=A07] .how")
        for seconds, words in ((45, "ERROR"), (20, "OK"), (45, "ERROR")):
            slider.fill(str(round(begin) + seconds))
            expect(state).to_contain_text(words)
            until(
                lambda wanted=begin + seconds: abs(float(slider.input_value()) - wanted) < 3,  # type: ignore[misc]
                "the slider",
                step=lambda: page.wait_for_timeout(50),
            )
        page.locator(".row[data-name=A07]").get_by_role("button").first.click()
        expect(page.locator("#panel figcaption").filter(has_text="worst level")).to_contain_text("3")
        expect(page.locator("#panel .fault")).to_contain_text("ros_app exited 1")
        expect(page.locator("#panel .ended")).to_have_count(0)
        slider.fill(str(round(begin) + 110))
        expect(page.locator("#panel .ended")).to_contain_text("action")
