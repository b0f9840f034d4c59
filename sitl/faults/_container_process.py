"""A process started inside the application container, for a limited time, and ended from this machine."""

from __future__ import annotations

import contextlib
import os
import signal
import time

from docker.errors import APIError

from sitl.faults.base import Agent

LASTS_S = 90
"""It ends by itself after this long, also when whatever started it was killed."""
END_LIMIT_S = 20.0
POLL_S = 0.05


def start(agent: Agent, mark: str, *argv: str) -> None:
    """Start a command whose words contain `mark`, and nothing else's in that container."""
    agent.app.exec_run(["timeout", "-s", "KILL", str(LASTS_S), *argv], detach=True)


def end(agent: Agent, mark: str) -> None:
    """SIGKILL to all that has `mark` in its command line, until nothing has. Doing it twice is harmless.

    From this machine and not by `docker exec`, which fails where the container is at its limit of processes. Raises
    TimeoutError when some are left after 20 s.
    """
    until_s = time.monotonic() + END_LIMIT_S
    while pids := processes(agent, mark):
        if time.monotonic() > until_s:
            raise TimeoutError(f"{len(pids)} processes of {mark} in {agent.app.name} do not end")
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(POLL_S)


def processes(agent: Agent, mark: str) -> list[int]:
    """Process ids on this machine of what has `mark` in its command line; none where the container does not run."""
    try:
        return agent.processes(agent.app, mark)
    except APIError:
        return []
