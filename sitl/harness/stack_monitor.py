"""Waiting for a stack's PHM to report."""

from __future__ import annotations

from collections.abc import Callable

from phm.core.model import Level
from phm.wire.report import OK_LEVELS
from sitl.harness.compose_stack import Stack
from sitl.harness.log_follower import Event, Record

OK_LIMIT_S = 90.0
STEADY_S = 5.0


def every_slot_ok(report: Event) -> bool:
    """Slots 1 to 8 are monitored and OK."""
    return all(digit == 1 for digit in report["status_array"])


def no_slot_failed(report: Event) -> bool:
    """What is monitored is OK or WARN; slots may be unused."""
    return all(level in (*OK_LEVELS, Level.WARN.name) for level in report["slots"].values())


class StackMonitor:
    """Follows PHM's JSON log of a stack that is up. `ok`: whether a report says that the agent is."""

    def __init__(self, stack: Stack, ok: Callable[[Event], bool] = every_slot_ok) -> None:
        self._stack, self._ok = stack, ok
        self.record = Record(stack.record)

    def mark(self) -> int:
        """The number of events so far, for `Record.wait(since=...)`."""
        self.record.update()
        return len(self.record.events)

    def wait_ok(self) -> None:
        """Wait until every report of STEADY_S seconds is OK. RuntimeError after OK_LIMIT_S."""
        ok_from: list[float] = []

        def steady(event: Event) -> bool:
            if event["event"] == "report":
                if self._ok(event):
                    ok_from.append(event["mono"])
                else:
                    ok_from.clear()
            return bool(ok_from) and event["mono"] - ok_from[0] >= STEADY_S

        if self.record.wait(steady, OK_LIMIT_S, since=self.mark()) is None:
            raise RuntimeError(f"the agent was not OK within {OK_LIMIT_S:g} s; see {self._stack.logs}")
