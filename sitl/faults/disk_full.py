"""A disk runs full."""

from __future__ import annotations

import time
from collections.abc import Mapping

from sitl.faults.base import Agent, Fault

FILLER = "/tmp/filler"
FILL = (
    "import os\nseen = os.statvfs('/tmp')\nwith open('{filler}', 'wb') as filler:\n"
    "    filler.write(bytes(int(seen.f_bavail * seen.f_frsize - seen.f_blocks * seen.f_frsize * {left})))\n"
)
LEFT = 0.03
"""Share of the disk that is left free: below PHM's limit, 5 %."""


class Injection(Fault):
    """Fills PHM's own /tmp, a disk in memory of 32 MB that is nobody else's, down to 3 %."""

    name, title, unit = "disk_full", "disk full", "host/disk"
    condition = "disk_full"
    layer = "companion"
    cause = "logs, bags or images have filled a disk"
    healable = False
    needs = frozenset({"configuration"})

    def configuration(self, agent: Agent) -> Mapping[str, str]:
        return {"\n  disks: [/]": "\n  disks: [/, /tmp]"}

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        self._run(agent, "python", "-c", FILL.format(filler=FILLER, left=LEFT))
        return moment

    def clear(self, agent: Agent) -> None:
        self._run(agent, "rm", "-f", FILLER)

    @staticmethod
    def _run(agent: Agent, *argv: str) -> None:
        code, output = agent.sidecar.exec_run(list(argv))
        if code != 0:
            raise RuntimeError(f"{argv[0]} in {agent.sidecar.name} ended with {code}: {output!r}")
