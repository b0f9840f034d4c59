"""PHM's pressure check on a kernel with cgroup v2 alone: real limits, real processes, no engine.

`scripts/test-kernel` runs it as root in a separate virtual machine; it changes limits below /sys/fs/cgroup, and needs a disk
/dev/vda that may be overwritten. Exit 0 only if each row is what the kernel was made to do.
"""

from __future__ import annotations

import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from phm import api, testing
from phm.api import Level
from phm.core.clock import SystemClock
from phm.probes.pressure import Pressure as Probe
from phm.transport.docker import DockerEngine
from phm_checks.pressure import Pressure

ROOT = Path("/sys/fs/cgroup")
DISK = "/dev/vda"
LIMIT_S = 90.0
POLL_S = 0.5
MIB = 1 << 20
IDS = ("ab" * 32, "cd" * 32)
"""As of a container that is watched and of another one."""
IDLE = "import signal\nsignal.pause()"
BUSY = "while True: pass"
FORK = """
import os, signal
for _ in range(20):
    try:
        if os.fork() == 0:
            break
    except OSError:
        pass
signal.pause()
"""
REREAD = f"""
import mmap, os
pages = mmap.mmap(os.open({DISK!r}, os.O_RDONLY), {48 * MIB}, prot=mmap.PROT_READ)
pages.madvise(mmap.MADV_RANDOM)
while True:
    sum(pages[place] for place in range(0, len(pages), 4096))
"""
WRITE = f"""
import mmap, os
disk, data = os.open({DISK!r}, os.O_RDWR | os.O_DIRECT), mmap.mmap(-1, {MIB})
while True:
    os.lseek(disk, 0, 0)
    os.write(disk, data)
"""
ALLOCATE = f"data = bytearray({64 * MIB})\nfor place in range(0, len(data), 4096): data[place] = 1"


class Rows:
    """What the check says, row by row. bad: the number of rows that are not as expected."""

    def __init__(self, check: api.Check, world: api.World) -> None:
        self.check, self.world, self.bad = check, world, 0

    def row(self, title: str, condition: str = "") -> None:
        """Look until the check is in ERROR with that condition, or OK if there is none."""
        level = Level.ERROR if condition else Level.OK

        def wanted(result: api.Result) -> bool:
            return result.level is level and condition in ("", result.condition)

        end_s, result = time.monotonic() + LIMIT_S, self.run_check()
        while not wanted(result) and time.monotonic() < end_s:
            time.sleep(POLL_S)
            result = self.run_check()
        self.bad += not wanted(result)
        verdict = "as expected" if wanted(result) else f"NOT {condition or 'OK'}"
        print(f"{title}: {verdict}: {result.level.name} {result.summary}", flush=True)

    def run_check(self) -> api.Result:
        result = self.check.run(self.world)
        assert isinstance(result, api.Result)
        return result

    def end(self) -> int:
        """Say how many are not as expected; the exit code."""
        print(f"{self.bad} rows are not as expected", flush=True)
        return 1 if self.bad else 0


class GroupRows(Rows):
    """Cgroups as Docker makes them, and the check on the first."""

    def __init__(self) -> None:
        (ROOT / "cgroup.subtree_control").write_text("+cpu +io +memory +pids")
        parent = ROOT / "docker"
        parent.mkdir()
        (parent / "cgroup.subtree_control").write_text("+cpu +io +memory +pids")
        self.group, self.other = (parent / name for name in IDS)
        self.group.mkdir()
        self.other.mkdir()
        settings = testing.settings(containers=[{"name": "ros_app"}], pressure={"cgroups": str(ROOT)})
        clock, docker = SystemClock(), testing.FakeDocker(testing.container("ros_app", id=IDS[0]))
        engine = DockerEngine("unix:///nowhere")
        self.probe = Probe(engine, docker, settings.containers, settings.pressure, clock)
        (check,) = Pressure.build(settings)
        super().__init__(check, testing.world(clock=clock, docker=docker, pressure=self.probe))

    def limit(self, name: str, value: object) -> None:
        (self.group / name).write_text(str(value))

    def until_used(self, size: int) -> None:
        """Wait until the processes and their page cache use that many bytes."""
        end_s = time.monotonic() + LIMIT_S
        while (used := int((self.group / "memory.current").read_text())) < size:
            if time.monotonic() > end_s:
                raise TimeoutError(f"{used} bytes are used after {LIMIT_S:g} s, expected {size}")
            time.sleep(POLL_S)

    @contextmanager
    def running(self, *programs: str, others: bool = False) -> Iterator[None]:
        """Python programs in the watched cgroup, or in the other one."""
        group = self.other if others else self.group
        enter = f"open({str(group / 'cgroup.procs')!r}, 'w').write('0')\n"
        started = [
            subprocess.Popen([sys.executable, "-S", "-c", enter + code], start_new_session=True) for code in programs
        ]
        try:
            yield
        finally:
            for one in started:
                os.killpg(one.pid, signal.SIGKILL)  # with its children
            for one in started:
                one.wait()


def processor(rows: GroupRows) -> None:
    with rows.running(BUSY):
        rows.limit("cpu.max", "3000 100000")
        rows.row("CPU limit lowered to 3 %", "cpu_throttled")
    rows.limit("cpu.max", "max 100000")
    rows.row("limit removed")


def processes(rows: GroupRows) -> None:
    rows.limit("pids.max", 5)
    with rows.running(FORK):
        rows.row("limit of processes reached", "pids_limit")
    rows.limit("pids.max", "max")
    rows.row("limit removed")


def memory(rows: GroupRows) -> None:
    with rows.running(REREAD):
        rows.until_used(48 * MIB)  # it has read them once
        rows.limit("memory.max", 34 * MIB)
        rows.row("memory limit just above use", "memory_pressure")
    rows.limit("memory.max", "max")
    rows.row("limit removed")
    rows.limit("memory.max", 24 * MIB)
    with rows.running(ALLOCATE):
        rows.row("killed for lack of memory", "memory_pressure")
    rows.limit("memory.max", "max")
    rows.row("limit removed")


def disk(rows: GroupRows) -> None:
    device = Path("/sys/class/block", Path(DISK).name, "dev").read_text().strip()
    rows.limit("io.max", f"{device} rbps=262144 wbps=262144")
    with rows.running(*[WRITE] * 4):
        rows.row("slow disk", "io_pressure")
    rows.limit("io.max", f"{device} rbps=max wbps=max")
    rows.row("limit removed")


def others(rows: GroupRows) -> None:
    (rows.other / "cpu.weight").write_text("10000")
    with rows.running(*[BUSY] * 4), rows.running(*[BUSY] * 12, others=True):
        rows.row("other containers take the CPU", "cpu_starved")
    rows.row("they have ended")


def main() -> int:
    rows = GroupRows()
    with rows.running(IDLE):
        fact = rows.probe.container("ros_app")
        assert fact is not None
        stalls = fact.cpu is not None  # else the kernel was started with psi=0
        known = f"not seen: {', '.join(fact.not_seen) or 'nothing'}"
        print(f"Linux {platform.release()}, {fact.source}, {'with' if stalls else 'without'} PSI, {known}", flush=True)
        rows.row("idle")
        for part in (processor, processes, memory, *((disk, others) if stalls else ())):
            part(rows)
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
