"""Bringing one simulated agent up and down with Docker Compose, as a user would."""

from __future__ import annotations

import grp
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sitl.faults._volumes import release
from sitl.faults.base import Agent

ROOT = Path(__file__).resolve().parents[2]
FILES = ("docker/compose.yaml", "docker/compose.demo.yaml")
COMPOSE_LIMIT_S = 180.0
SOCKET = Path("/var/run/docker.sock")


@dataclass
class Stack:
    """A compose project with the application, PHM beside it and a simulated autopilot."""

    project: str = "phm-demo"
    agent_name: str = "agent_1"
    agent_id: int = 1
    interval_s: float = 20.0
    ground_port: int = 5760
    logs: Path = field(default_factory=lambda: Path(tempfile.mkdtemp(prefix="phm-demo-")))
    extra: dict[str, str] = field(default_factory=dict)
    files: Sequence[str] = FILES
    """Compose files, relative to the project's folder or absolute."""

    @property
    def agent(self) -> Agent:
        return Agent(self.project, self.agent_name)

    @property
    def device(self) -> Path:
        """The device of the host that is this project's alone."""
        return self.agent.device

    @property
    def record(self) -> Path:
        return self.logs / "phm.jsonl"

    def environment(self) -> dict[str, str]:
        return {
            **os.environ,
            "PHM_AGENT": self.agent_name,
            "PHM_AGENT_ID": str(self.agent_id),
            "PHM_INTERVAL": f"{self.interval_s:g}",
            "PHM_APP": f"{self.project}-ros_app-1",
            "PHM_NETWORK": f"{self.project}_net",
            "PHM_DEVICE": str(self.device),
            "PHM_LOGS": str(self.logs),
            "PHM_GROUND_PORT": str(self.ground_port),
            "DOCKER_GID": str(SOCKET.stat().st_gid),
            "DIALOUT_GID": str(_group_id("dialout", 20)),
            **self.extra,
        }

    def up(self) -> None:
        """Start everything; returns when Compose has started the containers, healthy or not."""
        self.logs.mkdir(parents=True, exist_ok=True)
        self.logs.chmod(0o777)  # PHM is an ordinary user in its container, with a number this host need not know
        self.agent.make_device()
        self._compose("up", "--detach", "--no-build", "--remove-orphans")

    def recreate(self, service: str) -> None:
        """Replace a service's container by a new one, as an operator would."""
        self._compose("up", "--detach", "--no-build", "--no-deps", "--force-recreate", service)

    def down(self, *, keep_logs: bool = False) -> None:
        """Remove containers, networks and volumes of the project, the device and the log folder."""
        self._compose("down", "--volumes", "--remove-orphans", "--timeout", "3")
        self.device.unlink(missing_ok=True)
        release(self.logs)
        if not keep_logs:
            shutil.rmtree(self.logs, ignore_errors=True)

    def _compose(self, *words: str) -> None:
        files = [word for name in self.files for word in ("--file", str(ROOT / name))]
        argv = ["docker", "compose", "--project-name", self.project, *files, *words]
        done = subprocess.run(
            argv, env=self.environment(), capture_output=True, text=True, timeout=COMPOSE_LIMIT_S, check=False
        )
        if done.returncode != 0:
            raise RuntimeError(f"docker compose {words[0]} ended with {done.returncode}:\n{done.stderr.strip()}")


def _group_id(name: str, default: int) -> int:
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        return default
