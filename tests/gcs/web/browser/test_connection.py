"""The page says immediately that its server is gone, trusts nothing meanwhile, and returns by itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Route, expect

from tests.fakes.until import until
from tests.gcs.web.browser.scene import GroundProcess, fleet, ground, tab

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GroundProcess]:
    """Without agents, and not changed by a test."""
    with ground(tmp_path_factory.mktemp("alone")) as made:
        yield made


def test_a_killed_server_is_shown_and_its_return_needs_no_hand(browser: Browser, tmp_path: Path) -> None:
    """Ages are unknown while it is gone; a new server at the same address is used without a reload."""
    with ground(tmp_path) as station, fleet(station.mavlink, [1, 2], 0.5), tab(browser, station.url) as page:
        row = page.locator(".row[data-name=A02]")
        expect(row.locator(".how")).to_have_text("OK")
        expect(page.locator("#link")).to_contain_text("Live")
        page.evaluate("window.stays = true")
        station.kill()
        expect(page.get_by_role("alert").filter(has_text="No connection to the server")).to_be_visible()
        expect(page.locator("#link")).to_have_text("\u2715 No connection")
        expect(row.locator(".age")).to_have_text("?")
        station.start()
        expect(page.locator("#link")).to_contain_text("Live")
        expect(page.locator("#banner")).to_be_hidden()
        expect(row.locator(".age")).to_contain_text(" s")
        expect(row.locator(".how")).to_have_text("OK")
        assert page.evaluate("window.stays")


@pytest.mark.parametrize("file", ["**/js/live.js", "**/js/main.js", "**/css/page.css"])
def test_a_page_of_which_a_file_did_not_load_is_loaded_again(browser: Browser, alone: GroundProcess, file: str) -> None:
    """A browser ends all requests when the network of its computer changes; without its modules the page could not say so."""
    failures = 2

    def fail(route: Route) -> None:
        nonlocal failures
        failures -= 1
        if failures >= 0:
            route.abort("internetdisconnected")
        else:
            route.continue_()

    with tab(browser, "about:blank") as page:
        page.route(file, fail)
        page.goto(alone.url)
        until(lambda: failures < 0, f"the third request of {file}", step=lambda: page.wait_for_timeout(50))
        expect(page.locator("#link")).to_contain_text("Live")


def test_a_token_is_asked_for_and_its_role_decides(browser: Browser, tmp_path: Path) -> None:
    """A wrong token is refused in words; with the role view no request is offered."""
    tokens = tmp_path / "tokens"
    tokens.write_text("view: " + "v" * 32 + "\noperate: " + "o" * 32 + "\n")
    tokens.chmod(0o600)
    with (
        ground(tmp_path, "--token-file", str(tokens)) as station,
        fleet(station.mavlink, [1], 0.5),
        tab(browser, station.url) as page,
    ):
        page.get_by_label("Token").fill("x" * 32)
        page.get_by_role("button", name="Log in").click()
        expect(page.locator(".problem")).not_to_be_empty()
        assert page.locator(".rows .row").count() == 0
        page.get_by_label("Token").fill("v" * 32)
        page.get_by_role("button", name="Log in").click()
        page.locator(".row[data-name=A01]").click()
        expect(page.locator(".choices")).to_contain_text("its role is view")
        assert page.locator(".choices button").count() == 0
        page.get_by_role("button", name="Log out").click()
        expect(page.get_by_label("Token")).to_be_visible()
