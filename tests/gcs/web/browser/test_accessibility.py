"""axe finds no violation of WCAG 2.1 A and AA, in light and in dark, in each part of the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from tests.gcs.web.browser.scene import GroundProcess, a_bad_day, fleet, ground, tab

pytestmark = pytest.mark.browser
RULES = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"], "resultTypes": ["violations"]}
SHOWN = {
    "#/swarm": ".rows .r-unknown",
    "#/agent/A07": "#panel .advice",
    "#/views": "#v-matrix .slot",
    "#/events": "#view-events .log",
}
THEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GroundProcess]:
    """A swarm with agents in each state."""
    folder = tmp_path_factory.mktemp("ground")
    with ground(folder, "--expect", "1-13") as made, fleet(made.mavlink, range(1, 12), 0.5) as agents:
        a_bad_day(agents)
        agents.silent.add(11)
        yield made


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GroundProcess]:
    """Asks for a token."""
    folder = tmp_path_factory.mktemp("locked")
    tokens = folder / "tokens"
    tokens.write_text(f"view: {'v' * 32}\noperate: {'o' * 32}\n")
    tokens.chmod(0o600)
    with ground(folder, "--token-file", str(tokens), "--edit", "config/phm.yaml") as made:
        yield made


def violations(page: Page) -> list[str]:
    """Theme, rule and place of each, in light and in dark: the page follows the browser's setting without another tab."""
    found: list[str] = []
    for theme in THEMES:
        page.emulate_media(color_scheme=theme, reduced_motion="reduce")
        assert page.evaluate(f"matchMedia('(prefers-color-scheme: {theme})').matches")
        for one in Axe().run(page, options=RULES).response["violations"]:
            found += [f"{theme}: {one['id']}: {node['target']} {node['failureSummary'][:200]}" for node in one["nodes"]]
    return found


@pytest.mark.parametrize("place", list(SHOWN))
def test_contrast_names_and_roles(browser: Browser, station: GroundProcess, place: str) -> None:
    """Also at the width of a tablet."""
    with tab(browser, station.url + place, reduced_motion="reduce") as page:
        expect(page.locator(SHOWN[place]).first).to_be_visible()
        assert violations(page) == []
        page.set_viewport_size({"width": 820, "height": 1180})
        assert violations(page) == []


def test_an_open_question(browser: Browser, station: GroundProcess) -> None:
    """Also the dialog that asks before a request is sent."""
    with tab(browser, f"{station.url}#/agent/A07", reduced_motion="reduce") as page:
        page.get_by_role("button", name="approve restart ros_app (#17)").click()
        expect(page.get_by_role("dialog", name="A07: approve")).to_be_visible()
        assert violations(page) == []


@pytest.mark.parametrize("place", ["", "checks"])
def test_the_log_in(browser: Browser, locked: GroundProcess, place: str) -> None:
    """Also with the refusal of a wrong token; of both pages."""
    with tab(browser, locked.url + place, reduced_motion="reduce") as page:
        expect(page.locator("#token")).to_be_visible()
        assert violations(page) == []
        page.locator("#token").fill("x" * 32)
        page.get_by_role("button", name="Log in").click()
        expect(page.get_by_role("alert").filter(has_text="token")).to_be_visible()
        assert violations(page) == []


def test_without_a_connection(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> None:
    """The message about it has contrast, too."""
    with ground(tmp_path_factory.mktemp("gone")) as made, tab(browser, made.url, reduced_motion="reduce") as page:
        expect(page.locator("#link")).to_contain_text("Live")
        made.kill()
        expect(page.locator("#banner")).to_be_visible()
        assert violations(page) == []


def test_a_finger_finds_each_control(browser: Browser, station: GroundProcess) -> None:
    """Buttons, links of the head, fields and rows are at least 44 pixels high."""
    with tab(browser, f"{station.url}#/agent/A07", has_touch=True) as page:
        expect(page.locator(".choices button").first).to_be_visible()
        heights = """() => [...document.querySelectorAll("button, select, input, .top a, .alarms a, .rows .row")]
            .filter((node) => node.checkVisibility()).map((node) => [node.outerHTML.slice(0, 80), node.getBoundingClientRect().height])"""
        assert [one for one in page.evaluate(heights) if one[1] < 43.9] == []
