"""Measure how soon a frame is on the screen, and how smoothly: `python -m tests.gcs.web.latency [--agents N] [--changes N] [--json]`.

From the call that sends a heartbeat, over UDP, `phm gcs --web` and server-sent events, to the frame of headless Chromium after the one
in which the agent's row has changed. All run on one machine and are compared by its clock. The agent sends this heartbeat out of turn.
Frames a second, and the longest time between two, are the browser's own count (requestAnimationFrame) during all changes; the CPU is
that of the server's process.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import psutil
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


COUNT = """() => {
  window.frames_at = [];
  const count = at => { window.frames_at.push(at); requestAnimationFrame(count); };
  requestAnimationFrame(count);
}"""


@dataclass(frozen=True)
class Measured:
    """Of `agents` agents and `changes` changes. In milliseconds: to the screen, and the longest time between two frames. server: percent
    of a core."""

    agents: int
    changes: int
    median_ms: float
    p95_ms: float
    worst_ms: float
    frames_s: float
    longest_frame_ms: float
    server: float


def measure(agents: int, changes: int) -> Measured:
    """Begins when all agents are shown."""
    with (
        tempfile.TemporaryDirectory() as state,
        ground(Path(state)) as station,
        fleet(station.mavlink, range(FIRST, agents + 1)) as swarm,
        chromium() as browser,
        tab(browser, station.url) as page,
    ):
        page.locator(".rows .row").nth(agents - 1).wait_for()
        page.evaluate(WATCH, f"A{FIRST:02d}")
        page.evaluate(COUNT)
        begin_s, used_s = time.monotonic(), _cpu_s(station.pid)
        found: list[float] = []
        for number in range(changes):
            page.wait_for_timeout(PAUSE_S * 1000)
            levels = {Slot.CONTAINER: Level.OK if number % 2 else Level.ERROR}
            swarm.levels[FIRST] = levels
            sent = time.time()
            swarm.vehicles[FIRST].heartbeat(levels, 4)
            found.append(_drawn(page, number) - sent)
        share = 100 * (_cpu_s(station.pid) - used_s) / (time.monotonic() - begin_s)
        return _measured(agents, sorted(found), list(page.evaluate("() => window.frames_at")), share)


def _measured(agents: int, found: list[float], frames_ms: list[float], share: float) -> Measured:
    p95 = statistics.quantiles(found, n=20, method="inclusive")[-1]
    apart = [after - before for before, after in itertools.pairwise(frames_ms)]
    numbers = (
        *(1000 * seconds for seconds in (statistics.median(found), p95, found[-1])),
        1000 * len(apart) / sum(apart),
        max(apart),
        share,
    )
    return Measured(agents, len(found), *(round(number, 1) for number in numbers))


def _cpu_s(pid: int) -> float:
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def _drawn(page: Page, number: int) -> float:
    """UTC seconds of the drawing of this change."""
    page.wait_for_function("number => window.drawn.length > number", arg=number)
    return float(page.evaluate("number => window.drawn[number]", number))


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", type=int, default=100, help="number of agents (default 100)")
    parser.add_argument("--changes", type=int, default=60, help="number of changes (default 60)")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")
    given = parser.parse_args()
    found = measure(given.agents, max(2, given.changes))
    if given.json:
        click.echo(json.dumps(asdict(found)))
        return
    click.echo(
        f"{found.agents} agents, {found.changes} changes: median {found.median_ms:.0f} ms, 95 % {found.p95_ms:.0f} ms, worst "
        f"{found.worst_ms:.0f} ms; {found.frames_s:.1f} frames a second, at most {found.longest_frame_ms:.0f} ms between two; server "
        f"{found.server:.1f} % of a core"
    )


if __name__ == "__main__":
    main()
