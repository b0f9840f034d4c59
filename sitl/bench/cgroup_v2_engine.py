"""PHM's pressure check on containers of a real Docker Engine that has cgroup v2 alone.

`scripts/test-kernel` runs it as root in a separate virtual machine. It starts an engine without networks, and makes an image
that holds nothing but busybox. Exit 0 only if each row shows the limit that was set.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tarfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from docker import DockerClient
from docker.errors import DockerException

from phm import testing
from phm.core.clock import SystemClock
from phm.probes.docker import Docker
from phm.probes.pressure import Pressure as Probe
from phm.transport.docker import DockerEngine
from phm_checks.pressure import Pressure
from sitl.bench.cgroup_v2 import Rows

SOCKET = "unix:///run/docker.sock"
ENGINE = (
    *("dockerd", "--host", SOCKET, "--storage-driver", "vfs", "--log-level", "error"),
    *("--bridge", "none", "--iptables=false", "--ip6tables=false"),
)
LOG = Path("/run/dockerd.log")
START_S, TIMEOUT_S = 240.0, 120
"""Emulated processors are slow."""
BUSYBOX, PROGRAMS = "/bin/busybox", ("sh", "sleep", "dd")
IMAGE, NAME, OTHER = "busybox:test", "ros_app", "greedy"
MIB = 1 << 20
IDLE = "exec sleep 6000"
BUSY = "while :; do :; done"
FORK = "sleep 6000 & sleep 6000 & sleep 6000 & wait"
"""Four processes. A shell that cannot start another one ends."""
FILL = "while :; do dd if=/dev/zero of=/dev/shm/data bs=1M count=48 2>/dev/null; done"


@contextmanager
def engine() -> Iterator[DockerClient]:
    """A Docker Engine for the time of this block."""
    with LOG.open("wb") as log:
        process = subprocess.Popen(ENGINE, stdout=log, stderr=log)
    try:
        yield _answering(process)
    finally:
        process.terminate()
        process.wait()


def _answering(process: subprocess.Popen[bytes]) -> DockerClient:
    end_s = time.monotonic() + START_S
    while True:
        try:
            return DockerClient(base_url=SOCKET, version="auto", timeout=TIMEOUT_S)
        except DockerException:
            if process.poll() is not None or time.monotonic() > end_s:
                print(LOG.read_text("utf-8", "replace"), flush=True)
                raise
        time.sleep(1.0)


def image(client: DockerClient) -> None:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        archive.add(BUSYBOX, "bin/busybox")
        for name in PROGRAMS:
            link = tarfile.TarInfo(f"bin/{name}")
            link.type, link.linkname = tarfile.SYMTYPE, "busybox"
            archive.addfile(link)
    repository, _, tag = IMAGE.partition(":")
    client.api.import_image_from_data(packed.getvalue(), repository=repository, tag=tag)


class ContainerRows(Rows):
    """The check on the container NAME, as in PHM."""

    def __init__(self, client: DockerClient) -> None:
        self.client = client
        settings = testing.settings(containers=[{"name": NAME}], docker={"socket": SOCKET, "timeout": "60s"})
        clock, phms = SystemClock(), DockerEngine(SOCKET, 60.0)
        self.docker = Docker(phms, settings.containers, settings.docker, clock)
        self.probe = Probe(phms, self.docker, settings.containers, settings.pressure, clock)
        (check,) = Pressure.build(settings)
        super().__init__(check, testing.world(clock=clock, docker=self.docker, pressure=self.probe))

    @contextmanager
    def running(self, command: str, name: str = NAME, **more: Any) -> Iterator[Any]:
        made = self.client.containers.run(
            IMAGE, ["/bin/sh", "-c", command], name=name, detach=True, network_mode="none", **more
        )
        self.docker.invalidate()
        try:
            yield made
        finally:
            made.remove(force=True)
            self.docker.invalidate()


def processor(rows: ContainerRows) -> None:
    with rows.running(BUSY) as made:
        made.update(cpu_period=100000, cpu_quota=3000)
        rows.row("CPU limit lowered to 3 %", "cpu_throttled")
        made.update(cpu_quota=-1)
        rows.row("limit removed")


def processes(rows: ContainerRows) -> None:
    with rows.running(FORK, pids_limit=4):
        rows.row("limit of processes reached", "pids_limit")


def memory(rows: ContainerRows) -> None:
    with rows.running(FILL, mem_limit=24 * MIB):
        rows.row("killed for lack of memory", "memory_pressure")


def others(rows: ContainerRows) -> None:
    """With the largest CPU weight that the engine knows."""
    with rows.running(f"{BUSY} & {BUSY} & {BUSY}"):
        rows.row("it uses the CPU")
        with rows.running(" & ".join([BUSY] * 12), OTHER, cpu_shares=262144):
            rows.row("another container takes the CPU", "cpu_starved")
        rows.row("it has ended")


def main() -> int:
    with engine() as client:
        about = client.info()
        print(f"Docker Engine {about['ServerVersion']}, cgroup version {about['CgroupVersion']}", flush=True)
        image(client)
        rows = ContainerRows(client)
        with rows.running(IDLE):
            rows.row("idle")
            fact = rows.probe.container(NAME)
            assert fact is not None and fact.source == "cgroup v2", fact
        for part in (processor, processes, memory, others):
            part(rows)
        return rows.end()


if __name__ == "__main__":
    sys.exit(main())
