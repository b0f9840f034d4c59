"""The load *busy*: containers that PHM does not know keep all cores of this machine busy while a campaign runs."""

from __future__ import annotations

import contextlib
import os
import time

from docker.errors import APIError, NotFound

from sitl.swarm import engine
from sitl.swarm.swarm import Swarm

LASTS_S = 1200
"""Each ends by itself after this long, also if the campaign was killed."""
RENEW_S = 300.0
"""A trial may take ten minutes and more, so older ones are replaced before it begins."""
SPIN = "while :; do :; done"


class BusyLoad:
    """One container for each core, with an endless loop at Docker's default CPU weight."""

    def __init__(self, swarm: Swarm, cores: int | None = None) -> None:
        self._swarm, self._cores = swarm, cores or os.cpu_count() or 1
        self._since: float | None = None
        self._runs = 0

    def keep(self) -> None:
        """Start it, or replace it when it would end soon."""
        if self._since is not None and time.monotonic() - self._since < RENEW_S:
            return
        self.stop()
        self._runs += 1
        app = self._swarm.agents[0].app
        for number in range(1, self._cores + 1):
            self._swarm.docker.containers.run(
                app.attrs["Image"],
                [SPIN],
                entrypoint=["timeout", "-s", "KILL", str(LASTS_S), "sh", "-c"],
                name=f"{self._prefix}{os.getpid()}-{self._runs}-{number}",
                detach=True,
                auto_remove=True,
                network_mode="none",
                healthcheck={"test": ["NONE"]},
                mem_limit="32m",
                pids_limit=16,
                # With this label, `down` removes it, too.
                labels={engine.LABEL: self._swarm.name},
            )
        self._since = time.monotonic()

    def stop(self) -> None:
        """End it. Doing it twice is harmless."""
        self._since = None
        containers = self._swarm.docker.containers
        for one in containers.list(all=True, filters={"name": self._prefix}, ignore_removed=True):
            if str(one.name).startswith(self._prefix):
                with contextlib.suppress(NotFound, APIError):
                    one.remove(force=True)

    @property
    def _prefix(self) -> str:
        return f"{self._swarm.name}-busy-"
