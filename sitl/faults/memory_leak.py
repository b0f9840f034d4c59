"""A node leaks memory until the kernel ends it, after more than a minute."""

from __future__ import annotations

import contextlib
import time

from sitl.application.behaviour import LEAK
from sitl.faults._application import root, works
from sitl.faults._cgroups import cgroup
from sitl.faults.base import Agent, Fault

LASTS_S = 70.0
"""From the start of the leak to the limit. The campaign waits for an injection for at most 90 s."""
FULL_LIMIT_S = 2 * LASTS_S
USAGE = ("memory.current", "memory.usage_in_bytes")
LEAKS = "38"


class Injection(Fault):
    """Has node_1 take memory at a speed at which the container reaches its limit after 70 s. The node is the largest process by then,
    so the kernel ends it; the container and the other nodes go on. The container needs a memory limit."""

    name, title, unit = "memory_leak", f"node leaks memory for {LASTS_S:g} s, then is killed", "nodes/{agent}/node_1"
    condition = "node_missing"
    layer = "ros"
    cause = "a node leaks memory, and the kernel ends it at the limit of its container"
    evidence, evidence_s = "the kernel's out-of-memory killer ends the node", 0.0

    _generation = ""

    def inject(self, agent: Agent) -> float:
        app = agent.app
        limit = app.attrs["HostConfig"]["Memory"]
        if not limit:
            raise LookupError(f"{app.name} has no memory limit, so a leak would use up the memory of this machine")
        folder = cgroup(app, "memory")
        used = next(int((folder / name).read_text("ascii")) for name in USAGE if (folder / name).exists())
        self._generation = agent.generation
        agent.write_in_app(str(LEAK), f"{max(1.0, (limit - used) / LASTS_S):.0f}".encode())
        agent.signal_node("node_1", LEAKS)
        return _killed(agent)

    def clear(self, agent: Agent) -> None:
        agent.run_in_app("rm", "-f", str(LEAK))
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)


def _killed(agent: Agent) -> float:
    """The last moment at which node_1's process was known to run. Raises TimeoutError when it still runs after 140 s."""
    folder = root(agent)
    assert folder is not None  # it has just got a signal
    pid = (folder / "tmp/nodes/node_1.pid").read_text("ascii")
    ran = time.monotonic()
    until_s = ran + FULL_LIMIT_S
    while (now := time.monotonic()) < until_s:
        with contextlib.suppress(FileNotFoundError):  # the launcher removes the file
            if (folder / "tmp/nodes/node_1.pid").read_text("ascii") == pid:
                ran = now
                time.sleep(0.02)
                continue
        return ran
    raise TimeoutError(f"node_1 in {agent.app.name} still runs {FULL_LIMIT_S:g} s after it began to leak")
