"""Reads the companion computer: CPU, memory, disks, temperature, throttling, clock.

Docker does not namespace /proc and /sys, so PHM's container sees the host's figures; disks are those of its own mounts.
CPU, memory and disks can fail within a second and cost 0.05 ms, so each run reads them. Sensors are slow and expensive,
so they are read every few seconds. The throttling flags of a Raspberry Pi are not: the kernel keeps them for 2 s.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import re
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from phm.core.clock import Clock
from phm.core.settings import HostSettings
from phm.facts import CannotTell, DiskFact, HostFact
from phm.facts.disk_space import space
from phm.probes.blocking_call import BlockingCallWorker
from phm.probes.cpu_usage import CpuMonitor
from phm.probes.kernel_file import head

DISK_S = 1.0
"""Deadline of one look at one disk."""
SLOW_S = 2.0
"""How long a reading of the sensors is cached."""
MOST_FANS = 4

# Names by which drivers report the CPU sensor. Other sensors are not used: a Jetson's PMIC-Die always
# reports 100 degrees, and acpitz is the mainboard.
_PROCESSOR = re.compile(r"cpu|soc|x86_pkg|coretemp|k10temp|zenpower", re.IGNORECASE)

# Bits of a Raspberry Pi's get_throttled, from its documentation; from bit 16 on: the same, earlier. The driver raspberrypi-hwmon
# clears those each time it reads them, every 2 s; without it they are kept since boot.
_THROTTLED = (
    (0, "under-voltage"),
    (1, "frequency capped"),
    (2, "throttled"),
    (3, "soft temperature limit"),
)

_STA_UNSYNC = 0x40


class _Timex(ctypes.Structure):
    """The beginning of `struct timex` of <sys/timex.h>, with space for the rest."""

    _fields_ = [
        ("modes", ctypes.c_int),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    ]


def clock_synchronized() -> bool | None:
    """Whether the kernel's clock is synchronized; None if unknown.

    Docker's default seccomp profile refuses adjtimex without CAP_SYS_TIME, hence the second source.
    """
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        timex = _Timex()
        if libc.adjtimex(ctypes.byref(timex)) >= 0:
            return not timex.status & _STA_UNSYNC
    except (OSError, AttributeError):
        pass
    return True if os.path.exists("/run/systemd/timesync/synchronized") else None


@dataclass(frozen=True, slots=True)
class _Slow:
    """Values read every SLOW_S; fields as in `HostFact`."""

    at: float
    temperature_c: float | None
    temperature_of: str
    throttle_flags: tuple[Path, ...]
    """The files that have them; none on other machines than a Raspberry Pi."""
    clock_synchronized: bool | None
    fans_rpm: tuple[int, ...]


class Host:
    """A `phm.facts.HostProbe`. `sysfs` and `proc` are the paths of the kernel's /sys and /proc; tests use others."""

    def __init__(
        self, settings: HostSettings, clock: Clock, sysfs: Path = Path("/sys"), proc: Path = Path("/proc")
    ) -> None:
        self._settings = settings
        self._clock = clock
        self._sysfs = sysfs
        self._meminfo = str(proc / "meminfo")
        self._processor = CpuMonitor(clock, proc)
        self._slow: _Slow | None = None
        self._disks = {path: BlockingCallWorker(f"disk-{path}") for path in settings.disks}
        self._lock = threading.Lock()
        self._offset: float | None = None

    def read(self) -> HostFact:
        """All figures at this moment. Raises CannotTell if /proc cannot be read."""
        with self._lock:
            try:
                total, available = self._memory()
                use = self._processor.use()
                load = os.getloadavg()[0]
            except (OSError, ValueError, IndexError) as error:
                raise CannotTell(f"the kernel's figures cannot be read ({error}): is /proc mounted?") from error
            if abs(step := self._step()) > self._settings.clock_step:
                self._slow = None  # a clock that was set may be synchronized now
            slow = self._slowly()
            return HostFact(
                cpu_percent=use.busy_percent,
                waiting_percent=use.waiting_percent,
                memory_stalled_percent=use.memory_percent,
                io_stalled_percent=use.io_percent,
                memory_percent=100.0 * (total - available) / total,
                memory_available_bytes=available,
                disks=tuple(self._disk(path, worker) for path, worker in self._disks.items()),
                load_per_core=load / (os.cpu_count() or 1),
                temperature_c=slow.temperature_c,
                temperature_of=slow.temperature_of,
                throttled=_throttled(slow.throttle_flags),
                clock_synchronized=slow.clock_synchronized,
                clock_step_s=step,
                fans_rpm=slow.fans_rpm,
            )

    def close(self) -> None:
        """End the threads; later calls find no disk readable."""
        for worker in self._disks.values():
            worker.close()

    def _memory(self) -> tuple[int, int]:
        """Total bytes, and bytes available without swapping (MemAvailable)."""
        found = {}
        for line in head(self._meminfo).splitlines():
            name, _, rest = line.partition(":")
            if name in ("MemTotal", "MemAvailable") and rest.endswith("kB"):
                found[name] = int(rest.split()[0]) * 1024
        if len(found) == 2:
            return found["MemTotal"], found["MemAvailable"]
        # Kernels before 3.14 and some containers report no MemAvailable; psutil then estimates it.
        psutil = importlib.import_module("psutil")
        memory = psutil.virtual_memory()
        return int(memory.total), int(memory.available)

    def _slowly(self) -> _Slow:
        now = self._clock.mono()
        if self._slow is None or now - self._slow.at >= SLOW_S:
            temperature, sensor = self._temperature()
            synchronized, fans = clock_synchronized(), self._fans()
            flags = tuple(self._sysfs.glob("devices/platform/soc*/*firmware/get_throttled"))
            self._slow = _Slow(now, temperature, sensor, flags, synchronized, fans)
        return self._slow

    @staticmethod
    def _disk(path: str, worker: BlockingCallWorker) -> DiskFact:
        """One disk; if it cannot be read, `problem` says why."""
        try:
            return worker.call(lambda: space(path), DISK_S)
        except CannotTell as reason:
            return DiskFact(path, 0.0, 0, problem=f"{reason}: the mount may hang")
        except OSError as error:
            return DiskFact(path, 0.0, 0, problem=f"{error.strerror or error}: is it mounted into PHM?")

    def _temperature(self) -> tuple[float | None, str]:
        """The hottest CPU sensor in degrees Celsius, with its name."""
        hottest: float | None = None
        sensor = ""
        for name, value in self._sensors():
            if hottest is None or value > hottest:
                hottest, sensor = value, name
        return hottest, sensor

    def _sensors(self) -> Iterator[tuple[str, float]]:
        """Readings of the CPU sensors; both trees have thousandths of a degree."""
        for tree, name_file, pattern in (
            ("class/thermal", "type", "temp"),
            ("class/hwmon", "name", "temp*_input"),
        ):
            for folder in sorted((self._sysfs / tree).glob("*")):
                name = _line(folder / name_file)
                if name is None or not _PROCESSOR.search(name):
                    continue
                for file in folder.glob(pattern):
                    text = _line(file)
                    if text is not None and re.fullmatch(r"-?\d+", text):
                        yield name, int(text) / 1000

    def _fans(self) -> tuple[int, ...]:
        """Revolutions per minute of each fan whose driver reports it, at most MOST_FANS."""
        files = sorted((self._sysfs / "class/hwmon").glob("*/fan*_input"))[:MOST_FANS]
        texts = (_line(file) for file in files)
        return tuple(int(text) for text in texts if text is not None and re.fullmatch(r"\d{1,6}", text))

    def _step(self) -> float:
        """How far UTC moved against the monotonic clock since the last reading, in seconds."""
        stamp = self._clock.stamp()
        offset = stamp.utc - stamp.mono
        step = 0.0 if self._offset is None else offset - self._offset
        self._offset = offset
        return step


def _throttled(files: Iterable[Path]) -> tuple[str, ...] | None:
    """A Raspberry Pi's reasons for throttling; None on other machines."""
    for file in files:
        text = _line(file)
        if text is None or not re.fullmatch(r"(0x)?[0-9a-fA-F]+", text):
            continue
        bits = int(text, 16)
        now = [f"{word} now" for bit, word in _THROTTLED if bits >> bit & 1]
        earlier = [f"{word} earlier" for bit, word in _THROTTLED if bits >> (bit + 16) & 1 and not bits >> bit & 1]
        return (*now, *earlier)
    return None


def _line(file: Path) -> str | None:
    """The first line of a small file of /sys; None if it cannot be read (sleeping sensors return EAGAIN)."""
    try:
        with file.open(encoding="ascii", errors="replace") as stream:
            return stream.readline(200).strip()
    except OSError:
        return None
