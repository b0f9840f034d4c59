"""The Docker Engine goes away and comes back; the containers live on."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from sitl.faults._docker_proxy import block, responds, start, stop
from sitl.faults.base import Agent, Fault

AWAY_S = 25.0
"""Longer than PHM's wait before it reports from a cgroup alone that a container has ended (`phm_checks.container.WITHOUT_ENGINE_S`,
15 s): if the engine returned just then, a campaign would never measure that."""
SOCKET = "engine.sock"


class Injection(Fault):
    """Cuts PHM's connections to the engine and refuses new ones for a while, as a restart of the engine with `live-restore` does.

    The engine of this machine is everybody's, so it is not restarted: PHM is given a socket in its log folder, behind which a
    small relay of ours passes everything on, or does not.
    """

    name, title, unit = "engine_restarted", "Docker Engine away", "engine"
    condition = "engine_down"
    layer = "companion"
    cause = "the Docker Engine was updated, crashed, or has no room left on its disk"
    healable = False
    passes = True
    needs = frozenset({"configuration"})
    prepared = "a relay between PHM and the engine's socket"
    outage_s = AWAY_S
    evidence, evidence_s = "the engine closes the connection of PHM's event stream", 0.3

    def configuration(self, agent: Agent) -> Mapping[str, str]:
        return {"\n  socket: ${PHM_ENGINE:-unix:///var/run/docker.sock}": f"\n  socket: unix:///var/log/phm/{SOCKET}"}

    def prepare(self, agent: Agent) -> None:
        start(self._door(agent))

    def dismantle(self, agent: Agent) -> None:
        stop(self._door(agent))

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        block(self._door(agent), AWAY_S)
        return moment

    def clear(self, agent: Agent) -> None:
        block(self._door(agent), 0.0)

    def restored(self, agent: Agent) -> bool | None:
        return responds(self._door(agent))

    @staticmethod
    def _door(agent: Agent) -> Path:
        if agent.logs is None:
            raise LookupError(
                f"{agent.name} has no log folder on this machine, through which its engine could be reached"
            )
        return agent.logs / SOCKET
