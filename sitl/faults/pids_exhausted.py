"""The application is at its limit of processes."""

from __future__ import annotations

import time

from sitl.faults._cgroups import cgroup, update
from sitl.faults._container_process import LASTS_S, end, processes, start
from sitl.faults.base import Agent, Fault, undoing

ROOM = 16
MOST = 4 * ROOM
"""It goes on where others end: a health check that ran when the limit was set leaves room when it has ended."""
MARK = "phm_holds_pids"
HOLD = f"""
import os, signal, time
held, until = 0, time.monotonic() + {LASTS_S}
mark = "{MARK}"
while time.monotonic() < until:
    try:
        if held < {MOST} and os.fork() == 0:
            signal.alarm({LASTS_S})
            signal.pause()
        held += held < {MOST}
    except BlockingIOError:
        pass
    time.sleep(0.02)
"""
FULL_LIMIT_S = 30.0


class Injection(Fault):
    """``docker update --pids-limit`` to 16 more than there are, and a process in the container that takes them all and
    keeps them: nothing there can start a thread or a process any more. What `docker exec` runs is beyond this limit, its children
    are not."""

    name, title, unit = "pids_exhausted", "limit of processes reached", "pressure/ros_app"
    condition = "pids_limit"
    layer = "container"
    cause = "the application leaks threads or processes up to the limit of its container"
    healable = False
    needs = frozenset({"starvation"})
    evidence, evidence_s = "the first process that the kernel refuses", 0.1

    _restore: list[str] = []

    def inject(self, agent: Agent) -> float:
        app = agent.app
        folder = cgroup(app, "pids")
        self._restore = self._restore or ["--pids-limit", str(app.attrs["HostConfig"]["PidsLimit"] or -1)]
        limit = int((folder / "pids.current").read_text("ascii")) + ROOM
        until_s = time.monotonic() + FULL_LIMIT_S
        with undoing(lambda: self.clear(agent)):
            update(app, "--pids-limit", str(limit))
            start(agent, MARK, "python3", "-c", HOLD)
            below = now = time.monotonic()
            while int((folder / "pids.current").read_text("ascii")) < limit:
                below = now
                if time.monotonic() > until_s:
                    raise TimeoutError(
                        f"{app.name} has not reached its limit of {limit} processes in {FULL_LIMIT_S:g} s"
                    )
                time.sleep(0.01)
                now = time.monotonic()
        return below

    def clear(self, agent: Agent) -> None:
        end(agent, MARK)
        if self._restore:
            update(agent.app, *self._restore)
            self._restore = []

    def restored(self, agent: Agent) -> bool | None:
        as_before = not self._restore or str(agent.app.attrs["HostConfig"]["PidsLimit"] or -1) == self._restore[1]
        return as_before and processes(agent, MARK) == []
