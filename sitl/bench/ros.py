"""What it costs to know the rates of topics, and how well they are known then: PHM's sampler, a callback, `ros2 topic hz`.

``scripts/bench ros`` publishes each load once and lets the three ways measure it one after the other, so that none
disturbs another. All are separate processes; kept to this machine, the middleware takes shared memory between them.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Thread

import psutil
from rich.console import Console
from rich.table import Table

from phm.probes.ros.protocol import GraphMessage, ProtocolError, Wanted, WantedTopic, decode, encode_wanted
from sitl.bench.ros_peers import Board, topic
from sitl.harness.machine import machine

WARM_S = 6.0
"""Discovery, and the sampler's first window."""
STEPS = 10
"""A rate that a method reports is read this many times while it is measured."""
ERROR_AIM, SHARE_AIM = 1.0, 6.0
"""Percent that the sampler's rate may be off; how many times the callback must cost as much, at 2000 messages a second."""


@dataclass(frozen=True)
class Load:
    topics: int
    hz: float
    size: int = 100

    @property
    def name(self) -> str:
        size = f" of {self.size / 1e6:g} MB" if self.size >= 1e5 else ""
        return f"{self.topics} x {self.hz:g} Hz{size}"


LOADS = (Load(10, 10), Load(10, 100), Load(10, 200), Load(1, 1000), Load(50, 50), Load(1, 30, 1_000_000))


@dataclass(frozen=True)
class Cost:
    """One way on one load. cpu, python: percent of one core, python that of the thread which runs Python.

    off: percent by which the rates of the topics are off, in the mean; worst: of the worst topic.
    """

    load: str
    way: str
    messages: float
    cpu: float
    python: float
    rss_mb: float
    off: float
    worst: float


