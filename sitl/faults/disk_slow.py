"""The application's disk is slow."""

from __future__ import annotations

import contextlib
import time

from sitl.faults._cgroups import cgroup, disk, throttle, throttled
from sitl.faults._container_process import end, processes, start
from sitl.faults.base import Agent, Fault, undoing

BYTES_S = 256 * 1024
FILE = "/tmp/phm_slow_disk"
WRITERS = (1, 2, 3, 4)
WRITE = f"while :; do dd if=/dev/zero of={FILE} bs=64k count=8 conv=fsync; done"


class Injection(Fault):
    """Reads and writes of the application's cgroup are limited to 256 KiB a second (`io.max`, or `blkio.throttle.*` on
    cgroup v1), and four processes in it write and wait for the disk. A start of the container gives it a cgroup without
    the limit; on v1 what the kernel writes back later in its name is not limited, so the writers sync: half a MiB at a time, since a process that waits for
    its disk cannot be killed, nor its container be stopped."""

    name, title, unit = "disk_slow", "slow disk", "pressure/ros_app"
    condition = "io_pressure"
    layer = "container"
    cause = "an SD card stalls, or others use up what the disk can do"
    healable = False
    needs = frozenset({"starvation"})
    evidence, evidence_s = "the first write that the kernel delays", 1.0

    def inject(self, agent: Agent) -> float:
        device = self._device(agent)
        moment = time.monotonic()
        with undoing(lambda: self.clear(agent)):
            throttle(cgroup(agent.app, "blkio"), device, BYTES_S)
            for number in WRITERS:
                start(agent, FILE, "sh", "-c", WRITE.replace(FILE, f"{FILE}_{number}"))
        return moment

    def clear(self, agent: Agent) -> None:
        with contextlib.suppress(LookupError, FileNotFoundError):  # a container that has ended has no cgroup
            throttle(cgroup(agent.app, "blkio"), self._device(agent), 0)
        end(agent, FILE)
        if agent.app.status == "running":
            agent.run_in_app("rm", "-f", *(f"{FILE}_{number}" for number in WRITERS))

    def restored(self, agent: Agent) -> bool | None:
        return not throttled(cgroup(agent.app, "blkio"), self._device(agent)) and processes(agent, FILE) == []

    @staticmethod
    def _device(agent: Agent) -> str:
        return disk(str(agent.docker.info()["DockerRootDir"]))
