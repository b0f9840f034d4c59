"""The companion computer loses its power, and starts again."""

from __future__ import annotations

import contextlib
import time

from docker.errors import APIError
from docker.models.containers import Container

from sitl.faults._processes import held, kill
from sitl.faults._world import app_runs, runs
from sitl.faults.base import Agent, Fault

DOWN_LIMIT_S = 10.0


class Injection(Fault):
    """SIGKILL to all processes of the companion computer's containers in one moment: PHM, the application and the router. Volumes
    stay unchanged. Then the engine's restart policy starts PHM, as at a boot; the router is started as if it had such a policy, the
    application, which has none, is PHM's to start. What is only in memory (tmpfs) is lost. The page cache is not: this machine
    goes on."""

    name, title, unit = "power_loss", "power lost, all containers killed", "container/ros_app"
    condition = "exited"
    layer = "container"
    cause = "the companion computer lost its power and booted again"
    evidence, evidence_s = "the kernel ends the process, and the engine reports the end of its container", 0.1

    def inject(self, agent: Agent) -> float:
        containers = list(_on_board(agent))
        with contextlib.ExitStack() as stack:
            # The processes of all containers first: asking the engine for the next one takes time.
            found = [each for container in containers for each in stack.enter_context(held(_pids(container)))]
            moment = time.monotonic()
            for each in found:
                kill(each)
        with contextlib.suppress(LookupError):
            _start(agent.router)
        return moment

    def clear(self, agent: Agent) -> None:
        for container in _on_board(agent):
            if container.status != "running":
                container.start()

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent) and all(runs(container) for container in _on_board(agent))


def _on_board(agent: Agent) -> list[Container]:
    """PHM, the application and, if there is one, the router. An autopilot is a separate computer."""
    found = [agent.sidecar, agent.app]
    with contextlib.suppress(LookupError):
        found.append(agent.router)
    return found


def _pids(container: Container) -> list[int]:
    """The first process last: its end ends the container, and the kernel the others."""
    with contextlib.suppress(APIError):
        return [int(row[0]) for row in container.top(ps_args="-eo pid")["Processes"] or ()][::-1]
    return []


def _start(container: Container) -> None:
    """Start a container that was just killed, as soon as the engine knows its end."""
    container.wait(timeout=DOWN_LIMIT_S)
    container.start()
