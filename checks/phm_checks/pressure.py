"""Slot 9: each configured container gets the CPU, memory, disk and processes that it needs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm import api
from phm.api import Level, Slot
from phm_checks._cpu_consumers import OUTSIDE, top_consumer
from phm_checks._growing_process import GrowingProcess
from phm_checks._limit_forecast import LimitForecast
from phm_checks._per_container import PerContainer
from phm_checks._pressure_window import PressureDelta, PressureWindow
from phm_checks._text import StableNumber, brief, merged
from phm_checks._window_threshold import WindowThreshold

NEWEST_S = 0.9
"""Length of the newest part of the window, slightly less than the period."""
IO_S = 5.0
"""Window for disk waits: a short write to a slow card is not a fault."""
KILL_REPORT_S = 10.0
"""A process killed for lack of memory shows in one reading; it is reported for this long so that operators see it."""
KILL_SETTLE_S = 1.0
"""A node that was killed for lack of memory is reported by its own check within this time, and the recovery that follows includes this
unit: one fault, one alarm."""
NEAR_LIMIT = 0.9
"""A container that uses less than this share of its memory limit waits for another reason."""
SEARCH_FROM = 0.5
"""From this share of the waiting limit on, the top CPU consumer is determined: that takes two readings."""


class Pressure(PerContainer):
    """The container's limits, and the resources that other programs leave, are sufficient."""

    name, slot = "pressure", Slot.HOST
    period_s = 1.0

    def __init__(self, entry: api.ContainerSettings, settings: api.Settings) -> None:
        super().__init__(entry)
        limits, trends = settings.pressure, settings.trends
        self._growing = LimitForecast(trends.memory, trends.confidence)
        self._grower = GrowingProcess(entry.key, settings)
        self._generation = ""
        self._limits, self._grace_s = limits, settings.ros.grace
        self._window = PressureWindow(max(limits.window, IO_S))
        self._throttled = WindowThreshold(limits.throttled.warn, limits.throttled.error)
        self._waiting = WindowThreshold(limits.waiting.warn, limits.waiting.error)
        self._memory = WindowThreshold(limits.memory.warn, limits.memory.error)
        self._faults = WindowThreshold(limits.memory_faults.warn, limits.memory_faults.error)
        self._io = WindowThreshold(limits.io.warn, limits.io.error)
        self._killed: tuple[float, int, bool] | None = None
        self._steady = StableNumber(share=0.1)

    @classmethod
    def wanted(cls, entry: api.ContainerSettings) -> bool:
        return entry.pressure != "ignore"

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(entry, settings) for entry in settings.containers if cls.wanted(entry)]

    @property
    def units(self) -> Sequence[api.Unit]:
        """The unit has the grace period of the nodes: a start needs more resources than normal operation."""
        needs = (f"container/{self.key}",)
        return (api.Unit(self.unit_id, needs=needs, target=self.key, grace_s=self._grace_s),)

    def run(self, world: api.World) -> api.Result:
        try:
            fact = world.pressure.container(self.key)
        except api.NotPermitted as reason:
            self._window.forget()
            return api.bypass(f"Resource pressure of {self.key} cannot be read: {reason}")
        if fact is None:
            self._window.forget()
            return api.bypass(f"{self.key} is not running, so there is no resource pressure")
        self._window.add(fact)
        over = self._window.over(self._limits.window)
        newest = self._window.over(NEWEST_S)
        if over is None or newest is None:
            return api.stale(f"resource pressure of {self.key} needs a second reading")
        return self._judge(world, fact, over, newest)

    def _judge(
        self, world: api.World, fact: api.PressureFact, over: PressureDelta, newest: PressureDelta
    ) -> api.Result:
        memory = self._judge_memory(fact, over, newest, world.clock.mono())
        findings = [
            finding
            for finding in (
                self._judge_limit(fact, over, newest),
                memory,
                self._judge_io(newest),
                self._judge_pids(fact, over),
                self._judge_waiting(world, over, newest),
                # Last: a forecast explains no symptom, and must not take the place of what does.
                self._judge_growth(world, fact) if memory is None else None,
            )
            if finding is not None
        ]
        values = _values(fact, over)
        if not findings:
            result = api.ok(
                f"{self.key} has enough CPU, memory and I/O ({fact.source}{_not_seen(fact)})", values=values
            )
            return result.with_evidence(api.Evidence(rising=self._above(newest)))
        return merged(findings, values)

    def _above(self, newest: PressureDelta) -> bool:
        """Whether the newest second alone is above a limit."""
        limits = self._limits
        shares = (
            (newest.throttled, limits.throttled),
            (newest.waiting, limits.waiting),
            (newest.shortage, limits.memory),
        )
        return any(share is not None and share >= limit.warn for share, limit in shares)

    def _judge_limit(self, fact: api.PressureFact, over: PressureDelta, newest: PressureDelta) -> api.Result | None:
        level = self._throttled.level(over.throttled, newest.throttled)
        if level is Level.OK or over.throttled is None:
            self._steady.forget("throttled")
            return None
        limit = "" if fact.cpu_limit is None else f" of {fact.cpu_limit:.2g} CPUs"
        words = (
            f"{self.key} throttled {over.throttled:.0f} % of the time by its limit{limit}: raise it, e.g. with `cpus:` in "
            "Compose or `docker update --cpus`"
        )
        shown = self._steady.show("throttled", over.throttled)
        by = "" if fact.cpu_limit is None else f", limit {fact.cpu_limit:.2g} CPU"
        return self._bad(level, words, f"throttled {shown:.0f}%{by}", "cpu_throttled")

    def _judge_memory(
        self, fact: api.PressureFact, over: PressureDelta, newest: PressureDelta, now: float
    ) -> api.Result | None:
        if newest.oom_kills:
            # Over the whole window: a hit may be counted just before a reading, and its kill just after. None: not counted.
            self._killed = now, newest.oom_kills, over.memory_limit_hits != 0
        levels = (
            self._memory.level(over.shortage, newest.shortage),
            self._faults.level(over.faults_hz, newest.faults_hz),
        )
        if self._killed is not None and now - self._killed[0] < KILL_REPORT_S:
            return replace(self._killed_for_memory(fact, *self._killed[1:]), settle_s=KILL_SETTLE_S)
        level = max(levels)
        if level is Level.OK:
            return None
        reads = f" and reads back {over.faults_hz:.0f} pages a second" if levels[1] is not Level.OK else ""
        waits = (
            f"waits for memory {over.shortage:.0f} % of the time" if over.shortage is not None else "waits for memory"
        )
        limit = _reached_limit(fact)
        if limit is None:
            words = (
                f"{self.key} {waits}{reads}, not because of its own limit: the computer has too little memory, see "
                "`docker stats`, and stop or limit what uses most"
            )
            return self._bad(level, words, "waits for memory", "memory_pressure")
        words = (
            f"{self.key} {waits}{reads}, because its memory limit of {_size(limit)} is used up: raise it (`mem_limit:`, "
            "`docker update --memory`), or find the leak"
        )
        return self._bad(level, words, f"memory limit {_size(limit)} too small", "memory_pressure")

    def _killed_for_memory(self, fact: api.PressureFact, count: int, at_limit: bool) -> api.Result:
        """The kernel counts kills at the container's own limit and for lack of memory in the computer together.

        at_limit: whether the container reached its own limit, if it has one.
        """
        limit = fact.memory_limit
        if limit is None or not at_limit:
            words = (
                f"the computer ran out of memory, and the kernel killed {count} of the processes of {self.key}: find what uses "
                "most with `docker stats`, and give it a limit (`mem_limit:`); a memory limit of its `cgroup_parent` has the "
                "same effect"
            )
            return self._bad(Level.ERROR, words, "killed, no memory left", "memory_pressure")
        words = (
            f"{self.key} reached its memory limit of {_size(limit)}, and the kernel killed {count} of its processes: raise the "
            "limit (`mem_limit:`, `docker update --memory`), or find the leak"
        )
        return self._bad(Level.ERROR, words, f"memory limit {_size(limit)}: killed", "memory_pressure")

    def _judge_growth(self, world: api.World, fact: api.PressureFact) -> api.Result | None:
        """Memory without the page cache, which the kernel can evict. A container without a limit is judged with the host."""
        if fact.generation != self._generation:
            self._generation = fact.generation
            self._growing.forget()
            self._grower.forget()
        used, limit = fact.without_cache_bytes, fact.memory_limit
        soon = None if limit is None else self._growing.soon(fact.at, used, limit)
        if soon is None or used is None or limit is None:
            self._grower.forget()
            return None
        by = self._grower.observe(world, used, soon.slope)
        words = (
            f"{self.key} uses {_size(used)} and reaches its memory limit of {_size(limit)} {self._growing.words(soon)}, growing "
            f"by {_size(round(soon.slope * 60))} a minute{f', most of it {by.words}' if by else ''}: find the leak, or raise the "
            "limit (`mem_limit:`)"
        )
        short = f"memory full {self._growing.short(soon)}"
        found = self._bad(Level.WARN, words, short, "memory_filling").with_evidence(api.Evidence(forecast=True))
        return self._naming(found, short, by.short if by else "")

    def _judge_io(self, newest: PressureDelta) -> api.Result | None:
        over = self._window.over(IO_S, full=True)
        level = self._io.level(None if over is None else over.io, newest.io)
        if level is Level.OK or over is None or over.io is None:
            self._steady.forget("io")
            return None
        words = (
            f"{self.key} waits for the disk {over.io:.0f} % of the time, expected below {self._limits.io.warn:g} %: a slow or worn "
            "SD card, an I/O limit, or another program that writes much; write less, or to another disk"
        )
        return self._bad(level, words, f"waits {self._steady.show('io', over.io):.0f}% for disk", "io_pressure")

    def _judge_pids(self, fact: api.PressureFact, over: PressureDelta) -> api.Result | None:
        if fact.pids is None or not fact.pids_limit:
            return None
        share, limits = 100.0 * fact.pids / fact.pids_limit, self._limits.pids
        if share < limits.warn and not over.refused:
            return None
        level = Level.ERROR if over.refused or share >= limits.error else Level.WARN
        refused = f", and {over.refused} more were refused" if over.refused else ""
        words = (
            f"{self.key} has {fact.pids} processes and threads at its limit of {fact.pids_limit}{refused}: raise it (`pids_limit:`, "
            "`docker update --pids-limit`), or find what starts so many"
        )
        shown = (
            f"process limit {fact.pids_limit} reached"
            if level is Level.ERROR
            else f"near process limit {fact.pids_limit}"
        )
        return self._bad(level, words, shown, "pids_limit")

    def _judge_waiting(self, world: api.World, over: PressureDelta, newest: PressureDelta) -> api.Result | None:
        level = self._waiting.level(over.waiting, newest.waiting)
        by = None
        if newest.waiting is not None and newest.waiting >= SEARCH_FROM * self._limits.waiting.warn:
            by = top_consumer(world, self.key)
        if level is Level.OK or over.waiting is None:
            self._steady.forget("waiting")
            return None
        takes = f"{by[0]} uses {by[1]:.1f} CPUs: stop it, or give it a CPU limit" if by else "see `docker stats`"
        words = f"{self.key} waits {over.waiting:.0f} % of the time for a CPU that others use; {takes}"
        short = f"waits {self._steady.show('waiting', over.waiting):.0f}% for CPU"
        result = self._bad(level, words, short, "cpu_starved")
        return self._naming(result, short, by[0] if by and by[0] != OUTSIDE else "")

    def _naming(self, result: api.Result, short: str, culprit: str) -> api.Result:
        """The result with the culprit in its brief, if there is one and both fit."""
        named = brief(f"{self.key} {short}", f"({culprit})") if culprit else ""
        return replace(result, brief=named) if named.startswith(self.key) else result

    def _bad(self, level: Level, words: str, short: str, condition: str) -> api.Result:
        return api.Result(level, words, brief(self.key, short), condition, self.key)


