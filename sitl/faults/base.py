"""What a fault is, and the agent it is injected into."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from datetime import datetime
from typing import ClassVar

from docker import DockerClient
from docker.models.containers import Container


@dataclass
class Agent:
    """One simulated agent on this machine's engine: its compose project, and names inside it."""

    project: str
    name: str
    docker: DockerClient = field(default_factory=DockerClient.from_env)

    def container(self, service: str) -> Container:
        """The project's container of a compose service; LookupError when there is none."""
        labels = [f"com.docker.compose.project={self.project}", f"com.docker.compose.service={service}"]
        found = self.docker.containers.list(all=True, filters={"label": labels})
        if not found:
            raise LookupError(f"the project {self.project} has no container of service {service}")
        return found[0]

    @property
    def app(self) -> Container:
        return self.container("ros_app")

    def run_in_app(self, *argv: str) -> str:
        """Run a command inside the application container and return what it printed."""
        code, output = self.app.exec_run(list(argv))
        assert isinstance(output, bytes)  # no stream was asked for
        text = output.decode(errors="replace").strip()
        if code != 0:
            raise RuntimeError(f"{' '.join(argv)} in {self.app.name} ended with {code}: {text}")
        return text


class Fault(ABC):
    """One kind of trouble.

    name: as in its file. title: words for a table. unit: id of the unit at which PHM must see it, with
    ``{agent}`` for the agent's name. healable: whether PHM is expected to heal it.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    unit: ClassVar[str]
    healable: ClassVar[bool] = True

    @abstractmethod
    def inject(self, agent: Agent) -> float:
        """Cause it; the moment from which it was there, in seconds of the monotonic clock, never too late."""

    def clear(self, agent: Agent) -> None:
        """Undo what healing by PHM does not undo. Doing it twice is harmless."""


def mono_of(engine_time: str) -> float:
    """An engine's time stamp (RFC 3339, nanoseconds) on this machine's monotonic clock."""
    head, _, fraction = engine_time.rstrip("Z").partition(".")
    utc = datetime.fromisoformat(f"{head}+00:00").timestamp() + float(f"0.{fraction or 0}")
    return time.monotonic() - (time.time() - utc)
