"""A large swarm: every agent is shown, and a frame touches only what it changed."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from phm.core.model import Slot
from phm.wire.tunnel import PeerState, PeerView
from tests.gcs.web.browser.scene import ERROR, fleet, ground, tab

pytestmark = pytest.mark.browser
COUNT = 100
ELEMENTS = "document.querySelectorAll('.rows *').length"
"""Of the rows alone: on a busy machine agents are late, and the log of events grows beside them."""
WATCH = """() => { window.changed = new Set(); window.lost = new Set();
  const look = (row) => row.querySelector(".how").textContent === "LOST" && window.lost.add(row.dataset.name);
  document.querySelectorAll(".rows .row").forEach(look);
  new MutationObserver((found) => { for (const one of found) {
    const row = one.target.parentElement?.closest(".row");
    if (row) { look(row); window.changed.add(row.dataset.name + " " + one.target.className); } } })
  .observe(document.querySelector(".rows"), { subtree: true, childList: true, attributes: true, attributeFilter: ["class"] }); }"""


def test_a_hundred_agents(browser: Browser, tmp_path: Path) -> None:
    """All have rows; heartbeats that say nothing new change no cell of a slot; a new fault changes only its own agent."""
    with (
        ground(tmp_path) as station,
        fleet(station.mavlink, range(1, COUNT + 1)) as agents,
        tab(browser, station.url) as page,
    ):
        expect(page.locator(".rows .row")).to_have_count(COUNT)
        expect(page.locator("#counts")).to_contain_text(f"{COUNT} OK")
        nodes = page.evaluate(ELEMENTS)
        page.evaluate(WATCH)
        agents.levels[57] = {Slot.NODES: ERROR}
        expect(page.locator(".row[data-name=A57] .s-6")).to_have_text("ERROR")
        expect(page.locator(".rows .row").first).to_have_attribute("data-name", "A57")
        touched = page.evaluate("[...window.changed].filter((one) => one.includes('slot'))")
        # On a busy machine an agent may be lost for a while: its cells change, too.
        lost = set(page.evaluate("[...window.lost]")) - {"A57"}
        assert {one.split()[0] for one in touched} - lost == {"A57"}
        assert page.evaluate(ELEMENTS) <= nodes + 40


def test_a_matrix_that_would_not_fit_is_named(browser: Browser, tmp_path: Path) -> None:
    """With more agents than it has room for, the two views say so instead of leaving it out."""
    with ground(tmp_path) as station, fleet(station.mavlink, range(1, 26)) as agents:
        agents.views[1] = PeerView(1, True, True, True, {2: PeerState.ALIVE})
        with tab(browser, f"{station.url}#/views") as page:
            expect(page.locator("#v-table tbody tr")).to_have_count(25)
            expect(page.locator("#v-matrix")).to_contain_text("Not shown: there are 25 agents, and room for 24.")