def _values(fact: api.PressureFact, over: PressureDelta) -> dict[str, api.Value]:
    shares = {
        "throttled_percent": over.throttled,
        "cpu_waiting_percent": over.waiting,
        "memory_waiting_percent": over.memory,
        "io_waiting_percent": over.io,
        "reread_pages_hz": over.faults_hz,
    }
    values: dict[str, api.Value] = {
        "source": fact.source,
        "cpus_used": None if over.cpus is None else round(over.cpus, 3),
        "cpu_limit": fact.cpu_limit,
        "memory_bytes": fact.memory_bytes,
        "memory_limit_bytes": fact.memory_limit,
        "pids": fact.pids,
        "pids_limit": fact.pids_limit,
    }
    values.update({name: round(share, 1) for name, share in shares.items() if share is not None})
    return values


def _not_seen(fact: api.PressureFact) -> str:
    return f"; not available: {', '.join(fact.not_seen)}" if fact.not_seen else ""


def _reached_limit(fact: api.PressureFact) -> int | None:
    """The memory limit in bytes if the container has reached it; None: it has not, or has none."""
    limit, used = fact.memory_limit, fact.memory_bytes
    return None if limit is None or (used is not None and used < NEAR_LIMIT * limit) else limit


def _size(count: int) -> str:
    """Bytes as Docker writes limits: `64 MB` is 64 MiB there."""
    return f"{count / 2**30:.3g} GB" if count >= 2**30 else f"{count / 2**20:.3g} MB"
