"""The page is one file that needs no network, executes nothing of a record, and shows the swarm immediately."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from phm.review import agent_row, page
from phm.review.measurements import GROUPS
from tests.fakes.recorded_flight import FOLDER
from tests.review import raw
from tests.review.records import T0, Flown, Ground, report
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


def test_the_page_has_the_availability_of_everything_and_the_flights(tmp_path: Path) -> None:
    """Also of what was always there; the tables of text have only what was not."""
    made = swarm(tmp_path)
    text = page.render(made)
    rows = data_of(text)["availability"]
    assert len(rows) == len(made["availability"]) and rows[0][3] < 1.0 == rows[-1][3]
    assert ["agent_2", "topic", "topic_1", 1.0, 0.0, 0.0] in rows
    assert "Availability below 100 %" not in text and "<h2>Flights</h2>" in text
    assert f"topic ({len(rows)}), the lowest first" in text


def test_the_page_knows_a_plot_for_each_measurement_of_the_record(tmp_path: Path) -> None:
    """Its groups are those by which the measurements were kept."""
    groups = [tuple(group) for group in data_of(page.render(swarm(tmp_path)))["groups"]]
    assert groups == list(GROUPS) and len({key for key, _, _ in groups}) == len(groups)


def test_a_record_of_several_days_has_dates_and_no_lines_over_the_nights(tmp_path: Path) -> None:
    """Two runs, two days apart; within a run and within a day nothing changes."""
    for number, day_s in enumerate((0.0, 2 * 86400.0)):
        made = Flown(tmp_path, boot=f"boot000{number}", start=day_s)
        made.until(day_s + 100)
        made.close()
        data = data_of(page.render(report(tmp_path)))
        times, values = next(plot["points"] for plot in data["plots"] if plot["agent"] == "agent_1")
        assert (data["dated"], values.count(None), times) == (number > 0, number, sorted(times))
    before, after = values[: values.index(None)], values[values.index(None) + 1 :]
    assert len(before) > 1 and len(after) > 1 and 200 < times[len(before)] < 2 * 86400


def test_faults_that_are_not_listed_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page has a limit, and says what other outputs have all."""
    monkeypatch.setattr(page, "MOST_FAULTS", 2)
    text = page.render(swarm(tmp_path))
    assert "The first 2 of 3 are listed" in text and len(data_of(text)["faults"]) == 2


def data_of(text: str) -> Any:
    return json.loads(text.partition('<script type="application/json" id="data">')[2].partition("</script>")[0])


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
    """An hour of this many agents, with a report every 20 s and two faults each. The log of the first one is that of all."""
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


@contextmanager
def opened_in(browser: Any, made: dict[str, Any], file: Path) -> Iterator[Any]:
    """The page in a tab, ready. Its code has no error until the end, and no text of the record was executed."""
    file.write_text(page.render(made), "utf-8")
    tab, said = browser.new_page(viewport={"width": 1300, "height": 900}), list[str]()
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.goto(file.as_uri())
    tab.wait_for_selector("html[data-ready=yes]", state="attached")
    yield tab
    assert tab.evaluate("window.hit") is None and not said
    tab.close()


@pytest.mark.browser
def test_the_list_of_availability_unfolds_and_is_filtered(tmp_path: Path, browser: Any) -> None:
    """All rows, the lowest first; a hostile name stays text."""
    made = swarm(tmp_path)
    made["availability"][0]["name"] = EVIL
    with opened_in(browser, made, tmp_path / "page.html") as tab:
        rows = tab.locator("#availability tbody tr")
        assert rows.count() == 0
        tab.locator("#available summary").click()
        tab.wait_for_function("() => document.getElementById('count-available').textContent")
        assert rows.count() == len(made["availability"])
        assert "100.000 %" in rows.last.inner_text() and "100.000 %" not in rows.first.inner_text()
        tab.locator("#find-available").fill("agent_2 topic_1")
        assert tab.locator("#count-available").inner_text() == f"1 of {len(made['availability'])}"
        assert rows.first.inner_text().split() == [
            "agent_2",
            "topic",
            "topic_1",
            "100.000",
            "%",
            "0.0",
            "s",
            "0.0",
            "s",
        ]


@pytest.mark.browser
def test_all_measurements_of_one_agent_are_drawn(tmp_path: Path, browser: Any) -> None:
    """70 topics in two plots, and each value of a radio in its own."""
    radio = dict.fromkeys(("rssi", "remrssi", "noise", "remnoise", "margin", "remmargin", "rxerrors_s"), 5.0)
    events = []
    for at in (0, 20, 40):
        events += [raw.unit(at, f"rates/t{number:03d}", hz=float(number)) for number in range(70)]
        events += [raw.unit(at, "radio/gcs", **radio), raw.unit(at, "link/gcs", loss_1_1_percent=3.0)]
    with opened_in(browser, report(raw.write(tmp_path / "log", events)), tmp_path / "page.html") as tab:
        tab.locator("#plots").scroll_into_view_if_needed()
        tab.wait_for_selector("#plots .u-wrap")
        titles = tab.locator("#plots h3").all_inner_texts()
        assert titles[:2] == ["Topic rates (Hz), 1 to 40 of 70", "Topic rates (Hz), 41 to 70 of 70"]
        assert len(titles) == 2 + len(radio) + 1
        assert "Radio, noise at the other end" in titles and "Radio, signal above the noise" in titles


@pytest.mark.browser
def test_the_pointer_says_how_close_changes_are_drawn_as_one(
    tmp_path: Path, browser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the end of a record with more changes than the timeline takes there is a level, and not nothing."""
    monkeypatch.setattr(agent_row, "MOST_SEGMENTS", 100)
    monkeypatch.setattr(agent_row, "LEAST_SEGMENTS", 100)
    names = ("OK", "ERROR")
    events = [raw.change(at, "nodes/n1", names[(at + 1) % 2], names[at % 2]) for at in range(600)]
    made = report(raw.write(tmp_path / "log", [*events, raw.unit(600, "nodes/n1")]))
    assert made["window"]["end"] == T0 + 600
    with opened_in(browser, made, tmp_path / "page.html") as tab:
        box = tab.locator("#time").bounding_box()
        tab.mouse.move(box["x"] + 150 + 0.98 * (box["width"] - 158), box["y"] + 36)
        tab.wait_for_function("() => document.getElementById('tip').textContent.includes('are drawn as one')")
        assert "ERROR for" in tab.locator("#tip").inner_text()
