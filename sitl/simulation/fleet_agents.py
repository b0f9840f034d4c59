"""Simulated agents of a fleet, many in one process: the real reporter of each, with a separate session.

`python -m sitl.simulation.fleet_agents ENDPOINT FLEET FIRST COUNT [OPTIONS]` prints `ready` when all have started to
connect, then reads one JSON object per line from standard input, and ends with it (like a stopped daemon). Options are
further keys of the section `fleet`.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import psutil

from phm.cli.run import end_process
from phm.core.clock import SystemClock
from phm.core.model import (
    Fault,
    FaultClosed,
    FaultOpened,
    Layer,
    Level,
    Outcome,
    Report,
    Result,
    Slot,
    Transition,
    UnitState,
)
from phm.core.settings import Settings
from phm.reporters.base import ReporterContext
from phm.reporters.fleet import TICK_S, FleetReporter
from phm.runtime.sections import reporter_settings

NODE = "nodes/agent/node_1"
UNITS = (
    ("companion", Slot.COMPANION),
    ("container/ros_app", Slot.CONTAINER),
    ("files/ros_app", Slot.FILES),
    ("network/ros_app", Slot.NETWORK),
    ("devices/ros_app", Slot.DEVICES),
    (NODE, Slot.NODES),
    ("topics/agent/topic_1", Slot.TOPICS),
    ("rates/agent/topic_1", Slot.RATES),
    ("host/memory", Slot.HOST),
    ("autopilot", Slot.AUTOPILOT),
    ("radio/ground", Slot.RADIO),
    ("peers/swarm", Slot.PEERS),
)

LIMIT_S = 60.0


class Agent:
    """One agent's reporter, as run by a daemon; its units are set by `tick`."""

    def __init__(self, name: str, endpoint: str, fleet: str, **options: Any) -> None:
        section = {"enabled": True, "name": fleet, "connect": [endpoint], **options}
        # Ids end at 250, names do not.
        number = 1 + sum(name.encode()) % 50
        self.settings = Settings.model_validate({"agent": {"name": name, "id": number}, "fleet": section})
        self.clock, self.boot_id, self.alive = SystemClock(), uuid.uuid4().hex[:12], True
        at = self.clock.stamp()
        self._units = {
            unit: UnitState(unit, unit.partition("/")[0], slot, Layer.ROS, Level.OK, Result(Level.OK, "is OK"), at)
            for unit, slot in UNITS
        }
        self._fault: Fault | None = None
        context = ReporterContext(
            reporter_settings(self.settings),
            self.clock,
            self.boot_id,
            lambda: tuple(self._units.values()),
            lambda: self.alive,
            dict,
        )
        reporter = FleetReporter.build(context)
        assert reporter is not None
        self.reporter = reporter
        reporter.handle(Report(at, 1, at, ()))

    def tick(self) -> None:
        """Break or repair the node. The fault's brief has the time, on the machine's monotonic clock."""
        at = self.clock.stamp()
        old, broken = self._units[NODE], self._fault is None
        level = Level.ERROR if broken else Level.OK
        result = Result(level, "is dead" if broken else "is OK", brief=f"at {at.mono:.6f}" if broken else "")
        new = self._units[NODE] = replace(old, level=level, result=result, since=at)
        if self._fault is None:
            self._fault = Fault(f"{self.boot_id[:4]}-1", NODE, new.slot, new.layer, result, at)
            self.reporter.handle(FaultOpened(at, self._fault))
        else:
            self.reporter.handle(FaultClosed(at, replace(self._fault, closed=at, outcome=Outcome.RESOLVED)))
            self._fault = None
        self.reporter.handle(Transition(at, old.level, new))


class Ticker:
    """Calls the reporters' `tick` as the bus does."""

    def __init__(self, agents: Iterable[Agent]) -> None:
        self._agents, self._stop = tuple(agents), threading.Event()
        self._thread = threading.Thread(target=self._loop, name="sitl-ticker", daemon=True)
        self._thread.start()

    def _loop(self) -> None:
        while not self._stop.wait(TICK_S):
            for agent in self._agents:
                agent.reporter.tick()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


class Crowd:
    """A process of simulated agents, seen from its parent."""

    def __init__(self, endpoint: str, fleet: str, first: int, count: int, **options: Any) -> None:
        words = (
            sys.executable,
            "-m",
            "sitl.simulation.fleet_agents",
            endpoint,
            fleet,
            str(first),
            str(count),
            json.dumps(options),
        )
        self.names = names(first, count)
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.began = time.monotonic()

    def ready(self) -> None:
        """Wait until all agents have started."""
        self._line()

    def tick(self, numbers: Iterable[int], spacing_s: float = 0.0) -> None:
        """Break or repair these agents, counted from 0 within this process."""
        self._ask({"turn": list(numbers), "spacing_s": spacing_s})

    def report(self) -> Mapping[str, Any]:
        """Sums over the agents, and the resources that the process uses."""
        self._ask({"report": True})
        answer: dict[str, Any] = json.loads(self._line())
        return answer

    def end(self) -> int:
        """Shut the process down; return its exit code."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        code = self.process.wait(LIMIT_S)
        self._forget()
        return code

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self._forget()

    def _ask(self, words: Mapping[str, Any]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(words) + "\n")
        self.process.stdin.flush()

    def _line(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"a process of agents ended with code {self.process.wait(LIMIT_S)}")
        return line

    def _forget(self) -> None:
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None and not pipe.closed:
                pipe.close()


def names(first: int, count: int) -> list[str]:
    return [f"agent_{number}" for number in range(first, first + count)]


def report(agents: Iterable[Agent]) -> dict[str, Any]:
    reports = [agent.reporter.report() for agent in agents]
    process = psutil.Process()
    sums = {
        key: sum(entry[key] for entry in reports)
        for key in ("connected", "published", "answered", "bytes_out", "connects")
    }
    return {
        **sums,
        "cpu_s": sum(process.cpu_times()[:2]),
        "rss": process.memory_info().rss,
        "threads": process.num_threads(),
    }


def main(endpoint: str, fleet: str, first: str, count: str, options: str) -> None:
    rss = psutil.Process().memory_info().rss
    agents = [Agent(name, endpoint, fleet, **json.loads(options)) for name in names(int(first), int(count))]
    ticker = Ticker(agents)
    print("ready", flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        for number in asked.get("turn", ()):
            agents[number].tick()
            time.sleep(asked["spacing_s"])
        if asked.get("report"):
            print(json.dumps({**report(agents), "rss_before": rss}), flush=True)
    ticker.close()
    closing = [threading.Thread(target=agent.reporter.close) for agent in agents]
    for thread in closing:
        thread.start()
    for thread in closing:
        thread.join()


if __name__ == "__main__":
    main(*sys.argv[1:])
    end_process(0)  # as the daemon does: Zenoh's threads may outlast their sessions
