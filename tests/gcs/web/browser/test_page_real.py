"""From the page to a real container: what the operator confirms is done on the agent, and its answer is shown."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from phm.runtime.wiring import build_daemon
from tests.commands.test_restart_real import RUN, started, watching
from tests.fakes.until import until
from tests.gcs.web.browser.scene import ground, tab
from tests.probes.docker.conftest import real as real

pytestmark = pytest.mark.browser


@contextlib.contextmanager
def opened(browser: Browser, folder: Path, container: Any, mode: str) -> Iterator[Page]:
    """The page of agent 7, a real PHM that watches the container as `app`."""
    for name in ("ground", "agent"):
        (folder / name).mkdir()
    with ground(folder / "ground") as station:
        daemon = build_daemon(
            watching(folder / "agent", {"app": container.name}, f"udpout:127.0.0.1:{station.mavlink}", mode)
        )
        daemon.start()
        try:
            with tab(browser, f"{station.url}#/agent/A07") as page:
                expect(page.locator("#panel .layers")).to_contain_text("containers")
                yield page
        finally:
            daemon.stop()


def test_a_restart_from_the_page_restarts_the_container(browser: Browser, real: Any, tmp_path: Path) -> None:
    """The agent accepts, restarts, verifies, and reports the end, which the page shows."""
    container = real.container(RUN)
    before = started(container)
    with opened(browser, tmp_path, container, "act") as page:
        page.get_by_role("button", name="list containers").click()
        page.get_by_role("button", name="restart app").click()
        page.get_by_role("dialog").get_by_role("button", name="Yes, restart").click()
        expect(page.locator(".requests")).to_contain_text("A07 restart app: accepted")
        expect(page.locator("#panel .log")).to_contain_text("A07 OK 2 restart done: app")
    assert started(container) != before


def test_an_approval_from_the_page_starts_the_container(browser: Browser, real: Any, tmp_path: Path) -> None:
    """PHM only advises; nothing is started before the operator has confirmed."""
    container = real.container(RUN)
    with opened(browser, tmp_path, container, "advise") as page:
        container.kill()
        approve = page.get_by_role("button", name="approve start app")
        expect(approve).to_be_visible()
        assert _status(container) == "exited"
        approve.click()
        page.get_by_role("dialog").get_by_role("button", name="Yes, approve").click()
        expect(page.locator(".requests")).to_contain_text("start app: accepted")
        expect(page.locator("#panel .log")).to_contain_text("A07 OK 2 app started")
        until(lambda: _status(container) == "running", "the container")


def _status(container: Any) -> str:
    container.reload()
    return str(container.status)
