"""The application's memory limit is just above what it uses."""

from __future__ import annotations

import time

from sitl.faults._cgroups import update
from sitl.faults._inmate import end, start
from sitl.faults.base import Agent, Fault, undoing

MIB = 2**20
ROOM = 32 * MIB
"""Left above what cannot be reclaimed: the engine's own process of a health check takes up to 20 MiB for a moment, and must
not be what the kernel ends."""
FILE = "/tmp/phm_tight_memory"
SCAN = f"dd if=/dev/zero of={FILE} bs=1M count=128; while :; do dd if={FILE} of=/dev/null bs=1M; done"


class Injection(Fault):
    """A process in the application container reads a file again and again that is larger than the memory left, so that the
    kernel reclaims without end. Nothing is killed. The container needs a limit already: the engine cannot take one away."""

    name, title, unit = "memory_tight", "memory limit just above use", "pressure/ros_app"
    condition = "memory_pressure"
    layer = "container"
    cause = "the application has outgrown its memory limit, and the kernel reclaims its pages all the time"
    healable = False
    needs = frozenset({"starvation"})

    _restore: list[str] = []

    def inject(self, agent: Agent) -> float:
        app = agent.app
        host = app.attrs["HostConfig"]
        if not host["Memory"]:
            raise LookupError(
                f"{app.name} has no memory limit, and the engine could not take away one that it is given"
            )
        self._restore = self._restore or ["--memory", str(host["Memory"]), "--memory-swap", str(host["MemorySwap"])]
        answer = app.stats(stream=False)
        assert isinstance(answer, dict)  # no stream was asked for
        stats = answer["memory_stats"]
        detail = stats["stats"]
        cache = detail.get("total_inactive_file", detail.get("inactive_file", 0))
        cache += detail.get("total_active_file", detail.get("active_file", 0))
        limit = str(stats["usage"] - cache + ROOM)
        moment = time.monotonic()
        with undoing(lambda: self.clear(agent)):
            update(app, "--memory", limit, "--memory-swap", limit)
            start(agent, FILE, "sh", "-c", SCAN)
        return moment

    def clear(self, agent: Agent) -> None:
        if self._restore:
            update(agent.app, *self._restore)
            self._restore = []
        end(agent, FILE)
        if agent.app.status == "running":
            agent.run_in_app("rm", "-f", FILE)
