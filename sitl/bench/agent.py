"""Figures of one agent on this machine: how soon a fault is logged, and what the sidecar costs.

``scripts/bench`` expects nothing and prints medians with their spread. PHM's recovery is off while it is measured, so
that each fault starts from the same state; the faults are undone from outside.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from sitl.faults.base import Agent, mono_of
from sitl.faults.node_killed import Injection as NodeKilled
from sitl.harness.compose_stack import Stack
from sitl.harness.config_overrides import overridden, write
from sitl.harness.log_follower import Event
from sitl.harness.machine import machine, processes
from sitl.harness.stack_monitor import StackMonitor

SEEN_LIMIT_S = 30.0


@dataclass(frozen=True)
class Figure:
    """Measured values of one kind, in `unit`; `limit` is the aim."""

    name: str
    unit: str
    limit: float
    values: tuple[float, ...]

    @property
    def median(self) -> float:
        return statistics.median(self.values)


class Bench:
    """Measures on a stack that is up."""

    def __init__(self, stack: Stack, console: Console) -> None:
        self.stack, self.console = stack, console
        self.monitor = StackMonitor(stack)

    def repeat(self, name: str, limit_s: float, runs: int, once: Callable[[], float]) -> Figure:
        values = []
        for number in range(1, runs + 1):
            with self.console.status(f"{name}: run {number} of {runs}"):
                self.monitor.wait_ok()
                values.append(once())
        return Figure(name, "s", limit_s, tuple(values))

    def container_death(self) -> float:
        app = self.stack.agent.app
        mark = self.monitor.mark()
        app.kill()
        app.reload()
        seen = self._seen(mark, "container/ros_app")["mono"] - mono_of(app.attrs["State"]["FinishedAt"])
        app.start()
        return float(seen)

    def node_death(self) -> float:
        mark = self.monitor.mark()
        agent = self.stack.agent
        moment = NodeKilled().inject(agent)
        seen = self._seen(mark, f"nodes/{self.stack.agent_name}/node_1")["mono"] - moment
        agent.app.restart(timeout=3)
        return float(seen)

    def cost(self, seconds: float, samples: int) -> tuple[Figure, Figure]:
        """CPU (percent of one core) and RSS (MB) of all of PHM's processes together, sampled `samples` times."""
        cpu, memory = [], []
        for _ in range(samples):
            before, began = _cpu_s(self.stack.agent), time.monotonic()
            time.sleep(seconds / samples)
            cpu.append(100 * (_cpu_s(self.stack.agent) - before) / (time.monotonic() - began))
            memory.append(sum(process.memory_info().rss for process in processes(self.stack.agent)) / 1e6)
        return Figure("sidecar, CPU", "% of a core", 5.0, tuple(cpu)), Figure(
            "sidecar, RSS", "MB", 140.0, tuple(memory)
        )

    def _seen(self, mark: int, unit: str) -> Event:
        event = self.monitor.record.wait(
            lambda event: event["event"] == "fault_opened" and event["unit"] == unit, SEEN_LIMIT_S, since=mark
        )
        if event is None:
            raise RuntimeError(f"{unit} was not seen within {SEEN_LIMIT_S:g} s; see {self.stack.logs}")
        return event


def _cpu_s(agent: Agent) -> float:
    return sum(sum(process.cpu_times()[:2]) for process in processes(agent))


def print_figures(figures: list[Figure], console: Console) -> None:
    table = Table(title=f"PHM beside the demo application ({machine()})")
    for name in ("figure", "aim", "median", "min", "max", "runs"):
        table.add_column(name, justify="left" if name == "figure" else "right")
    for entry in figures:
        met = "green" if entry.median <= entry.limit else "red"
        values = (f"[{met}]{entry.median:.2f}[/]", f"{min(entry.values):.2f}", f"{max(entry.values):.2f}")
        table.add_row(f"{entry.name} [dim]{entry.unit}[/]", f"<= {entry.limit:g}", *values, str(len(entry.values)))
    console.print(table)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/bench", description=__doc__, epilog="Example: scripts/bench --runs 5"
    )
    parser.add_argument("--runs", type=int, default=10, metavar="N", help="faults of each kind (10)")
    parser.add_argument("--cost-seconds", type=float, default=60.0, metavar="S", help="how long cost is sampled (60)")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    chosen = parser.parse_args(arguments)
    console = Console(stderr=chosen.json)
    observing = write(overridden({"\n  mode: act": "\n  mode: off"}))
    stack = Stack(project="phm-bench", interval_s=3.0, ground_port=0, extra={"PHM_CONFIG": str(observing)})
    try:
        with console.status("starting the agent"):
            stack.up()
        bench = Bench(stack, console)
        bench.monitor.wait_ok()
        figures = list(bench.cost(chosen.cost_seconds, 6))
        figures.append(bench.repeat("container death to log line", 0.3, chosen.runs, bench.container_death))
        figures.append(bench.repeat("node killed to log line", 2.0, chosen.runs, bench.node_death))
    finally:
        stack.down()
    if chosen.json:
        rows = [
            {"name": f.name, "unit": f.unit, "aim": f.limit, "median": f.median, "values": f.values} for f in figures
        ]
        print(json.dumps({"machine": machine(), "figures": rows}, indent=2))
    else:
        print_figures(figures, console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
