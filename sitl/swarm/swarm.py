"""A swarm: brought up, asked, and taken down. See docs/sitl.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sitl.faults.base import Agent
from sitl.swarm.control import Air
from sitl.swarm.options import DEFAULT_NAME, Options

__all__ = ["Air", "Options", "Swarm", "SwarmAgent"]

Tell = Callable[[str], None]


@dataclass
class SwarmAgent(Agent):
    """One agent: a compose project with the services `ros_app` and `phm`. number: 1 to N, also its MAVLink system id.

    config: PHM's configuration of this agent; write it (`sitl.derived.write`) and restart the sidecar to change it.
    """

    config: Path = Path()

    @property
    def record(self) -> Path:
        assert self.logs is not None  # a swarm's agents have one
        return self.logs / "phm.jsonl"


@dataclass
class Swarm:
    """name: the compose projects are `NAME-1` to `NAME-N`, and `NAME-air`. folder: `swarm.json`, `logs/K/`, `config/K/phm.yaml`.

    ground_url: where a ground station connects, `tcp:127.0.0.1:PORT`; several may.
    """

    options: Options
    folder: Path = Path()
    ground_url: str = ""
    agents: list[SwarmAgent] = field(default_factory=list)
    air: Air = field(default_factory=lambda: Air(("127.0.0.1", 0)))

    @property
    def name(self) -> str:
        return self.options.name

    @classmethod
    def load(cls, name: str = DEFAULT_NAME) -> Swarm:
        """The one that is up under this name; LookupError says what to do when there is none."""
        raise LookupError(f"no swarm {name} is up: start one with `python -m sitl up --name {name}`")

    def up(self, tell: Tell = print) -> None:
        """Start everything and wait until all is well. RuntimeError says what did not start; what was started stays for a look at it."""
        raise NotImplementedError

    def down(self, *, keep_logs: bool = False) -> None:
        """Remove all that belongs to a swarm of this name, also of one whose `up` was killed. Doing it twice is harmless."""
        raise NotImplementedError

    def status(self) -> list[dict[str, Any]]:
        """For each agent: agent, name, app, sidecar (states of the containers), well, array (PHM's status array), open
        (units with an open fault), heard_s (age of PHM's last line)."""
        raise NotImplementedError

    def wait_well(self, limit_s: float = 120.0) -> None:
        """Until every agent's PHM reports all slots well and has no open fault. RuntimeError names those that are not, and why."""
        raise NotImplementedError
