"""The Docker Engine goes away and comes back; the containers live on."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping

from sitl.faults._engine_door import Door
from sitl.faults.base import Agent, Fault

AWAY_S = 15.0
SOCKET = "engine.sock"
_doors: dict[str, Door] = {}


class Injection(Fault):
    """Cuts PHM's connections to the engine and refuses new ones for a while, as a restart of the engine with `live-restore` does.

    The engine of this machine is everybody's, so it is not restarted: PHM is given a socket in its log folder, behind which a
    small relay of ours passes everything on, or does not. The relay lives in the process that prepared it.
    """

    name, title, unit = "engine_restarted", f"Docker Engine away for {AWAY_S:g} s", "engine"
    condition = "engine_down"
    layer = "companion"
    cause = "the Docker Engine was updated, crashed, or has no room left on its disk"
    healable = False
    passes = True
    needs = frozenset({"configuration"})

    def configuration(self, agent: Agent) -> Mapping[str, str]:
        return {"\n  socket: unix:///var/run/docker.sock": f"\n  socket: unix:///var/log/phm/{SOCKET}"}

    def prepare(self, agent: Agent) -> None:
        if agent.project not in _doors:
            assert agent.logs is not None, "an agent whose log folder is on this machine"
            _doors[agent.project] = Door(agent.logs / SOCKET)

    def dismantle(self, agent: Agent) -> None:
        door = _doors.pop(agent.project, None)
        if door is not None:
            door.close()

    def inject(self, agent: Agent) -> float:
        door = _doors[agent.project]
        moment = time.monotonic()
        door.shut()
        back = threading.Timer(AWAY_S, door.open)
        back.daemon = True
        back.start()
        return moment

    def clear(self, agent: Agent) -> None:
        if agent.project in _doors:
            _doors[agent.project].open()
