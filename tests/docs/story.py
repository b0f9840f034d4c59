"""The example of the documents: one node of the shipped configuration is killed, and PHM restarts its container.

The real checks, tracker, logs and status reporter run on fakes and a fake clock, so each run is the same.
Only the steps of recovery are written here, with the sentences of the code.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

from phm import api, testing
from phm.checking import plan, registry
from phm.checking.pipeline import Pipeline
from phm.config import load
from phm.core.bus import Bus
from phm.core.model import ActionEvent, Event, Fault, FaultOpened, Phase, Result
from phm.core.settings import LogSettings, Settings
from phm.facts import Attachment, DeviceMapping, LinkFact, PressureFact, ProcessFact
from phm.reporters.base import ReporterContext
from phm.reporters.log import LogReporter
from phm.reporters.status import StatusReporter
from phm.runtime.sections import reporter_settings
from phm.tracker import Tracker
from phm.wire import json_log

ROOT = Path(__file__).resolve().parents[2]
NODES = {name: f"/agent_1/{name}" for name in ("node_1", "node_2", "node_3")}
TOPICS = {f"/agent_1/topic_{n}": (f"/agent_1/node_{n}", f"/agent_1/node_{n % 3 + 1}") for n in (1, 2, 3)}
VICTIM = "/agent_1/node_1"
UNIT = "nodes/agent_1/node_1"
TARGET = "ros_app"
START_UTC = 1_772_366_400.123
"""2026-03-01 12:00:00.123 UTC."""
STEP_S = 0.1
NETWORK = Attachment("phm_net", "id-of-phm_net", "172.20.0.2")


@dataclass(frozen=True)
class Story:
    """The results of the run: the text log, the record, and the status file while the fault was open and at the end."""

    text_log: tuple[str, ...]
    record: tuple[Mapping[str, Any], ...]
    during: Mapping[str, Any]
    after: Mapping[str, Any]


class _Events:
    """A bus that delivers its events in `flush`: the pipeline publishes while it holds its lock."""

    def __init__(self) -> None:
        self.reporters: list[Any] = []
        self.faults: list[Fault] = []
        self._waiting: list[Event] = []

    def publish(self, event: Event) -> None:
        self._waiting.append(event)

    def flush(self) -> None:
        """Deliver the published events."""
        events, self._waiting = self._waiting, []
        for event in events:
            if isinstance(event, FaultOpened):
                self.faults.append(event.fault)
            for reporter in self.reporters:
                if not reporter.kinds or isinstance(event, reporter.kinds):
                    reporter.handle(event)


class _Agent:
    """The shipped configuration on fakes."""

    def __init__(self, folder: Path) -> None:
        self.settings = shipped(folder)
        self.clock = testing.FakeClock(100.0, START_UTC)
        self.docker, self.files, self.devices = _container(), testing.FakeFiles(), testing.FakeDevices()
        self.ros, self.pressure = testing.FakeRos(age_s=0.0), testing.FakePressure()
        self.links = testing.FakeLinks(links=(LinkFact("ground", open=True),))
        self.files.put(TARGET, "/ws/src/critical_file", executable=True)
        self.devices.put("/dev/ttyS0")
        self.world = testing.world(
            clock=self.clock,
            docker=self.docker,
            files=self.files,
            devices=self.devices,
            ros=self.ros,
            links=self.links,
            pressure=self.pressure,
        )
        self.alive, self.silent_since = set(NODES.values()), 0.0
        made = plan.build_plan(self.settings, registry.checks())
        self.checks = [entry.check for entry in made.scheduled]
        self.events = _Events()
        tracker = Tracker(made.tracked, made.graph, self.clock.stamp(), fault_prefix="ab12-")
        self.pipeline = Pipeline(tracker, cast(Bus, self.events), self.clock)
        context = ReporterContext(
            reporter_settings(self.settings),
            self.clock,
            "ab12c34d56ef",
            self.pipeline.states,
            lambda: True,
            self._health,
        )
        self.status, self.log = StatusReporter.build(context), LogReporter.build(context)
        self.events.reporters = [self.log, self.status]

    def run(self, seconds: float) -> None:
        """Advance the time; all checks run in each step."""
        for _ in range(round(seconds / STEP_S)):
            self.clock.advance(STEP_S)
            self._observe()
            for check in self.checks:
                results = check.run(self.world)
                units = {check.units[0].id: results} if isinstance(results, Result) else dict(results)
                self.pipeline.observe(units, self.clock.mono(), 0.004)
            self.pipeline.tick()
            self.events.flush()

    def act(self, phase: Phase, detail: str) -> None:
        """One step of the recovery of the first fault."""
        fault = self.events.faults[0]
        event = ActionEvent(self.clock.stamp(), fault.id, fault.unit, "restart", TARGET, phase, detail)
        self.events.publish(event)

    def status_file(self) -> Mapping[str, Any]:
        self.status.tick()
        path = Path(self.settings.run_dir) / "status.json"
        return cast("Mapping[str, Any]", json.loads(path.read_text("utf-8")))

    def _observe(self) -> None:
        """Update the facts of the probes."""
        self.pressure.put(TARGET, PressureFact(self.clock.mono(), "cgroup v2"))
        silent_s = self.clock.mono() - self.silent_since
        self.ros.change(
            nodes=dict.fromkeys(sorted(self.alive), 1),
            topics={topic: self._topic(*ends, silent_s) for topic, ends in TOPICS.items()},
        )
        self.docker.lists[TARGET] = tuple(
            ProcessFact(70 + n, 1, "S", 5.0, f"python node.py --ros-args -r __node:={name} -r __ns:=/agent_1")
            for n, name in enumerate(NODES, 1)
            if NODES[name] in self.alive
        )

    def _topic(self, publisher: str, subscriber: str, silent_s: float) -> api.TopicFact:
        def ends(node: str) -> tuple[api.EndpointFact, ...]:
            return (api.EndpointFact(node, "std_msgs/msg/String"),) if node in self.alive else ()

        sent = publisher in self.alive
        rate = api.RateFact(
            10.0 if sent else None,
            0.1 if sent else silent_s,
            window_s=3.0,
            samples=30,
            limit_s=3.0,
            publishers=int(sent),
            error_hz=0.0,
        )
        return api.TopicFact(ends(publisher), ends(subscriber), rate)

    def _health(self) -> dict[str, Any]:
        link = {"name": "ground", "open": True, "error": ""}
        return {"uptime_s": round(self.clock.mono() - 40.0, 1), "dropped": {}, "ros_restarts": 0, "links": [link]}


def shipped(folder: Path) -> Settings:
    """The shipped configuration, with its directories below `folder`."""
    settings = load(str(ROOT / "config" / "phm.yaml"), environ={})
    places = {name: str(folder / name) for name in ("run", "state", "log")}
    return settings.model_copy(
        update={
            "run_dir": places["run"],
            "state_dir": places["state"],
            "log": LogSettings(directory=places["log"]),
        }
    )


@cache
def play() -> Story:
    """Run the story."""
    with TemporaryDirectory() as name:
        return _play(Path(name))


def _play(folder: Path) -> Story:
    agent = _Agent(folder)
    agent.run(4.0)
    agent.pipeline.begin_pass()
    agent.run(1.0)
    agent.pipeline.note("NOTE", f"test: kill {VICTIM}")
    agent.alive.discard(VICTIM)
    agent.silent_since = agent.clock.mono()
    agent.run(0.6)
    began = agent.clock.mono()
    agent.pipeline.begin_action(TARGET, UNIT, "restart", 30.0)
    agent.act(Phase.STARTED, f"restart {TARGET} for: {agent.events.faults[0].result.summary}")
    agent.run(0.5)
    agent.pipeline.begin_pass()
    agent.run(0.5)
    during = agent.status_file()
    agent.run(1.5)
    agent.pipeline.begin_action(TARGET, UNIT, "restart", 30.0, verifying=True)
    agent.act(Phase.DONE, f"restarted {TARGET}")
    agent.run(1.2)
    agent.alive.add(VICTIM)
    agent.run(0.1)
    agent.act(Phase.VERIFIED, f"{UNIT} is OK again {agent.clock.mono() - began:.1f} s after the action began")
    agent.pipeline.end_action(TARGET, worked=True)
    agent.run(2.0)
    after = agent.status_file()
    agent.log.close()
    text = (folder / "log" / "phm.log").read_text("utf-8").splitlines()
    return Story(tuple(text), tuple(json_log.read(folder / "log")), during, after)


def _container() -> testing.FakeDocker:
    fact = testing.container(
        TARGET,
        networks=(NETWORK,),
        health="healthy",
        devices=(DeviceMapping("/dev/ttyS0", "/dev/ttyS0"),),
    )
    return testing.FakeDocker(
        fact, networks={"phm_net": "id-of-phm_net"}, me=testing.container("phm", networks=(NETWORK,))
    )
