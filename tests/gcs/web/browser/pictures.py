"""The page's pictures of README and docs: a real `phm gcs --web`, real frames of a swarm with faults, a real browser.

`tests.docs.pictures` writes them to docs/pictures, and `test_pictures` takes them into a temporary folder.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Literal

from playwright.sync_api import Browser, FloatRect, Locator, Page, ViewportSize, expect

from tests.docs.pictures import catalog
from tests.fakes.until import until
from tests.gcs.web.browser.scene import LIMIT_MS, Fleet, GroundProcess, a_bad_day, fleet, ground, tab

AGENTS = range(1, 10)
LOST = 8
MARGIN_PX = 8
WIDTH_PX, TALL_PX = 1310, 1000


def take(browser: Browser, state: Path, folder: Path) -> None:
    """Write each picture into `folder`. Raises AssertionError where the page does not show what its caption says.

    state: an empty folder for the ground stations.
    """
    expect.set_options(timeout=LIMIT_MS)
    for name in ("swarm", "checks"):
        (state / name).mkdir()
    with ground(state / "swarm") as station, fleet(station.mavlink, AGENTS) as agents:
        _swarm(browser, station, agents, folder)
        _agent(browser, station, folder)
        _views(browser, station, folder)
        _events(browser, station, folder)
    _checks(browser, state / "checks", folder)


def _swarm(browser: Browser, station: GroundProcess, agents: Fleet, folder: Path) -> None:
    with _open(browser, station.url, WIDTH_PX, "light") as page:
        rows = page.locator(".rows .row")
        expect(rows).to_have_count(len(AGENTS))
        a_bad_day(agents)
        expect(page.locator(".row[data-name=A07] .s-2")).to_have_text("ERROR")
        expect(page.locator(".row[data-name=A09] .s-8")).to_have_text("WARN")
        agents.silent.add(LOST)
        expect(page.locator(f".row[data-name=A{LOST:02d}] .how")).to_have_text("LOST")
        expect(rows.nth(2)).to_have_attribute("data-name", f"A{LOST:02d}")
        _shoot(page, folder, "web-swarm.png", page.locator(".legend"))


def _agent(browser: Browser, station: GroundProcess, folder: Path) -> None:
    with _open(browser, f"{station.url}#/agent/A07", WIDTH_PX, "dark") as page:
        expect(page.locator("#panel .fault .steps")).to_contain_text("advised")
        _shoot(page, folder, "web-agent.png", page.locator("#panel section", has_text="Open faults"))


def _views(browser: Browser, station: GroundProcess, folder: Path) -> None:
    with _open(browser, f"{station.url}#/views", WIDTH_PX, "light") as page:
        expect(page.locator("#v-table")).to_contain_text("the swarm receives it, the ground does not")
        _shoot(page, folder, "web-views.png", page.locator("#v-table"))


def _events(browser: Browser, station: GroundProcess, folder: Path) -> None:
    with _open(browser, f"{station.url}#/events", WIDTH_PX, "dark") as page:
        log = page.locator("#view-events .log li")
        page.get_by_label("At least").select_option("warn")
        expect(log.filter(has_text="A02 FAIL")).to_have_count(1)
        _shoot(page, folder, "web-events.png", log.last)


def _checks(browser: Browser, state: Path, folder: Path) -> None:
    with (
        ground(state, "--edit", "config/phm.yaml") as station,
        _open(browser, f"{station.url}checks", WIDTH_PX, "light") as page,
    ):
        expect(page.locator("#state")).to_contain_text("not changed, valid")  # what is done before that is lost
        page.get_by_label("Type of a new entry of custom").select_option("tcp")
        page.get_by_role("button", name="Add to custom").click()
        for key, text in (("name", "planner"), ("host", "127.0.0.1"), ("port", "80800")):
            field = page.locator(f'[data-key="custom[0].{key}"] input')
            field.fill(text)
            field.press("Tab")
        problem = page.locator('[data-key="custom[0].port"] .problem', has_text="65535")
        expect(problem).to_be_visible()
        expect(page.locator("#diff .added", has_text="80800")).to_be_visible()
        page.evaluate("scrollTo(0, 0)")
        _shoot(page, folder, "web-checks.png", problem)


def _open(browser: Browser, url: str, width: int, theme: Literal["dark", "light"]) -> AbstractContextManager[Page]:
    size: ViewportSize = {"width": width, "height": TALL_PX}
    return tab(browser, url, viewport=size, color_scheme=theme, reduced_motion="reduce")


def _shoot(page: Page, folder: Path, name: str, last: Locator) -> None:
    """Take the page down to the lower end of `last`, at most TALL_PX, once the page shows all texts of the picture."""
    until(
        lambda: _shows(name, page.locator("body").inner_text()),
        f"the texts of {name}",
        lambda: page.locator("body").inner_text(),
    )
    box = until(last.bounding_box, f"the end of {name}")  # none while the page puts a new line in its place
    # Cut where agents were late on a busy machine, and the log has many more lines than on one that rests.
    low = min(box["y"] + box["height"] + MARGIN_PX, TALL_PX)
    size = page.viewport_size
    assert size is not None
    page.screenshot(path=folder / name, clip=FloatRect(x=0, y=0, width=size["width"], height=low))


def _shows(name: str, shown: str) -> bool:
    catalog.check_private(name, shown)
    return not catalog.missing(name, shown)
