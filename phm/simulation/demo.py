"""The processes of `phm demo`: three agents, each a real PHM daemon with a simulated autopilot, and two injected faults."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phm.wire import status_file

AGENTS = (1, 2, 3)
FAULTS = (
    (18.0, "the autopilot of agent 2 is killed"),
    (28.0, "the PHM of agent 3 is killed"),
    (45.0, "the autopilot of agent 2 is started again"),
)
"""(Seconds after the start, what happens then)."""
CONFIGURATION = Path(__file__).with_name("demo.yaml")
_END_S = 15.0


@dataclass(frozen=True, slots=True)
class DemoPorts:
    """Ports on loopback: each autopilot's is `first` plus the id of its agent, `ground` is that of `phm gcs`."""

    first: int = 14600
    ground: int = 14551

    def companion(self, agent: int) -> int:
        return self.first + agent


class DemoAgents:
    """Starts agents, each a PHM daemon and its autopilot; `close` kills every process that was started. On Linux, they end
    with this process, too.

    folder: gets a folder of logs and state for each agent.
    """

    agents: tuple[int, ...] = AGENTS
    configuration = CONFIGURATION
    companion_scheme = "udpin"
    """How an autopilot listens for its PHM."""

    def __init__(self, folder: Path, ports: DemoPorts, python: str = sys.executable) -> None:
        self.folder, self.ports, self._python = folder, ports, python
        self._autopilots: dict[int, subprocess.Popen[bytes]] = {}
        self._daemons: dict[int, subprocess.Popen[bytes]] = {}

    def start(self) -> None:
        """Start all agents."""
        for agent in self.agents:
            self.start_autopilot(agent)
            self._start_daemon(agent)

    def run_dir(self, agent: int) -> Path:
        """Where the agent's daemon keeps its status."""
        return self.folder / str(agent) / "run"

    def running(self) -> bool:
        """Whether each daemon has written a status."""
        return all((self.run_dir(agent) / status_file.NAME).exists() for agent in self.agents)

    def kill_autopilot(self, agent: int) -> None:
        self._autopilots[agent].kill()
        self._autopilots[agent].wait(_END_S)

    def kill_daemon(self, agent: int) -> None:
        self._daemons[agent].kill()

    def start_autopilot(self, agent: int) -> None:
        companion = f"{self.companion_scheme}:127.0.0.1:{self.ports.companion(agent)}"
        ground = f"udpout:127.0.0.1:{self.ports.ground}"
        words = ["phm.simulation.autopilot", "--id", str(agent), "--companion", companion, "--ground", ground]
        self._autopilots[agent] = self._spawn(f"autopilot{agent}", words, {})

    def environment(self, agent: int) -> dict[str, str]:
        """The variables that the configuration of this agent uses."""
        return {
            "PHM_AGENT_ID": str(agent),
            "PHM_DEMO": str(self.folder / str(agent)),
            "PHM_DEMO_PORT": str(self.ports.companion(agent)),
            "PHM_GCS_PORT": str(self.ports.ground),
        }

    def close(self) -> None:
        started = [*self._daemons.values(), *self._autopilots.values()]
        for process in started:
            process.kill()
        for process in started:
            process.wait(_END_S)

    def _start_daemon(self, agent: int) -> None:
        (self.folder / str(agent)).mkdir()
        words = ["phm.cli", "run", "--config", str(self.configuration)]
        self._daemons[agent] = self._spawn(f"phm{agent}", words, self.environment(agent))

    def _spawn(self, name: str, words: list[str], environment: dict[str, str]) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.out").open("ab") as output:
            return subprocess.Popen(
                [self._python, "-m", "phm.simulation.bound_process", str(os.getpid()), *words],
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,  # Ctrl-C ends `phm gcs` first; then `close` ends these
            )


class Demo(DemoAgents):
    """The agents of `phm demo`. `step` injects the faults that are due."""

    def __init__(self, folder: Path, ports: DemoPorts, python: str = sys.executable) -> None:
        super().__init__(folder, ports, python)
        self._due: list[tuple[float, Callable[[], None]]] = [
            (FAULTS[0][0], lambda: self.kill_autopilot(2)),
            (FAULTS[1][0], lambda: self.kill_daemon(3)),
            (FAULTS[2][0], lambda: self.start_autopilot(2)),
        ]

    def step(self, elapsed_s: float) -> None:
        """Inject every fault that is due `elapsed_s` after the start."""
        while self._due and self._due[0][0] <= elapsed_s:
            self._due.pop(0)[1]()
