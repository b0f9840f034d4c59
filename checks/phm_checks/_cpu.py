"""Detects an overloaded CPU: from its mean use over a window, or sooner if the kernel reports that tasks wait for a CPU.

Not a check: files in this folder whose names start with an underscore are parts of checks.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from datetime import datetime

from phm import api
from phm.api import Level
from phm_checks._cpu_consumers import top_consumer
from phm_checks._text import StableNumber, span
from phm_checks._threshold import Threshold

WAITING_PERCENT = 40.0
"""Tasks must have waited for a core during this share of the quick window: cores that are all busy while no task waits are just
well used."""
STAYS_S = 5.0
"""A fault from the quick detection persists until its condition has been absent for this long: bursts with short pauses are one
fault."""
FEWEST = 2
"""Minimum number of readings in the quick window. The kernel counts continuously, so a few are enough."""
KNOWN_S = 10.0
"""An answer of the engine about a container may be this old: the engine reports a start, and is slow on a machine without idle CPU."""
ASK_AGAIN_S = 10.0
"""After the engine failed to answer whether a container is starting, PHM waits this long before it asks again."""
_MOST_READINGS = 2000


class Cpu:
    """Evaluates the readings of one machine. Units: shares in percent, times in seconds."""

    def __init__(self, settings: api.Settings) -> None:
        limits = self._limits = settings.host
        self._mean = Threshold(limits.cpu.warn, limits.cpu.error)
        self._readings: deque[tuple[float, float]] = deque(maxlen=_MOST_READINGS)
        self._quick: deque[tuple[float, float, float]] = deque(maxlen=_MOST_READINGS)
        self._quick_fault: tuple[float, Level, str] | None = None
        self._steady = StableNumber(share=0.05)
        self._containers = [entry.key for entry in settings.containers]
        self._start_s = settings.ros.grace
        self._first: float | None = None
        self._ask_from = float("-inf")
        self._taken: tuple[str, float] | None = None

    def judge(self, fact: api.HostFact, now: float, world: api.World) -> api.Result:
        """Evaluate one reading, see `_judge`; the result's readings also contain the mean."""
        use = fact.cpu_percent
        if use is None:
            return api.stale("CPU usage is not measured yet: it needs two readings.")
        mean = self._mean_of(use, now)
        high = use >= self._limits.cpu.warn
        result = self._judge(fact, use, mean, now, world)
        if not result.level.bad:
            # Whether this reading alone would be a fault of the quick detection.
            waits = fact.waiting_percent is not None and fact.waiting_percent >= WAITING_PERCENT
            result = result.with_evidence(api.Evidence(rising=waits and high))
        elif not high:
            result = result.with_evidence(api.Evidence(falling=True))
        return replace(result, readings=api.HostReadings(cpu_percent=mean))

    def _judge(self, fact: api.HostFact, use: float, mean: float, now: float, world: api.World) -> api.Result:
        """Evaluate the mean of the readings in the window; report high use once the window is full, or by the quick detection."""
        window_s = self._limits.cpu_window
        values: dict[str, api.Value] = {
            "cpu_percent": round(mean, 1),
            "load_per_core": round(fact.load_per_core, 2),
        }
        if fact.waiting_percent is not None:
            values["cpu_waiting_percent"] = round(fact.waiting_percent, 1)
        # Finding the top CPU consumer takes two queries, so the first is made before there is something to report.
        self._taken = top_consumer(world) if use >= self._limits.cpu.warn else None
        full = now - self._readings[0][0] >= window_s
        # Before that the state must not change: a busy start would lower the limits of the mean.
        level = (self._mean if full else Threshold(self._limits.cpu.warn, self._limits.cpu.error)).level(mean)
        quick = self._quick_level(use, fact.waiting_percent, now, world)
        if quick is not None and (not full or quick[0] is Level.ERROR or level is Level.OK):
            return self._bad(quick[0], quick[1], 100.0, values)
        if level is Level.OK:
            self._steady.forget("cpu")
            return api.ok(f"CPU at {mean:.0f} %", values=values)
        if not full:
            return api.stale(f"CPU at {mean:.0f} %, averaging over {span(window_s)} before judging", values=values)
        words = f"CPU at {mean:.0f} % over {span(window_s)}, expected below {self._limits.cpu.warn:g} %"
        return self._bad(level, words, mean, values)

    def _mean_of(self, use: float, now: float) -> float:
        """The mean CPU use in percent over the window, including this reading."""
        window_s = self._limits.cpu_window
        self._readings.append((now, use))
        # Keep one reading from before the window: it shows that the window is full.
        while len(self._readings) > 1 and self._readings[1][0] <= now - window_s:
            self._readings.popleft()
        inside = [share for at, share in self._readings if at > now - window_s]
        return sum(inside) / len(inside)

    def _bad(self, level: Level, words: str, share: float, values: dict[str, api.Value]) -> api.Result:
        most = f"; {self._taken[0]} uses {self._taken[1]:.1f} CPUs" if self._taken else ""
        summary = f"{words}{most}: find the process with `top`, or give its container a CPU limit"
        return api.Result(level, summary, f"CPU {self._steady.show('cpu', share):.0f} %", "cpu_high", values=values)

    # ------------------------------------------------------------ quick detection

    def _quick_level(self, use: float, waiting: float | None, now: float, world: api.World) -> tuple[Level, str] | None:
        """Level and text of a fault; None if the quick detection has nothing to report."""
        self._first = now if self._first is None else self._first
        seen = self._pressed(use, waiting, now)
        if seen is not None and (self._quick_fault is not None or not self._starting(now, world)):
            level = seen[0]
            if self._quick_fault is not None:
                level = max(level, self._quick_fault[1], key=lambda one: one.severity)
            # Not `now`: on a busy machine the engine may have taken seconds to answer whether a container is starting.
            self._quick_fault = world.clock.mono(), level, seen[1]
        if self._quick_fault is not None and now - self._quick_fault[0] > STAYS_S:
            self._quick_fault = None
        return self._quick_fault[1:] if self._quick_fault is not None else None

    def _pressed(self, use: float, waits: float | None, now: float) -> tuple[Level, str] | None:
        """Evaluate the quick window: a fault if CPU use was never below the limit and tasks waited for a core."""
        window_s = self._limits.cpu_quick
        if waits is None or window_s == 0:
            return None
        self._quick.append((now, use, waits))
        while len(self._quick) > 1 and self._quick[1][0] <= now - window_s:
            self._quick.popleft()
        inside = [reading for reading in self._quick if reading[0] > now - window_s]
        if now - self._quick[0][0] < window_s or len(inside) < FEWEST:
            return None
        least = min(share for _, share, _ in inside)
        waiting = sum(share for _, _, share in inside) / len(inside)
        limits = self._limits.cpu
        if least < limits.warn or waiting < WAITING_PERCENT:
            return None
        words = (
            f"CPU at {least:.0f} % or more for {span(window_s)}, expected below {limits.warn:g} %, and tasks waited for a core "
            f"in {waiting:.0f} % of that time"
        )
        return (Level.ERROR if least >= limits.error else Level.WARN), words

    def _starting(self, now: float, world: api.World) -> bool:
        """Whether PHM or a container has just started: a start uses a small machine's entire CPU for a while and then ends by itself.

        Also true if the engine does not answer: then the mean decides.
        """
        if self._first is None or now - self._first < self._start_s or now < self._ask_from:
            return True
        try:
            facts = [world.docker.container(name, KNOWN_S) for name in self._containers]
        except api.CannotTell:
            self._ask_from = now + ASK_AGAIN_S
            return True
        return any(fact is not None and fact.running and _age_s(fact, world) < self._start_s for fact in facts)


def _age_s(fact: api.ContainerFact, world: api.World) -> float:
    """Seconds since the container was started; infinite if the engine's timestamp cannot be parsed."""
    try:
        started = datetime.fromisoformat(fact.started_at[:19] + "+00:00").timestamp()
    except ValueError:
        return float("inf")
    return world.clock.mono() - world.clock.latest(started)
