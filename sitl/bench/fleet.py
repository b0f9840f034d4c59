"""What a fleet over Zenoh costs and how soon the ground knows: many simulated agents, one router, one machine.

``scripts/bench fleet`` starts the agents in a few processes, each agent with the real reporter and its own Zenoh
session, the router (a session in mode router, with a higher limit of sessions) in another, and reads as any client would.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass

import psutil
from rich.console import Console
from rich.table import Table

from phm.wire.fleet_status import FleetStatus
from sitl.harness.machine import machine
from sitl.simulation.fleet_agents import Crowd
from sitl.simulation.fleet_router import Ground, Router, free_port

FLEET = "bench"
PROCESSES = 4
LIMIT_S = 120.0
CHANGES, MIN_AGENTS = 200, 250
SPACING_S = 0.2
"""Between two changes within one process."""
_COUNTED = re.compile(r"\bbytes_(sent|received):(\d+)")


@dataclass(frozen=True)
class Figure:
    """aim: at most this; None: measured only."""

    name: str
    unit: str
    value: float
    aim: float | None = None

    @property
    def met(self) -> bool:
        return self.aim is None or self.value <= self.aim


class Bench:
    """The agents of one run; each method measures one thing, in this order."""

    def __init__(self, agents: int, stack: ExitStack) -> None:
        self._agents, self._stack, self._port = agents, stack, free_port()
        self._latencies: dict[tuple[str, str], float] = {}
        self._router = self._new_router()
        self.ground = Ground(self._router.endpoint, FLEET, self._seen)
        stack.callback(self.ground.close)
        self._crowds: list[Crowd] = []

    def alone(self, seconds: float) -> Iterator[Figure]:
        """One agent in a separate process: what the fleet adds to a PHM."""
        crowd = Crowd(self._router.endpoint, FLEET, 1_000_000, 1)
        try:
            self.ground.wait(lambda ground: len(ground.statuses) == 1 and len(ground.tokens) == 1)
            crowd.ready()
            time.sleep(2)
            before, began = crowd.report(), time.monotonic()
            time.sleep(seconds)
            after = crowd.report()
            cpu = 100 * (after["cpu_s"] - before["cpu_s"]) / (time.monotonic() - began)
            yield Figure("one agent: CPU", "% of a core", cpu, 1.0)
            yield Figure(
                "one agent: memory that the fleet adds", "MB", (after["rss"] - after["rss_before"]) / 1e6, 40.0
            )
            yield Figure("one status", "bytes", self.ground.payload_bytes / self.ground.messages)
        finally:
            crowd.kill()
        self.ground.wait(lambda ground: not ground.tokens)
        self.ground.statuses.clear()

    def start(self) -> Iterator[Figure]:
        """Start all processes together, until the ground knows all agents and their presence."""
        share, began = self._agents // PROCESSES, time.monotonic()
        for number in range(PROCESSES):
            count = share if number else self._agents - share * (PROCESSES - 1)
            crowd = Crowd(self._router.endpoint, FLEET, number * self._agents, count)
            self._stack.callback(crowd.kill)
            self._crowds.append(crowd)
        self.ground.wait(self._all, LIMIT_S)
        yield Figure("all start together: until all are known", "s", time.monotonic() - began, 30.0)
        for crowd in self._crowds:
            crowd.ready()

    def late(self) -> Iterator[Figure]:
        """A reader that comes when all are there."""
        began = time.monotonic()
        late = Ground(self._router.endpoint, FLEET)
        try:
            late.wait(self._all, LIMIT_S)
            yield Figure("a reader comes late: until all are known", "s", time.monotonic() - began, 5.0)
        finally:
            late.close()

    def idle(self, seconds: float) -> Iterator[Figure]:
        """Nothing changes: refreshes, and Zenoh's own signs of life."""
        router = psutil.Process(self._router.process.pid)
        before = (self._cpu_s(router), self._bytes(), [crowd.report() for crowd in self._crowds], self.ground.messages)
        began = time.monotonic()
        time.sleep(seconds)
        took_s = time.monotonic() - began
        reports = [crowd.report() for crowd in self._crowds]
        sent, received = (now - then for now, then in zip(self._bytes(), before[1], strict=True))
        agents_s = sum(new["cpu_s"] - old["cpu_s"] for new, old in zip(reports, before[2], strict=True))
        yield Figure("idle: statuses at the ground", "a second", (self.ground.messages - before[3]) / took_s)
        yield Figure("idle: each agent to the router, TCP payload", "bytes/s", received / took_s / self._agents)
        yield Figure("idle: the router to all, TCP payload", "kB/s", sent / took_s / 1000)
        yield Figure("idle: router, CPU", "% of a core", 100 * (self._cpu_s(router) - before[0]) / took_s, 50.0)
        yield Figure("idle: router, RSS", "MB", router.memory_info().rss / 1e6, 500.0)
        yield Figure("idle: each agent, CPU", "% of a core", 100 * agents_s / took_s / self._agents)
        yield Figure("idle: each agent, RSS", "MB", sum(report["rss"] for report in reports) / 1e6 / self._agents)

    def changes(self) -> Iterator[Figure]:
        """Single agents break one after another, in all processes; then all the others together."""
        few = CHANGES // PROCESSES
        self._latencies.clear()
        for crowd in self._crowds:
            crowd.tick(range(few), SPACING_S)
        self._wait_for(PROCESSES * few)
        yield from self._quantiles("one change", 0.5)
        self._latencies.clear()
        rest = [range(few, len(crowd.names)) for crowd in self._crowds]
        for crowd, numbers in zip(self._crowds, rest, strict=True):
            crowd.tick(numbers)
        count = sum(map(len, rest))
        self._wait_for(count)
        yield from self._quantiles(f"{count} changes together", 5.0)

    def router_again(self) -> Iterator[Figure]:
        """The router is killed, and a new one is there after five seconds."""
        self._router.kill()
        self.ground.wait(lambda ground: not ground.tokens)
        self.ground.statuses.clear()
        time.sleep(5)
        self._router = self._new_router()
        yield Figure("router back: until all are known", "s", self.ground.wait(self._all, LIMIT_S), 30.0)

    def killed(self) -> Iterator[Figure]:
        """A process of agents is killed."""
        crowd = self._crowds[0]
        began = time.monotonic()
        crowd.process.kill()
        self.ground.wait(lambda ground: len(ground.tokens) == self._agents - len(crowd.names))
        gone = sorted(at - began for at in self.ground.gone.values() if at > began)
        yield Figure(f"{len(gone)} agents killed: until the last is missed", "s", gone[-1], 5.0)

    def _all(self, ground: Ground) -> bool:
        return len(ground.tokens) == len(ground.statuses) == self._agents

    def _new_router(self) -> Router:
        router = Router(self._port, sessions=self._agents + 100)
        self._stack.callback(router.kill)
        return router

    def _seen(self, status: FleetStatus) -> None:
        for fault in status.faults:
            word, _, at = str(fault.get("brief")).partition(" ")
            if word == "at":
                self._latencies.setdefault((status.agent, at), time.monotonic() - float(at))

    def _wait_for(self, count: int) -> None:
        self.ground.wait(lambda _: len(self._latencies) >= count, LIMIT_S)

    def _quantiles(self, name: str, aim: float) -> Iterator[Figure]:
        seen = sorted(self._latencies.values())
        yield Figure(f"{name}: until seen, median", "s", seen[len(seen) // 2])
        yield Figure(f"{name}: until seen, 95 %", "s", seen[int(len(seen) * 0.95)], aim)
        yield Figure(f"{name}: until seen, worst", "s", seen[-1])

    def _bytes(self) -> tuple[int, int]:
        """Sent and received by the router on all of its connections, as the kernel counts."""
        words = ("ss", "-tinH", "state", "established", f"sport = :{self._port}")
        found = _COUNTED.findall(subprocess.run(words, check=True, capture_output=True, text=True, timeout=30).stdout)
        sums = {name: sum(int(number) for kind, number in found if kind == name) for name in ("sent", "received")}
        return sums["sent"], sums["received"]

    @staticmethod
    def _cpu_s(process: psutil.Process) -> float:
        return sum(process.cpu_times()[:2])


@contextmanager
def bench(agents: int) -> Iterator[Bench]:
    with ExitStack() as stack:
        yield Bench(agents, stack)


def measure(agents: int, seconds: float, console: Console) -> list[Figure]:
    figures: list[Figure] = []
    with bench(agents) as made:
        steps = (
            made.alone(seconds),
            made.start(),
            made.late(),
            made.idle(seconds),
            made.changes(),
            made.router_again(),
            made.killed(),
        )
        for step in steps:
            for figure in step:
                figures.append(figure)
                console.print(f"{figure.name}: {figure.value:.3g} {figure.unit}", style="dim")
    return figures


def table(agents: int, figures: Sequence[Figure]) -> Table:
    made = Table(title=f"{agents} agents over Zenoh, all on {machine()}")
    for name in ("figure", "aim", "value"):
        made.add_column(name, justify="left" if name == "figure" else "right")
    for figure in figures:
        value = f"[{'green' if figure.met else 'red'}]{figure.value:.3g}[/]"
        made.add_row(f"{figure.name} [dim]{figure.unit}[/]", "" if figure.aim is None else f"<= {figure.aim:g}", value)
    return made


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/bench fleet", description=__doc__, epilog="Example: scripts/bench fleet --agents 250"
    )
    parser.add_argument("--agents", type=int, default=1000, metavar="N", help="how many, 250 or more (1000)")
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="how long cost is measured (20)")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    chosen = parser.parse_args(arguments)
    if chosen.agents < MIN_AGENTS:
        parser.error(
            f"at least {MIN_AGENTS} agents are needed: {CHANGES} change one after another, and the others together"
        )
    console = Console(stderr=chosen.json)
    figures = measure(chosen.agents, chosen.seconds, console)
    missed = [figure.name for figure in figures if not figure.met]
    if chosen.json:
        rows = [asdict(figure) for figure in figures]
        print(json.dumps({"machine": machine(), "agents": chosen.agents, "missed": missed, "figures": rows}, indent=2))
    else:
        console.print(table(chosen.agents, figures))
        console.print("All aims are met." if not missed else f"Missed: {'; '.join(missed)}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
