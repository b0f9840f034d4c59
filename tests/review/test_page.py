"""The page is one file that needs no network, executes nothing of a record, and shows the swarm immediately."""

from __future__ import annotations

import json
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
    ground.event(50, "presence", agent=1, name=EVIL, presence="alive", was="never received", silent_s=None)
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


def fleet(folder: Path, agents: int) -> dict[str, Any]:
    """An hour of so many agents, with a report every 20 s and two faults each. The log of the first one is that of all."""
    one = Flown(folder / "1")
    one.until(60)
    one.arm(True)
    for at in (900, 2400):
        one.until(at)
        one.fail("nodes/node_1")
    one.until(3500)
    one.arm(False)
    one.until(3600)
    text = one.close().read_text("utf-8")
    head = '"agent":"agent_1","agent_id":1,"boot_id":"boot0001"'
    assert head in text
    for number in range(2, agents + 1):
        other = folder / str(number)
        other.mkdir()
        own = f'"agent":"agent_{number}","agent_id":{number},"boot_id":"boot{number:04d}"'
        (other / "phm.jsonl").write_text(text.replace(head, own), "utf-8")
    return report(folder)


def test_a_page_of_fifty_agents_and_an_hour_has_all_of_them(tmp_path: Path) -> None:
    """Each agent, each fault and the whole hour are in its data."""
    made = fleet(tmp_path, 50)
    data = json.loads(
        re.findall(r'<script type="application/json" id="data">(.*?)</script>', page.render(made), re.DOTALL)[0]
    )
    assert [agent["agent"] for agent in data["agents"]] == [f"agent_{number}" for number in range(1, 51)]
    assert len({plot["agent"] for plot in data["plots"]}) == 50
    assert len(data["faults"]) == 100 and data["window"]["duration_s"] == 3600.0


@pytest.mark.browser
def test_a_browser_shows_fifty_agents_and_an_hour(tmp_path: Path, browser: Any) -> None:
    """Each agent has its row on the canvas and in the tables, each fault its row and mark; nothing went wrong meanwhile."""
    file = tmp_path / "page.html"
    file.write_text(page.render(fleet(tmp_path / "logs", 50)), "utf-8")
    tab = browser.new_page(viewport={"width": 1300, "height": 900})
    said: list[str] = []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.goto(file.as_uri())
    tab.wait_for_selector("html[data-ready=yes]", state="attached")
    assert tab.locator("#faults tbody tr.row").count() == 100
    assert tab.locator("#count").inner_text() == "100 of 100"
    assert tab.locator("#range").inner_text() == "12:00:00 to 13:00:00 UTC, 1 h 00 min"
    assert {f"agent_{number}" for number in range(1, 51)} <= set(
        re.findall(r"agent_\d+", tab.locator("main").inner_text())
    )
    assert tab.locator("#choose option").count() == 51
    assert said == []
    # 24 px above the rows, and 17 px for each if there are more than 24: the level OK fills a line of pixels from 8 to 13.
    height, levels = tab.evaluate(
        """() => {
          const canvas = document.getElementById("time"), ratio = devicePixelRatio, wide = canvas.width - 158 * ratio;
          const ok = getComputedStyle(document.documentElement).getPropertyValue("--ok").trim().slice(1);
          const { data } = canvas.getContext("2d").getImageData(150 * ratio, 0, wide, canvas.height);
          const share = (y) => {
            let found = 0;
            for (let at = 4 * y * wide; at < 4 * (y + 1) * wide; at += 4)
              found += [0, 1, 2].every((place) => data[at + place] === parseInt(ok.slice(2 * place, 2 * place + 2), 16));
            return found / wide;
          };
          return [canvas.height / ratio, Array.from({ length: 50 }, (_, row) => share((24 + 17 * row + 11) * ratio))];
        }"""
    )
    assert height == 24 + 17 * 50 + 6
    assert min(levels) > 0.9, "a row is not filled by its level"
    tab.close()
