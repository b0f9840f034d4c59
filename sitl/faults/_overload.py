"""Unconfigured containers, which want more processor time than there is, for a limited time."""

from __future__ import annotations

import contextlib
import os

from docker.errors import APIError, NotFound
from docker.models.containers import Container

from sitl.faults.base import Agent, undoing

LASTS_S = 60
HOGS = 4
"""Containers of an overload."""
LOOPS_PER_CORE = 8
"""Endless loops of an overload for each core of this machine, over all of its containers."""
WEIGHT = 16384
"""CPU shares of each: sixteen times the default, so that four containers weigh as much as sixty of a crowded machine."""
_SPIN = "i=1; while [ $i -lt {loops} ]; do (while :; do :; done) & i=$((i+1)); done; while :; do :; done"


def overload(
    agent: Agent,
    *,
    lasts_s: float = LASTS_S,
    loops_per_core: float = LOOPS_PER_CORE,
    hogs: int = HOGS,
    weight: int = WEIGHT,
) -> None:
    """Start `hogs` containers of this weight (CPU shares), with this many loops together.

    It ends by itself after `lasts_s`, and its containers are removed then. Interrupted, it leaves nothing behind. The containers are
    of the agent's project as orphans, so that `down` takes them, too, and below the same cgroup as the application.
    """
    end_overload(agent)
    app = agent.app
    loops = max(1, round(loops_per_core * (os.cpu_count() or 1) / hogs))
    with undoing(lambda: end_overload(agent)):
        for number in range(1, hogs + 1):
            agent.docker.containers.run(
                app.attrs["Image"],
                [_SPIN.format(loops=loops)],
                entrypoint=["timeout", "-s", "KILL", f"{lasts_s:g}", "sh", "-c"],
                name=f"{agent.project}-overload-{number}",
                detach=True,
                auto_remove=True,
                network_mode="none",
                healthcheck={"test": ["NONE"]},
                cpu_shares=weight,
                cgroup_parent=app.attrs["HostConfig"]["CgroupParent"] or None,
                labels={**app.labels, "com.docker.compose.service": "overload"},
            )


def end_overload(agent: Agent) -> None:
    """End it. Doing it twice is harmless."""
    for container in _hogs(agent):
        with contextlib.suppress(NotFound, APIError):
            container.remove(force=True)


def overloaded(agent: Agent) -> bool:
    """Whether a container of it is left."""
    return bool(_hogs(agent))


def _hogs(agent: Agent) -> list[Container]:
    prefix = f"{agent.project}-overload-"
    found = agent.docker.containers.list(all=True, filters={"name": prefix}, ignore_removed=True)
    return [container for container in found if str(container.name).startswith(prefix)]
