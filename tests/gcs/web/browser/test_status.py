"""`phm status --web` in a browser: the page of one agent, as an operator starts it on the agent's own computer."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from tests.fakes.mavlink import free_port
from tests.fakes.until import until
from tests.gcs.web.browser.scene import ROOT, tab
from tests.gcs.web.test_agent_page import document

pytestmark = pytest.mark.browser
HOSTILE = "<img src=x onerror=alert(1)>"
WRITE_S = 0.2


class Computer:
    """An agent's computer: a daemon that writes its status all the time, and `phm status --web` beside it."""

    def __init__(self, folder: Path) -> None:
        self._folder, self.port = folder, free_port()
        self.changes: dict[str, Any] | None = {}
        self._stop = threading.Event()
        self._write()
        self._thread = threading.Thread(target=self._loop, name="test-status", daemon=True)
        self._thread.start()
        self.start_page()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def _serves(self) -> bool:
        assert self._process.poll() is None
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 5):
            return True
        return False

    def _loop(self) -> None:
        while not self._stop.wait(WRITE_S):
            self._write()

    def _write(self) -> None:
        if self.changes is None:
            (self._folder / "status.json").unlink(missing_ok=True)
            return
        temporary = self._folder / "new"
        temporary.write_text(json.dumps(document(**self.changes)))
        temporary.replace(self._folder / "status.json")

    def start_page(self) -> None:
        options = ["--web", str(self.port), "--history", str(self._folder / "history.db")]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "phm.cli", "status", "--run-dir", str(self._folder), *options],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'checks'}"},
        )
        until(self._serves, "the page")

    def end_page(self) -> None:
        self._process.kill()
        self._process.wait(120)

    def close(self) -> None:
        self._stop.set()
        self._thread.join(120)
        self.end_page()


@pytest.fixture
def computer(tmp_path: Path) -> Iterator[Computer]:
    made = Computer(tmp_path)
    yield made
    made.close()


@pytest.fixture
def page(browser: Browser, computer: Computer) -> Iterator[Page]:
    with tab(browser, computer.url) as made:
        expect(made.locator("#panel h2")).to_have_text("A07")
        yield made


def test_the_agent_is_open_and_its_checks_have_reasons(page: Page) -> None:
    """Without a click: the broken hop, the failed unit, and what it blocks; nothing that only a ground station has."""
    expect(page.locator("#title")).to_have_text("PHM agent")
    expect(page.locator("#panel header .state")).to_have_text("ERROR")
    line = page.locator("#panel .layers li", has_text="nodes/agent_1/node_1").first
    expect(line.locator(".slot")).to_have_text("ERROR")
    expect(page.locator("#panel .layers")).to_contain_text("blocked by nodes/agent_1/node_1")
    for absent in ("#tab-views", "#tab-checks", "#logout"):
        expect(page.locator(absent)).to_be_hidden()
    expect(page.locator("#panel .choices button")).to_have_count(0)
    rules = Axe().run(page).response["violations"]
    assert [f"{rule['id']}: {node['target']}" for rule in rules for node in rule["nodes"]] == []


def test_changes_and_the_end_of_the_daemon_are_shown(page: Page, computer: Computer) -> None:
    """Live, with the reason; hostile text stays text; without the server the page says that what it shows is old."""
    checks = document()["checks"]
    computer.changes = {"checks": [{**checks[0], "summary": HOSTILE, "level": "WARN"}]}
    expect(page.locator("#panel .layers")).to_contain_text(HOSTILE)
    expect(page.locator("#panel header .state")).to_have_text("WARN")
    assert page.locator("#panel img").count() == 0
    computer.changes = {"alive": False}
    expect(page.locator("#panel header .state")).to_have_text("LOST")
    computer.changes = None
    expect(page.locator(".rows .row")).to_have_count(1)
    computer.changes = {}
    expect(page.locator("#panel header .state")).to_have_text("ERROR")
    computer.end_page()
    expect(page.locator("#banner")).to_contain_text("No connection to the server")


def test_events_faults_and_plots_are_there_after_a_restart(browser: Browser, page: Page, computer: Computer) -> None:
    """Also those that are over, in a browser that opens the page for the first time."""
    fault = page.locator("#panel .fault", has_text="nodes/agent_1/node_1")
    expect(fault).to_be_visible()
    expect(page.locator("#panel .plots figcaption", has_text="CPU")).to_be_visible()
    computer.changes = {"faults": {"open": [], "given_up": [], "closed": []}}
    expect(page.locator("#panel .fault.ended")).to_be_visible()
    computer.end_page()
    computer.start_page()
    with tab(browser, computer.url) as again:
        expect(again.locator("#panel .fault.ended", has_text="nodes/agent_1/node_1")).to_be_visible()
        expect(again.locator("#panel .plots figcaption", has_text="CPU")).to_contain_text("%")
        expect(again.locator("#panel .log")).to_contain_text("fault ended")
        expect(again.locator("#panel")).not_to_contain_text("once requested")
