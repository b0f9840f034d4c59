"""A file that the application needs is deleted."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault

CRITICAL = "/ws/src/critical_file"
CONTENT = b"#!/bin/sh\nexit 0\n"
"""As docker/Dockerfile makes it."""


class Injection(Fault):
    """Removes the critical file from the application's volume."""

    name, title, unit = "file_deleted", "file deleted", "files/ros_app"
    condition = "file_missing"
    layer = "container"
    cause = "a file that the application needs was removed"

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.run_in_app("rm", CRITICAL)
        return moment

    def clear(self, agent: Agent) -> None:
        put_back(agent)


def put_back(agent: Agent) -> None:
    """The critical file as the image brings it."""
    agent.write_in_app(CRITICAL, CONTENT, 0o755)
