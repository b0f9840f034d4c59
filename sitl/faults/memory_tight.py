"""The application's memory limit is just above what it uses."""

from __future__ import annotations

import time

from sitl.faults._cgroups import update
from sitl.faults._container_process import end, processes, start
from sitl.faults.base import Agent, Fault, undoing

MIB = 2**20
ROOM = 32 * MIB
"""Left above what cannot be reclaimed: the engine's own process of a health check takes up to 20 MiB for a moment, and must
not be what the kernel ends."""
FILE = "/tmp/phm_tight_memory"
SIZE = 64 * MIB
SCAN = f"""
import mmap, os
with open("{FILE}", "wb") as file:
    for _ in range({SIZE // MIB}):
        file.write(os.urandom({MIB}))
pages = mmap.mmap(os.open("{FILE}", os.O_RDONLY), {SIZE}, prot=mmap.PROT_READ)
pages.madvise(mmap.MADV_RANDOM)
while True:
    sum(pages[place] for place in range(0, {SIZE}, 4096))
"""


class Injection(Fault):
    """A process in the application container needs the pages of a mapped file again and again, as a program needs its code, and
    there is no room for all of them: the kernel drops them and reads them back without end. Nothing is killed. A file that is
    read through would not do: the page cache fills any limit, and no one waits for it. The container needs a limit already: the
    engine cannot take one away."""

    name, title, unit = "memory_tight", "memory limit just above use", "pressure/ros_app"
    condition = "memory_pressure"
    layer = "container"
    cause = "the application has outgrown its memory limit, and the kernel reclaims its pages all the time"
    healable = False
    needs = frozenset({"starvation"})
    evidence, evidence_s = "the first page that the kernel takes from the container to stay below its limit", 1.0

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
            start(agent, FILE, "python3", "-c", SCAN)
        return moment

    def clear(self, agent: Agent) -> None:
        if self._restore:
            update(agent.app, *self._restore)
            self._restore = []
        end(agent, FILE)
        if agent.app.status == "running":
            agent.run_in_app("rm", "-f", FILE)

    def restored(self, agent: Agent) -> bool | None:
        if not self._restore:
            return processes(agent, FILE) == []
        return str(agent.app.attrs["HostConfig"]["Memory"]) == self._restore[1] and processes(agent, FILE) == []
