"""Where PHM's memory, CPU time and wake-ups go, for each process, thread and import.

`scripts/bench footprint` measures every PHM that runs on this machine, in containers too, and changes nothing. With several agents
the figures are means of one agent. `scripts/bench footprint imports` measures imports in separate processes.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import psutil
from rich.console import Console
from rich.table import Table

from sitl.bench import footprint_proc
from sitl.harness.machine import machine

ROLES = {"daemon": "run", "ROS child": "phm.probes.ros.child", "watchdog": "watchdog.py"}
IMPORTED = {
    "daemon": ("phm.cli.run", "phm.runtime.configuration", "phm.runtime.service"),
    "ROS child": ("phm.probes.ros.child", "phm.probes.ros.observer"),
    "watchdog": ("phm.core.watchdog",),
}
SHOWN = 25


def agents(pids: Sequence[int] = ()) -> list[dict[str, int]]:
    """The processes of each PHM on this machine by role; pids: of these daemons alone."""
    found = []
    for process in psutil.process_iter(["cmdline"]):
        words = process.info["cmdline"] or []
        if not (process.pid in pids if pids else _is_daemon(words)):
            continue
        roles = {"daemon": process.pid}
        for child in process.children():
            line = " ".join(child.cmdline())
            roles |= {role: child.pid for role, word in ROLES.items() if role != "daemon" and word in line}
        found.append(roles)
    return found


def _is_daemon(words: Sequence[str]) -> bool:
    """`python .../phm run ...` or `python -m phm.cli run ...`; an init that started it is not meant."""
    if not words or "python" not in os.path.basename(words[0]):
        return False
    pairs = zip(map(os.path.basename, words), words[1:], strict=False)
    return any(name in ("phm", "phm.cli") and verb == "run" for name, verb in pairs)


def measure(running: Sequence[Mapping[str, int]], seconds: float) -> dict[str, Any]:
    """Means over the agents: memory and CPU by process and in all, and each thread by process and name. An agent of which a process
    ends meanwhile is left out. Raises ValueError if none is left, or one cannot be measured by this user."""
    costs = footprint_proc.threads([pid for roles in running for pid in roles.values()], seconds)
    by_role: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    by_thread: dict[tuple[str, str], list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
    alone, count = [], 0
    for roles in running:
        try:
            memory = {role: footprint_proc.memory(pid) for role, pid in roles.items()}
            size = footprint_proc.together(roles.values())
        except PermissionError:
            raise ValueError("a PHM here belongs to another user: run this as root") from None
        except OSError:
            continue
        count += 1
        alone += [size / 1e6] if size is not None else []
        for role, pid in roles.items():
            for name, value in _row(memory[role], costs[pid]).items():
                by_role[role][name].append(value)
            for cost in costs[pid]:
                entry = by_thread[role, cost.name]
                for at, value in enumerate((cost.wakeups, cost.cpu, 1)):
                    entry[at] += value
    if not count:
        raise ValueError("no PHM ran for the entire time")
    return {
        "machine": machine(),
        "agents": count,
        "seconds": seconds,
        "processes": {
            role: {name: statistics.mean(values) for name, values in row.items()} for role, row in by_role.items()
        },
        "alone_mb": statistics.mean(alone) if alone else None,
        "threads": [
            {"process": role, "thread": name, "wakeups": a / count, "cpu": b / count, "count": c / count}
            for (role, name), (a, b, c) in sorted(by_thread.items(), key=lambda item: -item[1][0])
        ],
    }


def _row(memory: footprint_proc.Memory, costs: Sequence[footprint_proc.ThreadCost]) -> dict[str, float]:
    return {
        "pss_mb": memory.pss / 1e6,
        "rss_mb": memory.rss / 1e6,
        "private_mb": memory.anonymous / 1e6,
        "threads": len(costs),
        "wakeups": sum(cost.wakeups for cost in costs),
        "cpu": sum(cost.cpu for cost in costs),
    }


def show(found: Mapping[str, Any], console: Console) -> None:
    columns = ("pss_mb", "rss_mb", "private_mb", "threads", "wakeups", "cpu")
    table = Table(title=f"{found['agents']} agents for {found['seconds']:g} s ({found['machine']}); means of one agent")
    for name in ("process", "PSS MB", "RSS MB", "private MB", "threads", "wake-ups/s", "CPU %"):
        table.add_column(name, justify="left" if name == "process" else "right")
    for role, row in found["processes"].items():
        table.add_row(role, *(f"{row[name]:.2f}" for name in columns))
    table.add_row("together", *(f"{sum(row[name] for row in found['processes'].values()):.2f}" for name in columns))
    console.print(table)
    if found["alone_mb"] is not None:
        console.print(f"alone, with pages that nothing else shares: {found['alone_mb']:.1f} MB")
    table = Table("process", "thread", "wake-ups/s", "CPU %", "threads")
    for row in found["threads"][:SHOWN]:
        values = (f"{row['wakeups']:.2f}", f"{row['cpu']:.3f}", f"{row['count']:.1f}")
        table.add_row(row["process"], row["thread"], *values)
    console.print(table)


def imports() -> dict[str, Any]:
    """What the packages cost that each process imports, in new processes."""
    found = {}
    with tempfile.TemporaryDirectory() as cache:
        environ = {**os.environ, "PYTHONPYCACHEPREFIX": cache, "PYTHONDONTWRITEBYTECODE": ""}
        for role, modules in IMPORTED.items():
            command = [sys.executable, "-m", "sitl.bench.footprint_imports", *modules]
            for _ in range(2):  # the first run compiles the modules
                done = subprocess.run(command, env=environ, check=True, stdout=subprocess.PIPE)
            found[role] = json.loads(done.stdout)
    return found


def show_imports(found: Mapping[str, Any], console: Console) -> None:
    for role, one in found.items():
        took = f"{one['before_kb'] / 1e3:.1f} MB before, {one['after_kb'] / 1e3:.1f} MB after"
        table = Table("package", "MB", "CPU ms", "modules", title=f"imports of the {role}: {took} ({machine()})")
        for name, row in list(one["packages"].items())[:SHOWN]:
            table.add_row(name, f"{row['kb'] / 1e3:.2f}", f"{row['cpu_ms']:.0f}", str(row["modules"]))
        console.print(table)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/bench footprint", description=__doc__)
    parser.add_argument("what", nargs="?", choices=("running", "imports"), default="running")
    parser.add_argument("--pid", type=int, nargs="+", default=(), help="process ids of daemons (default: all)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="how long threads are measured (60)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    chosen = parser.parse_args(arguments)
    console = Console(width=120)
    if chosen.what == "imports":
        found = imports()
    else:
        running = agents(chosen.pid)
        if not running:
            print("no PHM runs here: start one, e.g. with scripts/demo", file=sys.stderr)
            return 1
        try:
            found = measure(running, chosen.seconds)
        except ValueError as error:
            print(error, file=sys.stderr)
            return 1
    if chosen.json:
        print(json.dumps(found, indent=2))
    else:
        (show_imports if chosen.what == "imports" else show)(found, console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
