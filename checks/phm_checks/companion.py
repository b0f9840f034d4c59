"""Slot 1: PHM itself is running and all its components work."""

from __future__ import annotations

from collections.abc import Iterable

from phm import api
from phm.api import Layer, Slot
from phm_checks._text import brief, clean, listed, merged, span

REPORT_S = 12.0
"""An interruption is over when it is detected. It is reported for so long that one refresh of the status, every 10 s,
contains it."""


class Companion(api.Check):
    """The companion computer: PHM's own components. The links have their own checks (`link`, `gcs`)."""

    name, slot, layer = "companion", Slot.COMPANION, Layer.COMPANION
    period_s = 1.0

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"link", "daemon"})

    def run(self, world: api.World) -> api.Result:
        """All problems in one summary."""
        facts = world.daemon.snapshot()
        bad = self._own(facts)
        values: dict[str, api.Value] = {"uptime_s": round(facts.uptime_s, 1), "ros_restarts": facts.ros_restarts}
        if not bad:
            return api.ok("Companion Computer is running aboard agent", values=values)
        return merged(bad, values)

    @staticmethod
    def _own(facts: api.SelfFact) -> list[api.Result]:
        found = list(Companion._interruptions(facts))
        if facts.overdue:
            found.append(
                api.warn(
                    f"PHM checks exceeded their deadline: {listed(facts.overdue)}; the state of what they monitor is unknown",
                    brief=brief(facts.overdue[0], "overdue"),
                    condition="check_overdue",
                )
            )
        lost = {name: count for name, count in facts.dropped.items() if count > 0}
        if lost:
            found.append(
                api.warn(
                    f"events were dropped because a reporter was too slow: "
                    f"{listed(f'{name} {count}' for name, count in lost.items())}",
                    brief=brief(next(iter(lost)), "events lost"),
                    condition="events_lost",
                )
            )
        found += [
            api.warn(f"PHM: {clean(problem)}", brief=brief("PHM", clean(problem, 34)), condition="phm_problem")
            for problem in facts.problems
        ]
        return found

    @staticmethod
    def _interruptions(facts: api.SelfFact) -> Iterable[api.Result]:
        if facts.ended_badly and facts.uptime_s < REPORT_S:
            yield api.warn(
                "PHM terminated unexpectedly and was restarted; this agent was not monitored meanwhile: see the "
                "end of its container's log, and whether its memory limit is too low",
                brief="PHM was restarted",
                condition="phm_restarted",
            )
        ago_s, lasted_s = facts.suspended_ago_s, facts.suspended_s
        if ago_s is not None and lasted_s is not None and ago_s < REPORT_S:
            why = (
                "a signal had stopped it (SIGSTOP) and its watchdog resumed it; set `PHM_WATCHDOG=off` if the stop was intended"
                if facts.was_stopped
                else "was it stopped or paused, or is the CPU overloaded?"
            )
            yield api.warn(
                f"PHM was suspended for {span(lasted_s)} and resumed; this agent was not monitored meanwhile: {why}",
                brief=brief("PHM", f"suspended {lasted_s:.{0 if lasted_s >= 1 else 1}f} s"),
                condition="phm_suspended",
            )
