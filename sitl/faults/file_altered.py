"""A file that the application needs has another content."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault
from sitl.faults.file_deleted import CONTENT, CRITICAL, critical_file_is_intact, put_back


class Injection(Fault):
    """Writes another content into the critical file; its SHA-256 must be configured for PHM to see it."""

    name, title, unit = "file_altered", "file altered", "files/ros_app"
    condition = "file_altered"
    layer = "container"
    cause = "a file was overwritten, by a bad update or a damaged disk"
    evidence, evidence_s = "the kernel's event of a change in the folder", 0.1

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.write_in_app(CRITICAL, CONTENT.replace(b"exit 0", b"exit 7"), 0o755)
        return moment

    def clear(self, agent: Agent) -> None:
        put_back(agent)

    def restored(self, agent: Agent) -> bool | None:
        return critical_file_is_intact(agent)
