"""A container that takes processor time or memory of this machine for a while, within limits, and then ends by itself."""

from __future__ import annotations

import contextlib
from typing import Any

from docker.errors import NotFound

from sitl.faults.base import Agent

LASTS_S = 90
"""The load ends after this long, even if its injector is gone."""


def start_load(agent: Agent, script: str, **limits: Any) -> None:
    """Run a Python script in a container of the agent's project, as one of its orphans, so that `down` takes it, too."""
    stop_load(agent)
    app = agent.app
    agent.docker.containers.run(
        app.attrs["Image"],
        ["-c", script],
        entrypoint=["timeout", str(LASTS_S), "python"],
        name=_name(agent),
        detach=True,
        network_mode="none",
        labels={**app.labels, "com.docker.compose.service": "burden"},
        **limits,
    )


def stop_load(agent: Agent) -> None:
    """End it. Doing it twice is harmless."""
    with contextlib.suppress(NotFound):
        agent.docker.containers.get(_name(agent)).remove(force=True)


def loaded(agent: Agent) -> bool:
    """Whether it runs."""
    with contextlib.suppress(NotFound):
        return bool(agent.docker.containers.get(_name(agent)).attrs["State"]["Running"])
    return False


def _name(agent: Agent) -> str:
    return f"{agent.project}-burden-1"
