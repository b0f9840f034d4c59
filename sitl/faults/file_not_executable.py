"""A file that must be executable loses its execute bits."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault
from sitl.faults.file_deleted import CRITICAL, critical_file_is_intact, put_back


class Injection(Fault):
    """`chmod a-x` on the critical file."""

    name, title, unit = "file_not_executable", "file not executable", "files/ros_app"
    condition = "file_not_executable"
    layer = "container"
    cause = "a file came without its execute bits, as a copy over FAT or a wrong umask leaves it"
    evidence, evidence_s = "the kernel's event of a change in the folder", 0.1

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.run_in_app("chmod", "a-x", CRITICAL)
        return moment

    def clear(self, agent: Agent) -> None:
        put_back(agent)

    def restored(self, agent: Agent) -> bool | None:
        return critical_file_is_intact(agent)
