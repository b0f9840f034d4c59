"""Measure how soon a frame is on the screen: `python -m tests.gcs.web.latency [--agents N] [--changes N]`.

From the call that sends a heartbeat, over UDP, `phm gcs --web` and server-sent events, to the frame of headless Chromium after the one
in which the agent's row has changed. All run on one machine and are compared by its clock. The agent sends this heartbeat out of turn.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import click
from playwright.sync_api import Page

from phm.core.model import Level, Slot
from tests.gcs.web.browser.scene import chromium, fleet, ground, tab

FIRST = 1
PAUSE_S = 1.3
"""Between two changes: not in step with the heartbeats."""
WATCH = """name => {
  const cell = document.querySelector(`.row[data-name=${name}] .how`);
  window.drawn = [];
  new MutationObserver(() => requestAnimationFrame(() => requestAnimationFrame(() => window.drawn.push(Date.now() / 1000))))
    .observe(cell, { childList: true, characterData: true, subtree: true });
}"""


def measure(agents: int, changes: int) -> list[float]:
    """Seconds of each change."""
    with (
        tempfile.TemporaryDirectory() as state,
        ground(Path(state)) as station,
        fleet(station.mavlink, range(FIRST, agents + 1)) as swarm,
        chromium() as browser,
        tab(browser, station.url) as page,
    ):
        page.locator(".rows .row").nth(agents - 1).wait_for()
        page.evaluate(WATCH, f"A{FIRST:02d}")
        found: list[float] = []
        for number in range(changes):
            page.wait_for_timeout(PAUSE_S * 1000)
            levels = {Slot.CONTAINER: Level.OK if number % 2 else Level.ERROR}
            swarm.levels[FIRST] = levels
            sent = time.time()
            swarm.vehicles[FIRST].beat(levels, 4)
            found.append(_drawn(page, number) - sent)
        return found


def _drawn(page: Page, number: int) -> float:
    """UTC seconds of the drawing of this change."""
    page.wait_for_function("number => window.drawn.length > number", arg=number)
    return float(page.evaluate("number => window.drawn[number]", number))


def main() -> None:
    """Print the median, the 95th percentile and the worst."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", type=int, default=100, help="number of agents (default 100)")
    parser.add_argument("--changes", type=int, default=60, help="number of changes (default 60)")
    given = parser.parse_args()
    found = sorted(measure(given.agents, max(2, given.changes)))
    p95 = statistics.quantiles(found, n=20, method="inclusive")[-1]
    click.echo(
        f"{given.agents} agents, {len(found)} changes: median {statistics.median(found) * 1000:.0f} ms, "
        f"95 % {p95 * 1000:.0f} ms, worst {found[-1] * 1000:.0f} ms"
    )


if __name__ == "__main__":
    main()
