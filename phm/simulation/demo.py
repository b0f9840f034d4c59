"""The processes of `phm demo`: three agents, each a real PHM daemon with a simulated autopilot, and two injected faults."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

AGENTS = (1, 2, 3)
FAULTS = (
    (18.0, "the autopilot of agent 2 is killed"),
    (28.0, "the PHM of agent 3 is killed"),
    (40.0, "the autopilot of agent 2 is started again"),
)
"""(Seconds after the start, what happens then)."""
CONFIGURATION = Path(__file__).with_name("demo.yaml")
_END_S = 5.0


@dataclass(frozen=True, slots=True)
class DemoPorts:
    """UDP and TCP ports on loopback: `first` to `first` + 20 are the autopilots', `ground` is that of `phm gcs`."""

    first: int = 14600
    ground: int = 14551

    def companion(self, agent: int) -> int:
        return self.first + agent

    def ground_of(self, agent: int) -> int:
        return self.first + 10 + agent


class Demo:
    """Starts and ends the processes. `step` injects what is due; `close` kills everything that was started.

    folder: gets a folder of logs and state for each agent.
    """

    def __init__(self, folder: Path, ports: DemoPorts, python: str = sys.executable) -> None:
        self._folder, self._ports, self._python = folder, ports, python
        self._autopilots: dict[int, subprocess.Popen[bytes]] = {}
        self._daemons: dict[int, subprocess.Popen[bytes]] = {}
        self._due: list[tuple[float, Callable[[], None]]] = [
            (FAULTS[0][0], self._autopilots_end),
            (FAULTS[1][0], self._daemon_ends),
            (FAULTS[2][0], lambda: self._start_autopilot(2)),
        ]

    def start(self) -> None:
        for agent in AGENTS:
            self._start_autopilot(agent)
            self._start_daemon(agent)

    def step(self, elapsed_s: float) -> None:
        """Inject every fault that is due `elapsed_s` after the start."""
        while self._due and self._due[0][0] <= elapsed_s:
            self._due.pop(0)[1]()

    def close(self) -> None:
        started = [*self._daemons.values(), *self._autopilots.values()]
        for process in started:
            process.kill()
        for process in started:
            process.wait(_END_S)

    def _autopilots_end(self) -> None:
        self._autopilots[2].kill()
        self._autopilots[2].wait(_END_S)

    def _daemon_ends(self) -> None:
        self._daemons[3].kill()

    def _start_autopilot(self, agent: int) -> None:
        companion = f"udpin:127.0.0.1:{self._ports.companion(agent)}"
        ground = f"tcpin:127.0.0.1:{self._ports.ground_of(agent)}"
        words = ["-m", "phm.simulation.autopilot", "--id", str(agent), "--companion", companion, "--ground", ground]
        self._autopilots[agent] = self._spawn(f"autopilot{agent}", words, {})

    def _start_daemon(self, agent: int) -> None:
        folder = self._folder / str(agent)
        folder.mkdir()
        environment = {
            "PHM_AGENT_ID": str(agent),
            "PHM_DEMO": str(folder),
            "PHM_DEMO_PORT": str(self._ports.companion(agent)),
            "PHM_GCS_PORT": str(self._ports.ground),
        }
        words = ["-m", "phm.cli", "run", "--config", str(CONFIGURATION)]
        self._daemons[agent] = self._spawn(f"phm{agent}", words, environment)

    def _spawn(self, name: str, words: list[str], environment: dict[str, str]) -> subprocess.Popen[bytes]:
        with (self._folder / f"{name}.out").open("ab") as output:
            return subprocess.Popen(
                [self._python, *words],
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,  # Ctrl-C ends `phm gcs` first; then `close` ends these
            )