class MeasurementMethod(ABC):
    """A process that measures, and the rates (Hz) that it has found by now."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process

    def mark(self) -> None:
        """Measuring begins now."""

    @abstractmethod
    def rates(self) -> list[float]: ...


class Sampler(MeasurementMethod):
    """PHM's ROS child, as the daemon starts it."""

    name = "PHM"

    def __init__(self, load: Load, environ: dict[str, str], folder: Path) -> None:
        command = (sys.executable, "-m", "phm.probes.ros.child")
        pipe = subprocess.PIPE
        with Path(folder, "stderr").open("wb") as errors:
            super().__init__(subprocess.Popen(command, env=environ, stdin=pipe, stdout=pipe, stderr=errors))
        topics = tuple(WantedTopic(topic(number), load.hz) for number in range(load.topics))
        assert self.process.stdin is not None
        self.process.stdin.write(encode_wanted(Wanted("bench", topics=topics)))
        self.process.stdin.flush()
        self._newest = [0.0] * load.topics
        Thread(target=self._read, name="bench-reader", daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            try:
                message = decode(line)
            except ProtocolError:
                continue
            if isinstance(message, GraphMessage):
                facts = (message.topics[topic(number)].rate for number in range(len(self._newest)))
                self._newest = [(fact.hz if fact is not None else None) or 0.0 for fact in facts]

    def rates(self) -> list[float]:
        return self._newest


class Peer(MeasurementMethod):
    """One of `ros_bench_peers`."""

    def __init__(self, role: str, load: Load, environ: dict[str, str], folder: Path) -> None:
        path = folder / role
        self.board = Board(path, load.topics, make=True)
        super().__init__(peer(role, path, load, environ))


class Callback(Peer):
    """Depth 10, in an executor. It counts; the rate is what it counted since `mark`."""

    name = "raw callback"

    def __init__(self, load: Load, environ: dict[str, str], folder: Path) -> None:
        super().__init__("callback", load, environ, folder)
        self._marked: tuple[float, list[float]] = (0.0, [])

    def mark(self) -> None:
        self._marked = (time.monotonic(), self.board.read())

    def rates(self) -> list[float]:
        seconds = time.monotonic() - self._marked[0]
        return [(now - then) / seconds for now, then in zip(self.board.read(), self._marked[1], strict=True)]


class TopicHz(Peer):
    """The method of `ros2 topic hz`."""

    name = "ros2 topic hz"

    def __init__(self, load: Load, environ: dict[str, str], folder: Path) -> None:
        super().__init__("hz", load, environ, folder)

    def rates(self) -> list[float]:
        return self.board.read()


WAYS = (Sampler, Callback, TopicHz)


def peer(role: str, board: Path, load: Load, environ: dict[str, str]) -> subprocess.Popen[bytes]:
    arguments = (role, str(board), str(load.topics), str(load.hz), str(load.size))
    return subprocess.Popen((sys.executable, "-m", "sitl.bench.ros_peers", *arguments), env=environ)


def measure(load: Load, seconds: float, console: Console) -> Iterator[Cost]:
    """All ways on one load, one after the other, while it is published."""
    environ = {
        "MALLOC_ARENA_MAX": "2",
        "OPENBLAS_NUM_THREADS": "1",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(20 + os.getpid() % 30),
        **os.environ,
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
    }
    with tempfile.TemporaryDirectory() as folder:
        truth = Board(Path(folder, "source"), load.topics, make=True)
        with ended(peer("source", Path(folder, "source"), load, environ)):
            for kind in WAYS:
                with console.status(f"{load.name}: {kind.name}"):
                    way = kind(load, environ, Path(folder))
                    with ended(way.process):
                        time.sleep(WARM_S)
                        cost = watch(load, way, kind.name, truth, seconds)
                yield cost


def watch(load: Load, way: MeasurementMethod, name: str, truth: Board, seconds: float) -> Cost:
    process = psutil.Process(way.process.pid)
    sent, began_s = truth.read(), time.monotonic()
    way.mark()
    cpu_s, python_s = cpu(process)
    found: list[list[float]] = []
    for step in range(1, STEPS + 1):
        time.sleep(max(0.0, began_s + seconds * step / STEPS - time.monotonic()))
        found.append(way.rates())
    took_s = time.monotonic() - began_s
    true = [(now - then) / took_s for now, then in zip(truth.read(), sent, strict=True)]
    # A counted rate is what it is at the end; one that is reported repeatedly is its mean.
    rates_seen = [found[-1]] if isinstance(way, Callback) else found
    off = [abs(sum(rates[n] for rates in rates_seen) / len(rates_seen) / hz - 1) * 100 for n, hz in enumerate(true)]
    if way.process.poll() is not None:
        raise RuntimeError(f"{load.name}: the process of '{name}' ended with code {way.process.returncode}")
    used = cpu(process)
    return Cost(
        load.name,
        name,
        round(sum(true), 1),
        round(100 * (used[0] - cpu_s) / took_s, 2),
        round(100 * (used[1] - python_s) / took_s, 2),
        round(process.memory_info().rss / 1e6, 1),
        round(sum(off) / len(off), 3),
        round(max(off), 3),
    )


def cpu(process: psutil.Process) -> tuple[float, float]:
    """Seconds used by all threads, and by the first one, which alone runs Python."""
    main = next(thread for thread in process.threads() if thread.id == process.pid)
    return sum(process.cpu_times()[:2]), main.user_time + main.system_time


@contextmanager
def ended(process: subprocess.Popen[bytes]) -> Iterator[None]:
    try:
        yield
    finally:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()


def table(costs: Sequence[Cost]) -> Table:
    made = Table(
        title=f"What it costs to know topic rates ({machine()})",
        caption="CPU: percent of a core, all threads; Python: of it the thread that runs Python; off: error of the rates, mean "
        "and worst topic",
    )
    for name in ("load", "way", "msg/s", "CPU %", "Python %", "RSS MB", "off %", "worst %"):
        made.add_column(name, justify="left" if name in ("load", "way") else "right")
    for cost in costs:
        row = (f"{cost.messages:.0f}", f"{cost.cpu:.1f}", f"{cost.python:.1f}", f"{cost.rss_mb:.0f}")
        made.add_row(
            cost.load, cost.way, *row, f"{cost.off:.2f}", f"{cost.worst:.2f}", end_section=cost.way == TopicHz.name
        )
    return made


def verdict(costs: Sequence[Cost]) -> list[str]:
    """The aims that are missed, in words."""
    missed = [
        f"{cost.load}: the rate is off by {cost.off:.2f} %, aim {ERROR_AIM:g} %"
        for cost in costs
        if cost.way == Sampler.name and cost.off > ERROR_AIM
    ]
    cpu_of = {cost.way: cost.cpu for cost in costs if cost.load == Load(10, 200).name}
    if cpu_of and cpu_of[Sampler.name] * SHARE_AIM > cpu_of[Callback.name]:
        share = cpu_of[Callback.name] / cpu_of[Sampler.name]
        missed.append(f"2000 messages/s: a callback costs {share:.1f} times as much, aim {SHARE_AIM:g} times")
    return missed


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/bench ros", description=__doc__, epilog="Example: scripts/bench ros --seconds 20"
    )
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="how long each way is measured (10)")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    chosen = parser.parse_args(arguments)
    console = Console(stderr=chosen.json)
    costs = []
    for load in LOADS:
        for cost in measure(load, chosen.seconds, console):
            costs.append(cost)
            console.print(
                f"{cost.load}, {cost.way}: {cost.cpu:.1f} % of a core, rate off by {cost.off:.2f} %", style="dim"
            )
    missed = verdict(costs)
    if chosen.json:
        figures = {
            "machine": machine(),
            "seconds": chosen.seconds,
            "missed": missed,
            "figures": list(map(asdict, costs)),
        }
        print(json.dumps(figures, indent=2))
    else:
        console.print(table(costs))
        console.print("All aims are met." if not missed else f"Missed: {'; '.join(missed)}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
