"""A file that the application needs is deleted."""

from __future__ import annotations

import io
import tarfile
import time

from docker.errors import NotFound

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
    evidence, evidence_s = "the kernel's event of a change in the folder", 0.1

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.run_in_app("rm", CRITICAL)
        return moment

    def clear(self, agent: Agent) -> None:
        put_back(agent)

    def restored(self, agent: Agent) -> bool | None:
        return critical_file_is_intact(agent)


def put_back(agent: Agent) -> None:
    """The critical file as the image brings it."""
    agent.write_in_app(CRITICAL, CONTENT, 0o755)


def critical_file_is_intact(agent: Agent) -> bool:
    """Whether the critical file has its content and its execute bits."""
    try:
        stream, _ = agent.app.get_archive(CRITICAL)
    except NotFound:
        return False
    with tarfile.open(fileobj=io.BytesIO(b"".join(stream))) as archive:
        (entry,) = archive.getmembers()
        file = archive.extractfile(entry)
        return file is not None and bool(entry.mode & 0o111) and file.read() == CONTENT
