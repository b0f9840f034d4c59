"""A swarm: brought up, asked, and taken down. See docs/development/sitl.md."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from docker import DockerClient

from sitl.faults._volumes import release
from sitl.faults.base import Agent
from sitl.harness.config_overrides import write
from sitl.swarm import config, engine, workspace
from sitl.swarm.control import LinkEmulatorClient
from sitl.swarm.health import MACHINE, HealthMonitor
from sitl.swarm.options import DEFAULT_NAME, MOST_AGENTS, Options

__all__ = ["LinkEmulatorClient", "Options", "Swarm", "SwarmAgent"]

DOWN_LOCK_S = 200.0
"""Longer than a Compose command that lost its parent may take."""
POLL_S = 0.2
SLACK_S = 5.0
"""PHM reports every interval; one that has written nothing for longer is not OK."""


@dataclass
class SwarmAgent(Agent):
    """One agent: a compose project with the services `ros_app` and `phm`. number: 1 to N, also its MAVLink system id.

    config: PHM's configuration of this agent, which its sidecar has mounted.
    """

    config: Path = Path()

    @property
    def record(self) -> Path:
        assert self.logs is not None  # a swarm's agents have one
        return self.logs / "phm.jsonl"


@dataclass
class Swarm:
    """name: the compose projects are `NAME-1` to `NAME-N`, and `NAME-air`. folder: `swarm.json`, `logs/K/`, `config/K/phm.yaml`.

    ground_url: where a ground station connects, `tcp:127.0.0.1:PORT`; several may. took: seconds of each phase of `up`.
    """

    options: Options
    folder: Path = field(init=False)
    ground_url: str = ""
    took: dict[str, float] = field(default_factory=dict)
    agents: list[SwarmAgent] = field(init=False)
    air: LinkEmulatorClient = field(default_factory=lambda: LinkEmulatorClient(("127.0.0.1", 0)))

    def __post_init__(self) -> None:
        if not 1 <= self.options.agents <= MOST_AGENTS:
            raise ValueError(f"{self.options.agents} agents: allowed are 1 to {MOST_AGENTS}")
        self.folder = workspace.folder(self.name)
        self.agents = [self._agent(number) for number in range(1, self.options.agents + 1)]

    @property
    def name(self) -> str:
        return self.options.name

    @cached_property
    def docker(self) -> DockerClient:
        return DockerClient.from_env()

    @classmethod
    def load(cls, name: str = DEFAULT_NAME) -> Swarm:
        """The one that is up under this name; LookupError says what to do when there is none."""
        try:
            words = json.loads((workspace.folder(name) / "swarm.json").read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise LookupError(f"no swarm {name} is up: start one with `python -m sitl up --name {name}`") from error
        swarm = cls(Options(**words["options"]), ground_url=words["ground_url"], took=words["took"])
        swarm.air.address = (words["control"][0], words["control"][1])
        return swarm

    def down(self, *, keep_logs: bool = False) -> int:
        """Remove all that belongs to a swarm of this name, also of one whose `up` was killed; how many things that were.

        Doing it twice is harmless. keep_logs: leave the folder with PHM's logs.
        """
        with workspace.locked(self.name, DOWN_LOCK_S):
            return self.remove(keep_logs=keep_logs)

    def remove(self, *, keep_logs: bool) -> int:
        """The same as `down`, by a caller that has the swarm's lock."""
        removed = engine.remove(self.docker, self.name)
        for device in engine.devices(self.name):
            device.unlink(missing_ok=True)
        (self.folder / "swarm.json").unlink(missing_ok=True)
        release(self.folder)
        if not keep_logs:
            shutil.rmtree(self.folder, ignore_errors=True)
        return removed

    def save(self) -> None:
        words = {
            "options": asdict(self.options),
            "ground_url": self.ground_url,
            "control": list(self.air.address),
            "took": self.took,
        }
        (self.folder / "swarm.json").write_text(json.dumps(words, indent=2) + "\n", "utf-8")

    def status(self) -> list[dict[str, Any]]:
        """For each agent: agent, name, app, sidecar (states of the containers), healthy, array (PHM's status array), open
        (units with an open fault), why (what is not OK), received_s (age of PHM's last line; None: it has written none)."""
        states = {
            (one.labels.get("com.docker.compose.project"), one.labels.get("com.docker.compose.service")): one.status
            for one in self.docker.containers.list(
                all=True, filters={"label": f"{engine.LABEL}={self.name}"}, ignore_removed=True
            )
        }
        return [self._status_of(agent, states) for agent in self.agents]

    def wait_healthy(self, limit_s: float = 120.0) -> None:
        """Until every agent's PHM has every unit OK and no open fault; the units of the machine, `host/...`, do not count.

        RuntimeError names the agents that are not OK, and why.
        """
        watches = {agent.name: HealthMonitor(agent.record, but=(MACHINE,)) for agent in self.agents}
        end = time.monotonic() + limit_s
        while True:
            fresh_s = 1.5 * self.options.interval_s + SLACK_S
            bad = {
                name: why for name, watch in watches.items() if (why := watch.update().why_not(time.time(), fresh_s))
            }
            if not bad:
                return
            if time.monotonic() > end:
                words = "; ".join(f"{name}: {why}" for name, why in bad.items())
                raise RuntimeError(f"not OK after {limit_s:g} s: {words}; logs in {self.folder / 'logs'}")
            time.sleep(POLL_S)

    def configure(self, agent: SwarmAgent, changes: Mapping[str, str]) -> None:
        """Start the agent's PHM again with further lines of the shipped configuration replaced; ``{}``: as `up` had it."""
        write(config.text(self.options, agent.number, changes), agent.config)
        agent.sidecar.restart()

    def _agent(self, number: int) -> SwarmAgent:
        return SwarmAgent(
            f"{self.name}-{number}",
            f"agent_{number}",
            number=number,
            logs=self.folder / "logs" / str(number),
            air=self.air,
            config=self.folder / "config" / str(number) / "phm.yaml",
        )

    @staticmethod
    def _status_of(agent: SwarmAgent, states: Mapping[tuple[str | None, str | None], str]) -> dict[str, Any]:
        standing = HealthMonitor(agent.record).update()
        return {
            "agent": agent.number,
            "name": agent.name,
            "app": states.get((agent.project, "ros_app"), "none"),
            "sidecar": states.get((agent.project, "phm"), "none"),
            "healthy": standing.healthy,
            "array": standing.array,
            "open": sorted(standing.open.values()),
            "why": standing.why,
            "received_s": None if standing.last_utc_s is None else round(time.time() - standing.last_utc_s, 1),
        }
