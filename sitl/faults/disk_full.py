"""A disk runs full."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping

from sitl.faults.base import Agent, Fault

BAGS, FILLER = "/tmp/bags", "/tmp/filler"
FILL = """
import os, sys, time
bags, filler, share, left, count, age = sys.argv[1], sys.argv[2], *map(float, sys.argv[3:])
whole = (seen := os.statvfs("/tmp")).f_blocks * seen.f_frsize
os.makedirs(bags, exist_ok=True)
for number in range(int(count)):
    with open(f"{bags}/flight_{number}.mcap", "wb") as bag:
        bag.write(bytes(int(whole * share / count)))
    os.utime(bag.name, (time.time() - age,) * 2)
with open(filler, "wb") as file:
    file.write(bytes(int((seen := os.statvfs("/tmp")).f_bavail * seen.f_frsize - whole * left)))
"""
SHARE, COUNT, AGE_S = "0.5", "4", "3600"
"""Of the disk, in recordings of earlier flights; how many they are, and how old."""
OLDER_THAN = "10s"
"""PHM knows an age only as far as it has watched the clock, and agents of a simulation are started just before."""
LEFT = "0.03"
"""Share of the disk that is left free: below PHM's limit, 5 %."""
ENOUGH = 0.1
"""Share above which the disk is OK again."""


class Injection(Fault):
    """Fills PHM's own /tmp, a separate disk of 32 MB in memory, down to 3 %: half of it with recordings of an
    hour ago, which PHM is configured to remove, the rest with a file of this moment, which it may not."""

    name, title, unit = "disk_full", "disk full", "host/disk"
    condition = "disk_full"
    layer = "companion"
    cause = "logs, bags or images have filled a disk"
    evidence, evidence_s = "the last write, after which the free share is below the limit", 0.5
    needs = frozenset({"configuration"})

    def configuration(self, agent: Agent) -> Mapping[str, str]:
        room = f"\n  free_disk:\n    - {{path: {BAGS}, files: ['*.mcap'], older_than: {OLDER_THAN}}}"
        return {"\n  disks: [/]": f"\n  disks: [/, /tmp]{room}"}

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        self._run(agent, "python", "-c", FILL, BAGS, FILLER, SHARE, LEFT, COUNT, AGE_S)
        return moment

    def clear(self, agent: Agent) -> None:
        self._run(agent, "rm", "-rf", FILLER, BAGS)

    def restored(self, agent: Agent) -> bool | None:
        state = agent.sidecar.attrs["State"]
        if not state["Running"]:
            return False
        seen = os.statvfs(f"/proc/{state['Pid']}/root/tmp")
        return seen.f_bavail > ENOUGH * seen.f_blocks

    @staticmethod
    def _run(agent: Agent, *argv: str) -> None:
        code, output = agent.sidecar.exec_run(list(argv))
        if code != 0:
            raise RuntimeError(f"{argv[0]} in {agent.sidecar.name} ended with {code}: {output!r}")
