"""Slot 9: CPU, memory, disk, temperature and clock of the companion computer are within their limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._cpu import Cpu
from phm_checks._host_pressure import HostPressure
from phm_checks._limit_forecast import LimitForecast
from phm_checks._recent_throttling import RecentThrottling
from phm_checks._text import StableNumber, brief, clean, joined, listed, merged, span
from phm_checks._threshold import Threshold

STEP_REPORT_S = 30.0
"""A clock jump shows in one reading; it is reported for this long so that operators see it."""
FIRST_SET_S = 300.0
"""A clock that is first set within this time since boot has waited for its time source, as on a computer without a battery for it."""
THROTTLE_REPORT_S = 30.0
"""The same for short throttling, e.g. by an under-voltage when motors start."""
SUSPECTS = ("memory", "disk")
"""A full disk or exhausted memory can be, but need not be, the cause of any other fault."""


class Host(api.Check):
    """The machine: units host/cpu, host/memory, host/io, host/disk, host/temperature and host/clock."""

    name, slot, layer = "host", Slot.HOST, Layer.COMPANION
    period_s = 1.0

    def __init__(self, settings: api.Settings) -> None:
        self._limits = limits = settings.host
        self._cpu = Cpu(settings)
        self._memory = Threshold(limits.memory.warn, limits.memory.error)
        self._disks: dict[str, Threshold] = {}
        self._trends = settings.trends
        self._filling: dict[str, LimitForecast] = {}
        self._growing = LimitForecast(self._trends.memory, self._trends.confidence)
        self._heat = Threshold(limits.temperature_warn, limits.temperature_error)
        self._throttling = RecentThrottling(THROTTLE_REPORT_S)
        self._step: tuple[float, float] | None = None
        self._first_set = False
        self._synchronized: bool | None = None
        self._was_synchronized = False
        """Whether it was in any reading."""
        self._window_s = settings.pressure.host_window
        self._memory_stalls = HostPressure(settings.pressure.host_memory, self._window_s)
        self._io_limit = settings.pressure.host_io
        self._io_stalls = HostPressure(self._io_limit, self._window_s)
        self._steady = StableNumber(share=0.05)

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)]

    @property
    def units(self) -> Sequence[api.Unit]:
        parts = ("cpu", "memory", "io", "disk", "temperature", "clock")
        return tuple(api.Unit(f"host/{part}", suspect=part in SUSPECTS) for part in parts)

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        fact = world.host.read()
        now = world.clock.mono()
        disks = tuple(
            (disk.total_bytes, disk.free_bytes) for disk in fact.disks if disk.total_bytes and not disk.problem
        )
        return {
            "host/cpu": self._cpu.judge(fact, now, world),
            "host/memory": _with(self._judge_memory(fact, now), api.HostReadings(memory_percent=fact.memory_percent)),
            "host/io": self._judge_io(fact, now),
            "host/disk": _with(self._judge_disks(fact, now), api.HostReadings(disks=disks)),
            "host/temperature": _with(
                self._judge_temperature(fact, now),
                api.HostReadings(temperature_c=fact.temperature_c, fans_rpm=tuple(fact.fans_rpm)),
            ),
            "host/clock": self._judge_clock(fact, now),
        }

    def _judge_memory(self, fact: api.HostFact, now: float) -> api.Result:
        """Memory usage, and the time that tasks wait for memory."""
        used, stalled = fact.memory_percent, self._judge_memory_stalls(fact, now)
        values: dict[str, api.Value] = {
            "memory_percent": round(used, 1),
            "memory_available_bytes": fact.memory_available_bytes,
            "memory_stalled_percent": _rounded(fact.memory_stalled_percent),
        }
        level = self._memory.level(used)
        findings = [stalled] if stalled is not None else []
        soon = self._growing.soon(now, used, self._limits.memory.error)
        if level is Level.OK:
            self._steady.forget("memory")
            if soon is not None and stalled is None:
                words = (
                    f"memory at {used:.0f} % reaches {self._limits.memory.error:g} % {self._growing.words(soon)}: find the "
                    "leak (`docker stats`), or give its container a memory limit"
                )
                findings.append(
                    self._bad(Level.WARN, words, f"memory full {self._growing.short(soon)}", "memory_filling", values)
                )
        else:
            words = (
                f"memory at {used:.0f} %, {fact.memory_available_bytes / 1e6:.0f} MB available, expected below "
                f"{self._limits.memory.warn:g} %: find the leak, or give its container a memory limit"
            )
            shown = f"memory {self._steady.show('memory', used):.0f} %"
            findings.append(self._bad(level, words, shown, "memory_high", values))
        rising = api.Evidence(rising=self._memory_stalls.rising and stalled is None)
        if not findings:
            return api.ok(f"Memory at {used:.0f} %", values=values).with_evidence(rising)
        return merged(findings, values).with_evidence(rising)

    def _judge_memory_stalls(self, fact: api.HostFact, now: float) -> api.Result | None:
        level, mean = self._memory_stalls.judge(fact.memory_stalled_percent, now)
        if level is Level.OK:
            self._steady.forget("memory stalls")
            return None
        words = (
            f"all tasks waited for memory during {mean:.0f} % of the last {span(self._window_s)} (/proc/pressure/memory), with "
            f"{fact.memory_available_bytes / 1e6:.0f} MB available: find the leak, or give its container a memory limit"
        )
        shown = f"host waits for memory {self._steady.show('memory stalls', mean):.0f} %"
        return self._bad(level, words, shown, "memory_pressure", {})

    def _judge_io(self, fact: api.HostFact, now: float) -> api.Result:
        level, mean = self._io_stalls.judge(fact.io_stalled_percent, now)
        if fact.cpu_percent is None:
            return api.stale("How long tasks wait for disks is not measured yet: shares need two readings.")
        if fact.io_stalled_percent is None:
            return api.bypass(
                "This kernel does not count how long tasks wait for its disks (psi=1 on its command line)."
            )
        values: dict[str, api.Value] = {"io_stalled_percent": _rounded(fact.io_stalled_percent)}
        if level is Level.OK:
            self._steady.forget("io")
            words = f"Tasks wait for disks {fact.io_stalled_percent:.0f} % of the time"
            return api.ok(words, values=values).with_evidence(api.Evidence(rising=self._io_stalls.rising))
        words = (
            f"all tasks waited for disks during {mean:.0f} % of the last {span(self._window_s)} (/proc/pressure/io), expected below "
            f"{self._io_limit.warn:g} %: a slow or worn SD card, or a program that writes more than it can handle; write less, or to "
            "another disk"
        )
        return self._bad(
            level, words, f"host waits for disk {self._steady.show('io', mean):.0f} %", "io_pressure", values
        )

    def _judge_disks(self, fact: api.HostFact, now: float) -> api.Result:
        if not fact.disks:
            return api.bypass("No disk is monitored.")
        findings = [self._judge_disk(disk, now) for disk in fact.disks]
        first = api.worst(findings)
        values: dict[str, api.Value] = {}
        for finding in findings:
            values.update(finding.values)
        if first.level is Level.OK:
            return api.ok(joined([finding.summary for finding in findings]), values=values)
        return merged(findings, values)

    def _judge_disk(self, disk: api.DiskFact, now: float) -> api.Result:
        path = clean(disk.path, 80)
        if disk.problem:
            return api.stale(f"disk {path} cannot be read: {clean(disk.problem)}")
        most = max(disk.used_percent, disk.inodes_used_percent)
        what = "full" if disk.used_percent >= disk.inodes_used_percent else "of inodes used"
        graded = self._disks.setdefault(disk.path, Threshold(self._limits.disk.warn, self._limits.disk.error))
        values: dict[str, api.Value] = {
            f"disk_percent {path}": round(disk.used_percent, 1),
            f"inodes_percent {path}": round(disk.inodes_used_percent, 1),
            f"disk_free_bytes {path}": disk.free_bytes,
            f"disk_total_bytes {path}": disk.total_bytes,
        }
        level = graded.level(most)
        forecast = self._filling.setdefault(disk.path, LimitForecast(self._trends.disk, self._trends.confidence))
        soon = forecast.soon(now, most, self._limits.disk.error)
        if level is Level.OK:
            self._steady.forget(disk.path)
            if soon is not None:
                words = (
                    f"disk {path} at {most:.0f} % {what} reaches {self._limits.disk.error:g} % {forecast.words(soon)}: find what "
                    f"writes to it, {disk.free_bytes / 1e6:.0f} MB are free"
                )
                return self._bad(Level.WARN, words, f"disk {path} full {forecast.short(soon)}", "disk_filling", values)
            return api.ok(f"Disk {path} is {disk.used_percent:.0f} % full", values=values)
        words = (
            f"disk {path} at {most:.0f} % {what}, {disk.free_bytes / 1e6:.0f} MB free, expected below "
            f"{self._limits.disk.warn:g} %: remove old logs, bags and images (`docker system df`)"
        )
        short = brief(f"disk {path}", f"{self._steady.show(disk.path, most):.0f} %")
        # Recovery can free space only if the configuration lists what it may delete.
        target = f"disk:{disk.path}" if self._limits.free_disk else ""
        return api.Result(level, words, short, "disk_full", target, values)

    def _judge_temperature(self, fact: api.HostFact, at: float) -> api.Result:
        """Temperature and throttling: both slow the CPU down."""
        recent = self._throttling.observe(fact.throttled, at)
        fans: dict[str, api.Value] = {f"fan_rpm {number}": rpm for number, rpm in enumerate(fact.fans_rpm)}
        if fact.temperature_c is None and fact.throttled is None:
            return api.bypass("This machine does not report its temperature.", values=fans)
        values: dict[str, api.Value] = {"temperature_c": fact.temperature_c, **fans}
        findings = []
        if fact.temperature_c is not None:
            level = self._heat.level(fact.temperature_c)
            if level is Level.OK:
                self._steady.forget("heat")
            else:
                words = (
                    f"{clean(fact.temperature_of, 40) or 'processor'} at {fact.temperature_c:.0f} C, expected below "
                    f"{self._limits.temperature_warn:g} C: check fan, air flow and load"
                )
                short = f"CPU {self._steady.show('heat', fact.temperature_c):.0f} C"
                findings.append(self._bad(level, words, short, "temperature_high", values))
        if recent:
            findings.append(self._bad(Level.WARN, _throttled(fact, recent), recent[0], "throttled", values))
        if findings:
            return merged(findings, values)
        heat = "Temperature not reported" if fact.temperature_c is None else f"Temperature {fact.temperature_c:.0f} C"
        earlier = f", {listed(fact.throttled)}" if fact.throttled else ""
        return api.ok(f"{heat}{earlier}", values=values)

    def _judge_clock(self, fact: api.HostFact, now: float) -> api.Result:
        """WARN after a jump, unless a time source was found for the first time since boot. An unsynchronised clock is only
        mentioned: in the field there is often none."""
        if abs(fact.clock_step_s) > self._limits.clock_step:
            # Monotonic time begins at boot.
            found = self._synchronized is False and fact.clock_synchronized is True
            first = self._step is None and not self._was_synchronized
            self._first_set = first and fact.clock_step_s > 0 and (now < FIRST_SET_S or found)
            self._step = (now, fact.clock_step_s)
        self._synchronized = fact.clock_synchronized
        self._was_synchronized |= fact.clock_synchronized is True
        values: dict[str, api.Value] = {
            "clock_synchronized": fact.clock_synchronized,
            "clock_step_s": round(fact.clock_step_s, 3),
        }
        if self._step is not None and now - self._step[0] < STEP_REPORT_S:
            step = self._step[1]
            if self._first_set:
                return api.ok(
                    f"The UTC clock was set for the first time, by {step:+.1f} s: timestamps before that are too early",
                    values=values,
                )
            words = (
                f"the UTC clock jumped by {step:+.1f} s, expected at most {self._limits.clock_step:g} s: timestamps before and "
                "after it are inconsistent; check chrony, NTP or the GPS time source"
            )
            return self._bad(Level.WARN, words, f"clock jumped {step:+.0f} s", "clock_step", values)
        said = {
            True: "Clock is synchronised",
            False: "Clock is steady but not synchronised: logs of different agents may not line up",
            None: "Clock is steady; this machine does not report whether it is synchronised",
        }
        return api.ok(said[fact.clock_synchronized], values=values)

    @staticmethod
    def _bad(level: Level, words: str, short: str, condition: str, values: Mapping[str, api.Value]) -> api.Result:
        return api.Result(level, words, brief(short), condition, values=values)


def _throttled(fact: api.HostFact, recent: Sequence[str]) -> str:
    live = [reason for reason in recent if f"{reason} now" in (fact.throttled or ())]
    when = [
        f"{reason} now" if reason in live else f"{reason} in the last {span(THROTTLE_REPORT_S)}" for reason in recent
    ]
    return (
        f"the CPU {'is' if live else 'was'} throttled: {listed(when)}: check the power supply, its cable, and cooling"
    )


def _with(result: api.Result, readings: api.HostReadings) -> api.Result:
    return replace(result, readings=readings)


def _rounded(percent: float | None) -> float | None:
    return None if percent is None else round(percent, 1)
