"""What `Beacon(node)` costs a node: the same nodes with and without it, at the same time, with PHM's ROS child listening.

``scripts/bench beacon`` starts each number of nodes twice, in two ROS domains: each node a separate process that publishes
10 Hz and listens to its neighbour. The cost is the difference of the CPU time of both, by the kernel's own count in
nanoseconds; the median of slices of a few seconds, since what else the machine does strikes the two unequally.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from phm.probes.ros.protocol import Wanted, encode_wanted
from sitl.bench.ros import ended
from sitl.harness.machine import machine

WARM_S = 8.0
"""Discovery of all nodes, and the first greetings."""
AIM = 0.5
"""Percent of a core for each node."""
AGENT = "bench"
SLICE_S = 3.0


@dataclass(frozen=True)
class BeaconCost:
    """Percent of one core. without, beacon: for each node; quarters: of the slices' values for `beacon`, the first and third
    quarter end there. listener: what PHM's ROS child uses more for all of the beacons together."""

    nodes: int
    without: float
    beacon: float
    quarters: tuple[float, float]
    listener: float


class Group:
    """Nodes in their own ROS domain, and the ROS child that looks at them. Ended with `stack`."""

    def __init__(self, nodes: int, domain: int, stack: ExitStack, *, beacons: bool) -> None:
        environ = {
            "MALLOC_ARENA_MAX": "2",
            "OPENBLAS_NUM_THREADS": "1",
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            **os.environ,
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "ROS_DOMAIN_ID": str(domain),
        }
        self._nodes = [
            subprocess.Popen(node_argv(number, nodes, beacon=beacons), env=environ, stdout=subprocess.DEVNULL)
            for number in range(1, nodes + 1)
        ]
        command = (sys.executable, "-m", "phm.probes.ros.child")
        self._child = subprocess.Popen(command, env=environ, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
        for process in (*self._nodes, self._child):
            stack.enter_context(ended(process))
        assert self._child.stdin is not None
        names = tuple(f"/{AGENT}/node_{number}" for number in range(1, nodes + 1))
        self._child.stdin.write(encode_wanted(Wanted(AGENT, nodes=names)))
        self._child.stdin.flush()

    def used_s(self) -> tuple[float, float]:
        """CPU seconds so far: of all nodes, and of the ROS child. Raises RuntimeError when one of them has ended."""
        for process in (*self._nodes, self._child):
            if process.poll() is not None:
                raise RuntimeError(f"process {process.args!r} ended with code {process.returncode}")
        return sum(cpu_s(process.pid) for process in self._nodes), cpu_s(self._child.pid)


def node_argv(number: int, nodes: int, *, beacon: bool) -> list[str]:
    """Node `number` of 1 to `nodes`; each listens to the one before it, the first to the last."""
    ends = ["--publish", f"topic_{number}:10", "--subscribe", f"topic_{(number - 2) % nodes + 1}"]
    command = [
        sys.executable,
        "-m",
        "sitl.application.node",
        "--name",
        f"node_{number}",
        "--namespace",
        f"/{AGENT}",
        *ends,
    ]
    return command if beacon else [*command, "--no-beacon"]


def cpu_s(pid: int) -> float:
    """On a processor, all threads that live; psutil's figures are in steps of 10 ms. Source: /proc/PID/task/TID/schedstat."""
    return sum(int(file.read_text("ascii").split()[0]) for file in Path(f"/proc/{pid}/task").glob("*/schedstat")) / 1e9


def measure(nodes: int, seconds: float) -> BeaconCost:
    with ExitStack() as stack:
        domain = 20 + 2 * (os.getpid() % 15)
        groups = [Group(nodes, domain + number, stack, beacons=not number) for number in range(2)]
        time.sleep(WARM_S)
        slices = [_slice(groups) for _ in range(max(4, round(seconds / SLICE_S)))]
    plain = [without[0] / nodes for _, without in slices]
    beacons = [(speaking[0] - without[0]) / nodes for speaking, without in slices]
    receiving = [speaking[1] - without[1] for speaking, without in slices]
    first, median, third = statistics.quantiles(beacons, n=4)
    quarters = (round(first, 3), round(third, 3))
    return BeaconCost(nodes, _median(plain), round(median, 3), quarters, _median(receiving))


def _slice(groups: Sequence[Group]) -> list[tuple[float, float]]:
    """Percent of a core that nodes and ROS child of each group use over SLICE_S."""
    before, began_s = [group.used_s() for group in groups], time.monotonic()
    time.sleep(SLICE_S)
    share = 100 / (time.monotonic() - began_s)
    after = [group.used_s() for group in groups]
    return [
        (share * (nodes - nodes_then), share * (child - child_then))
        for (nodes, child), (nodes_then, child_then) in zip(after, before, strict=True)
    ]


def _median(values: Sequence[float]) -> float:
    return round(statistics.median(values), 3)


def table(costs: Sequence[BeaconCost]) -> Table:
    made = Table(title=f"What a beacon costs ({machine()})", caption="percent of a core; aim for a beacon: 0.5 a node")
    for name in ("nodes", "a node without", "its beacon", "half of the slices", "PHM receives all"):
        made.add_column(name, justify="right")
    for cost in costs:
        low, high = cost.quarters
        figures = (f"{cost.without:.2f}", f"{cost.beacon:.2f}", f"{low:.2f} to {high:.2f}", f"{cost.listener:.2f}")
        made.add_row(str(cost.nodes), *figures)
    return made


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/bench beacon", description=__doc__, epilog="Example: scripts/bench beacon --nodes 3 --seconds 60"
    )
    parser.add_argument("--nodes", type=int, nargs="+", default=[3, 10], metavar="N", help="how many nodes (3 10)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="how long each is measured (60)")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    chosen = parser.parse_args(arguments)
    console = Console(stderr=chosen.json)
    costs = []
    for nodes in chosen.nodes:
        with console.status(f"{nodes} nodes with a beacon and {nodes} without"):
            costs.append(measure(nodes, chosen.seconds))
    missed = [cost for cost in costs if cost.beacon > AIM]
    if chosen.json:
        print(json.dumps({"machine": machine(), "aim": AIM, "figures": list(map(asdict, costs))}, indent=2))
    else:
        console.print(table(costs))
        console.print("The aim is met." if not missed else f"Missed with {missed[0].nodes} nodes.")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
