"""PHM's own condition: for heartbeats, for `phm status`, and for the companion check."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

from phm.checking.pipeline import Pipeline
from phm.checking.scheduler import CheckScheduler
from phm.core.bus import Bus
from phm.core.clock import Clock
from phm.core.model import Stamp
from phm.core.process_priority import oom_score_adj
from phm.core.scheduling_delay import WINDOW_S
from phm.facts import SelfFact
from phm.recovery.safety.armed_state import ArmedMonitor
from phm.reporters.reporter_manager import ReporterManager
from phm.runtime.main_loop import MainLoop
from phm.runtime.probe_set import ProbeSet

STALLED_LOOP_S = 3.0
STALLED_CHECKS_S = 15.0
"""The companion check runs every second; if no check returns for this long, the scheduler has stalled."""


class DaemonHealth:
    """since: when PHM started. critical: keys of the flight-critical containers. problems: each gives a sentence or nothing."""

    def __init__(
        self,
        since: Stamp,
        clock: Clock,
        loop: MainLoop,
        scheduler: CheckScheduler,
        pipeline: Pipeline,
        bus: Bus,
        probes: ProbeSet,
        reporters: ReporterManager,
        armed: ArmedMonitor,
        critical: Sequence[str],
        problems: Sequence[Callable[[], str]],
    ) -> None:
        self.since, self._clock, self._loop = since, clock, loop
        self._scheduler, self._pipeline, self._bus, self._probes = scheduler, pipeline, bus, probes
        self._reporters, self._armed, self._critical, self._problems = reporters, armed, list(critical), problems
        self.crashed_before = False
        """Whether the last PHM since the machine's boot terminated unexpectedly."""

    def alive(self) -> bool:
        """Dead man's switch of heartbeats and of `phm status --healthy`: the main loop runs and checks return."""
        return self._quiet_s(self._loop.last_iteration, STALLED_LOOP_S) < STALLED_LOOP_S and (
            self._quiet_s(self._pipeline.last_result_at, STALLED_CHECKS_S) < STALLED_CHECKS_S
        )

    def _quiet_s(self, since: float, limit_s: float) -> float:
        """Seconds since then in which PHM could run: a starved PHM is late, not stalled."""
        age_s = self._clock.mono() - since
        return age_s if age_s < limit_s else age_s - self._clock.late_s(since, limit_s)

    def document(self) -> dict[str, Any]:
        """PHM's own condition for `phm status`, as JSON values."""
        fact, armed, ros = self._probes.world.daemon.snapshot(), self._armed.now(), self._probes.ros
        critical = {"containers": self._critical, "armed": armed.state.value, "why": armed.why}
        return {
            "started_utc": self.since.utc,
            "uptime_s": round(fact.uptime_s, 1),
            "overdue": list(fact.overdue),
            "dropped": dict(fact.dropped),
            "problems": list(fact.problems),
            "ros_restarts": fact.ros_restarts,
            "process": {"nice": os.getpriority(os.PRIO_PROCESS, 0), "oom_score_adj": oom_score_adj()},
            "late_percent": round(100 * self._clock.late_s(self._clock.mono() - WINDOW_S) / WINDOW_S, 1),
            **({"flight_critical": critical} if self._critical else {}),
            "ros_sandbox": ros.sandbox if ros is not None else None,
            "links": self._probes.link_reports(),
            "reporters": self._reporters.reports(),
        }

    def fact(self) -> SelfFact:
        """PHM's own condition for the check `companion`."""
        now, suspension = self._clock.mono(), self._loop.suspension
        problems = [*self._reporters.problems(), *(text for problem in self._problems if (text := problem()))]
        return SelfFact(
            now - self.since.mono,
            self._scheduler.overdue(),
            self._bus.dropped(),
            (*problems, *self._bus.problems()),
            ended_badly=self.crashed_before,
            suspended_s=suspension.duration_s if suspension else None,
            suspended_ago_s=now - suspension.at if suspension else None,
            was_stopped=suspension is not None and suspension.stopped,
        )
