"""PHM under load: the same faults quiet, at 1, 2 and 4 runnable threads per core, and with half a core.

``scripts/bench load`` expects nothing and prints, for each load and fault, how soon it was detected, which alarms and actions there were, and how late
PHM's heartbeats came meanwhile. Recovery is on. About 10 minutes; no trial begins after ``--minutes``, each takes at most three.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from rich.console import Console
from rich.table import Table

from sitl.acceptance.plan import configuration
from sitl.bench.starvation import Trial, end_on_signal
from sitl.bench.starvation_rows import Row, cells
from sitl.faults import all_faults
from sitl.faults._cgroups import update
from sitl.faults._overload import end_overload, overload
from sitl.faults.base import Agent, Fault
from sitl.harness.compose_stack import Stack
from sitl.harness.config_overrides import write
from sitl.harness.console import make_console
from sitl.harness.log_follower import Event
from sitl.harness.machine import machine
from sitl.simulation.ground import Ground

FAULTS = ("container_killed", "node_killed", "topic_silent")
HALF = "half a core"
LOADS = {"quiet": 0, "1 per core": 1, "2 per core": 2, "4 per core": 4, HALF: 0}
"""Runnable threads per core, each in a container of the default weight that PHM does not know."""
UP_LIMIT_S, HEALTHY_LIMIT_S, RECOVERED_LIMIT_S = 150.0, 60.0, 60.0
SETTLE_S = 5.0
AFTER_S = 5.0
HOG_S = SETTLE_S + RECOVERED_LIMIT_S + 2 * AFTER_S + 30.0
HALF_US, PERIOD_US = 50_000, 100_000
HEARTBEAT_S = 2.0
"""PHM's period for so few agents."""
FAVOURED = 262_144
"""CPU shares of the simulated autopilot, through which heartbeats reach this program: what is late shall be PHM."""


@dataclass(frozen=True)
class Measured:
    """One fault under one load. late_s: the most that a heartbeat of PHM came after its period; None: fewer than two came."""

    load: str
    row: Row
    late_s: float | None


class Heartbeats:
    """When those of PHM came at the ground, in seconds of the monotonic clock."""

    def __init__(self, url: str) -> None:
        self.times: list[float] = []
        self.ground = Ground(url, on_frame=self._take)
        self.ground.start()

    def _take(self, at: float, message: Any) -> None:
        if message.get_type() == "HEARTBEAT" and message.get_srcComponent() != 1:
            self.times.append(at)

    def late_s(self, since: float, until: float) -> float | None:
        """The longest gap that touches this time, less the period."""
        return late_s(self.times, since, until)


def late_s(times: list[float], since: float, until: float) -> float | None:
    """The longest gap between heartbeats that touches [since, until], less the period; one that is still open counts, too.

    None when there was no heartbeat at all before `until`.
    """
    before = [at for at in times if at < until]
    ends = [*before, until]
    gaps = [later - earlier for earlier, later in pairwise(ends) if later > since]
    return max(0.0, max(gaps) - HEARTBEAT_S) if before and gaps else None


@contextlib.contextmanager
def burdened(agent: Agent, load: str) -> Iterator[None]:
    """The load, until the block ends."""
    threads = LOADS[load] * (os.cpu_count() or 1)
    try:
        if load == HALF:
            for container in (agent.sidecar, agent.app):
                update(container, "--cpu-period", str(PERIOD_US), "--cpu-quota", str(HALF_US))
        if threads:
            overload(agent, lasts_s=HOG_S, loops_per_core=LOADS[load], hogs=threads, weight=1024)
        yield
    finally:
        end_overload(agent)
        if load == HALF:
            for container in (agent.sidecar, agent.app):
                update(container, "--cpu-quota", "-1")


def measure(trial: Trial, fault: Fault, load: str, heartbeats: Heartbeats) -> Measured:
    """Inject the fault under the load, and wait until PHM has verified its recovery."""
    agent = trial.stack.agent
    row = Row(fault.name, fault.title, list(fault.places(agent)), fault.healable)
    mark, began = trial.mark(), time.monotonic()

    def verified(event: Event) -> bool:
        return bool(event["event"] == "action" and event["phase"] == "verified" and event["unit"] == row.expected[0])

    try:
        with burdened(agent, load):
            trial.watch(SETTLE_S)
            moment = fault.inject(agent)
            trial.record.wait(verified, RECOVERED_LIMIT_S, since=mark)
            trial.watch(AFTER_S)
            late = heartbeats.late_s(began, time.monotonic())
    finally:
        fault.clear(agent)
    row.read(trial.record.events[mark:], moment)
    row.judge()
    return Measured(load, row, late)


def run(stack: Stack, console: Console, loads: list[str], minutes: float) -> list[Measured]:
    """Every fault under every load, for as long as there is time to begin."""
    found, until = [], time.monotonic() + 60 * minutes
    trial, faults = Trial(stack, console), all_faults()
    if not trial.wait_healthy(UP_LIMIT_S):
        raise RuntimeError(f"the agent did not become OK within {UP_LIMIT_S:g} s; see {stack.logs}")
    autopilot = stack.agent.container("autopilot")
    update(autopilot, "--cpu-shares", str(FAVOURED))
    port = autopilot.attrs["NetworkSettings"]["Ports"]["5760/tcp"][0]["HostPort"]
    heartbeats = Heartbeats(f"tcp:127.0.0.1:{port}")
    for load in loads:
        for name in FAULTS:
            if time.monotonic() > until:
                console.print(f"[yellow]not measured[/]: {name}, {load}: {minutes:g} minutes are over")
                continue
            if not trial.wait_healthy(HEALTHY_LIMIT_S):
                console.print(f"[yellow]not everything is OK before[/] {name}, {load}")
            found.append(measure(trial, faults[name], load, heartbeats))
            console.print(f"  {' | '.join(table_cells(found[-1]))}", highlight=False)
    heartbeats.ground.stop()
    return found


def table_cells(measured: Measured) -> tuple[str, ...]:
    row = measured.row
    alarms, actions, _ = cells(row)
    detected, late = ("-" if value is None else f"{value:.1f} s" for value in (row.detected_s, measured.late_s))
    return measured.load, row.title, detected, alarms.partition(" after")[0], actions, late


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/bench load", description=__doc__)
    parser.add_argument(
        "--only", nargs="+", choices=LOADS, default=list(LOADS), metavar="LOAD", help=f"of {', '.join(LOADS)}"
    )
    parser.add_argument("--minutes", type=float, default=15.0, metavar="M", help="begin no trial after this time (15)")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    chosen = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, end_on_signal)
    console = Console(stderr=True) if sys.stderr.isatty() else make_console(json=True)
    config = write(configuration())
    stack = Stack(project="phm-bench-load", interval_s=3.0, ground_port=0, extra={"PHM_CONFIG": str(config)})
    try:
        stack.up()
        found = run(stack, console, chosen.only, chosen.minutes)
    finally:
        stack.down()
    if chosen.json:
        rows = [{"load": each.load, "late_s": each.late_s, **asdict(each.row)} for each in found]
        print(json.dumps({"machine": machine(), "rows": rows}, indent=2))
        return 0
    table = Table(title=f"PHM under load ({machine()})")
    for name in ("load", "fault", "detected", "alarms", "actions", "heartbeat late"):
        table.add_column(name)
    for each in found:
        table.add_row(*table_cells(each))
    make_console(json=False).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
