"""The page is one file that needs no network, executes nothing of a record, and shows the swarm at once."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.review import page
from tests.fakes.recorded_flight import FOLDER
from tests.review.records import Flown, Ground, report
from tests.review.test_document import one_flight

EVIL = "</script><script>window.hit = 1</script><img src=x onerror='window.hit = 1'>"
CHROMIUM = "/usr/bin/chromium"


def swarm(folder: Path) -> dict[str, Any]:
    """Two agents and the ground; one agent has hostile text."""
    one_flight(folder / "a", 1).close()
    second = Flown(folder / "b", 2)
    second.until(60)
    second.note(EVIL)
    second.fail("nodes/node_1", brief=EVIL)
    second.until(500)
    second.close()
    ground = Ground(folder / "ground.jsonl")
    ground.event(50, "presence", agent=1, name=EVIL, presence="alive", was="never heard", silent_s=None)
    ground.event(200, "presence", agent=1, name=EVIL, presence="lost", was="alive", silent_s=6.0)
    ground.event(260, "presence", agent=1, name=EVIL, presence="alive", was="lost", silent_s=None)
    ground.close()
    return report(folder)


def test_the_page_refers_to_nothing_outside_and_permits_only_its_own_code(tmp_path: Path) -> None:
    """Its policy names digests, and no element loads anything."""
    text = page.render(swarm(tmp_path))
    assert re.search(r"default-src &#39;none&#39;; script-src &#39;sha256-[\w+/=]+&#39;; style-src &#39;sha256-", text)
    assert not re.findall(
        r"<(?:link|img|iframe|object|embed)\b|<script[^>]*\bsrc=|url\(|@import", text.partition("<script")[0]
    )
    assert "unsafe-inline" not in text and "<script>window.hit" not in text


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as programs:
        made = programs.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield made
        made.close()


@pytest.mark.browser
def test_a_browser_shows_it_without_a_request_and_without_a_violation(tmp_path: Path, browser: Any) -> None:
    """A real one: timeline, faults with their lines, plots; hostile text stays text."""
    file = tmp_path / "page.html"
    file.write_text(page.render(swarm(tmp_path)), "utf-8")
    tab = browser.new_page(viewport={"width": 1300, "height": 900})
    requests: list[str] = []
    said: list[str] = []
    tab.on("request", lambda request: requests.append(request.url))
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.goto(file.as_uri())
    tab.wait_for_selector("html[data-ready=yes]", state="attached")
    rows = tab.locator("#faults tbody tr.row")
    assert rows.count() == 3
    rows.nth(0).click()
    detail = tab.locator("#faults tr.more").inner_text()
    assert EVIL in detail and "restart verified" in detail
    tab.locator("#find").fill("container/ros_app")
    assert tab.locator("#count").inner_text() == "1 of 3"
    tab.locator("#plots").scroll_into_view_if_needed()
    tab.wait_for_selector("#plots .u-wrap")
    whole = tab.locator("#range").inner_text()
    tab.locator("#in").click()
    tab.wait_for_function("before => document.getElementById('range').textContent !== before", arg=whole)
    assert tab.evaluate("window.hit") is None
    assert (requests, said) == ([file.as_uri()], [])
    tab.close()


@pytest.mark.browser
def test_entries_of_other_records_are_marks_with_their_text(tmp_path: Path, browser: Any) -> None:
    """The pointer on a ring in the row of the vehicle shows what its autopilot recorded; hostile text stays text."""
    made = report(FOLDER / "dataflash_flight.bin.gz")
    rows, window = made["other"]["rows"], made["window"]
    row = next(row for row in rows if row["text"] == "LAND")
    row["text"] = EVIL
    file = tmp_path / "page.html"
    file.write_text(page.render(made), "utf-8")
    tab = browser.new_page(viewport={"width": 1300, "height": 900})
    tab.goto(file.as_uri())
    tab.wait_for_selector("html[data-ready=yes]", state="attached")
    box = tab.locator("#time").bounding_box()
    share = (row["t"] - window["begin"]) / window["duration_s"]
    tab.mouse.move(box["x"] + 150 + share * (box["width"] - 158), box["y"] + 36)
    tab.wait_for_function("text => document.getElementById('tip').textContent.includes(text)", arg=f"mode: {EVIL}")
    assert tab.evaluate("window.hit") is None
    tab.close()
