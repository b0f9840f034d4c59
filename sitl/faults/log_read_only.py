"""PHM's log volume turns read-only."""

from __future__ import annotations

import time
from pathlib import Path

from sitl.faults._volumes import behind, immutable, set_immutable
from sitl.faults.base import Agent, Fault

FOLDER = "/var/log/phm"
FILES = ("phm.log", "phm.jsonl")


class Injection(Fault):
    """Makes the files of PHM's log immutable, on this machine: a volume with open files cannot be remounted read-only, and an SD card
    that turns read-only by itself refuses writes to open files, too. PHM keeps its lines in memory and must lose none; since its
    record cannot be written meanwhile, only the ground and `phm status` see the warning at the time."""

    name, title, unit = "log_read_only", "log volume read-only", "companion"
    condition = "phm_problem"
    level = "WARN"
    layer = "companion"
    healable = False
    delays_record = True
    cause = "an SD card at its end of life, or a damaged file system, takes no more writes"
    evidence, evidence_s = "the first line that PHM cannot write, at the latest that of its next report", 3.0
    evidence_period_s = 3.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        for file in _files(agent):
            set_immutable(file, on=True)
        return moment

    def clear(self, agent: Agent) -> None:
        for file in _files(agent):
            set_immutable(file, on=False)

    def restored(self, agent: Agent) -> bool | None:
        return not any(immutable(file) for file in _files(agent))


def _files(agent: Agent) -> list[Path]:
    folder = behind(agent.sidecar, FOLDER)
    return [folder / name for name in FILES]
