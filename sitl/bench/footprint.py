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
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import psutil
from docker import DockerClient
from docker.errors import DockerException
from rich.console import Console
from rich.progress import track
from rich.table import Table

from sitl.bench import footprint_proc
from sitl.faults._cgroups import cgroup, cpu_of
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


def measure(
    running: Sequence[Mapping[str, int]],
    seconds: float,
    groups: Mapping[str, Path] | None = None,
    sleep: Callable[[float], None] = time.sleep,
) -> dict[str, Any]:
    """Means over the agents: memory and CPU by process and in all, and each thread by process and name. An agent of which a process
    ends meanwhile is left out. Raises ValueError if none is left, or one cannot be measured by this user.

    groups: cgroups by the name of their container, whose CPU time is measured too, in percent of a core: with short processes such
    as health checks, which threads do not have.
    """
    groups = groups or {}
    used, began = {name: cpu_of(folder) for name, folder in groups.items()}, time.monotonic()
    costs = footprint_proc.threads([pid for roles in running for pid in roles.values()], partial(sleep, seconds))
    passed_s = time.monotonic() - began
    try:
        containers = {name: 100 * (cpu_of(folder) - used[name]) / passed_s for name, folder in groups.items()}
    except OSError:
        raise ValueError(f"one of these containers has ended meanwhile: {', '.join(groups)}") from None
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
        "containers": containers,
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
    for name, cpu in found["containers"].items():
        console.print(f"container {name}, all that ran in it: CPU {cpu:.2f} %")
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


def containers(names: Sequence[str]) -> dict[str, Path]:
    """The cgroups of these running containers. Raises ValueError with what to do."""
    if not names:
        return {}
    try:
        client = DockerClient.from_env()
        try:
            return {name: cgroup(client.containers.get(name), "cpuacct") for name in names}
        finally:
            client.close()
    except (DockerException, LookupError, OSError) as error:
        raise ValueError(
            f"cannot measure the containers {', '.join(names)}: {error}; `docker ps` lists what runs"
        ) from None


def wait(seconds: float) -> None:
    """With a bar on a terminal."""
    steps = max(1, int(seconds))
    for _ in track(range(steps), "measuring", console=Console(stderr=True), transient=True, refresh_per_second=1):
        time.sleep(seconds / steps)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/bench footprint", description=__doc__)
    parser.add_argument("what", nargs="?", choices=("running", "imports"), default="running")
    parser.add_argument("--pid", type=int, nargs="+", default=(), help="process ids of daemons (default: all)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="how long threads are measured (60)")
    parser.add_argument(
        "--containers", nargs="+", default=(), metavar="NAME", help="the CPU of these too, with their health checks"
    )
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
            found = measure(running, chosen.seconds, containers(chosen.containers), wait)
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
