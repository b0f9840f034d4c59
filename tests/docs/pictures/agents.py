"""The agents of the pictures of `phm status` and `phm gcs`: those of `phm demo`, with an application each, and real faults."""

from __future__ import annotations

import contextlib
import random
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from phm.simulation.demo import DemoAgents, DemoPorts
from phm.wire import status_file
from tests.docs.pictures.relay import Relay
from tests.fakes.mavlink import free_port

BUSY = 2
"""The agent with the two faults: a half-open connection, which PHM reopens, and a planner that has ended."""
DEAD = 4
"""The agent whose PHM is killed."""


class PictureAgents(DemoAgents):
    """Four agents. Each has a web server in place of an application; between agent 2 and its autopilot is a relay."""

    agents = (1, 2, 3, 4)
    configuration = Path(__file__).with_name("agent.yaml")
    companion_scheme = "tcpin"

    def __init__(self, folder: Path, ports: DemoPorts) -> None:
        super().__init__(folder, ports)
        self._planners: dict[int, subprocess.Popen[bytes]] = {}
        self._planner_ports = {agent: free_port() for agent in self.agents}
        self.relay = Relay(ports.companion(BUSY))

    def start(self) -> None:
        for agent, port in self._planner_ports.items():
            files = self.folder / f"planner_{agent}"  # the name by which the check `planner` finds the process
            files.mkdir()
            words = [sys.executable, "-m", "http.server", str(port), "--bind", "127.0.0.1", "--directory", str(files)]
            self._planners[agent] = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
        super().start()

    def environment(self, agent: int) -> dict[str, str]:
        port = self.relay.port if agent == BUSY else self.ports.companion(agent)
        ours = {"PHM_DEMO_PORT": str(port), "PHM_PLANNER_PORT": str(self._planner_ports[agent])}
        return {**super().environment(agent), **ours}

    def kill_planner(self, agent: int) -> None:
        self._planners[agent].kill()
        self._planners[agent].wait(60)

    def status(self, agent: int) -> dict[str, Any]:
        """What the agent's daemon says about itself; empty before it says anything."""
        with contextlib.suppress(status_file.NoStatus):
            return status_file.read(str(self.run_dir(agent)))
        return {}

    def logs(self) -> dict[str, str]:
        """The last words of each daemon, for an error."""
        return {path.name: path.read_text("utf-8", "replace")[-500:] for path in sorted(self.folder.glob("phm*.out"))}

    def close(self) -> None:
        for planner in self._planners.values():
            planner.kill()
            planner.wait(60)
        super().close()
        self.relay.close()


@contextlib.contextmanager
def agents(folder: Path, ports: DemoPorts) -> Iterator[PictureAgents]:
    """The agents, started; all of them end with the block."""
    made = PictureAgents(folder, ports)
    try:
        made.start()
        yield made
    finally:
        made.close()


def free_ports(ground: int | None = None) -> DemoPorts:
    """Ports of autopilots that are not in use. ground: that of `phm gcs`; default: one that is not in use.

    They are below those that the kernel chooses for connections: a connection of another program would take one meanwhile.
    """
    while True:
        chosen = DemoPorts(random.randrange(20000, 32000), ground or free_port(socket.SOCK_DGRAM))
        if all(_is_free(chosen.companion(agent)) for agent in PictureAgents.agents):
            return chosen


def _is_free(port: int) -> bool:
    with socket.socket() as sock, contextlib.suppress(OSError):
        sock.bind(("127.0.0.1", port))
        return True
    return False
