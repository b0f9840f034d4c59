"""Waiting for a stack's PHM to report."""

from __future__ import annotations

from sitl.harness.compose_stack import Stack
from sitl.harness.log_follower import Event, Record

OK_LIMIT_S = 90.0
STEADY_S = 5.0


class StackMonitor:
    """Follows PHM's JSON log of a stack that is up."""

    def __init__(self, stack: Stack) -> None:
        self._stack = stack
        self.record = Record(stack.record)

    def mark(self) -> int:
        """The number of events so far, for `Record.wait(since=...)`."""
        self.record.update()
        return len(self.record.events)

    def wait_ok(self) -> None:
        """Wait until every report of STEADY_S seconds has all units OK. RuntimeError after OK_LIMIT_S."""
        ok_from: list[float] = []

        def steady(event: Event) -> bool:
            if event["event"] == "report":
                if any(digit != 1 for digit in event["status_array"]):
                    ok_from.clear()
                else:
                    ok_from.append(event["mono"])
            return bool(ok_from) and event["mono"] - ok_from[0] >= STEADY_S

        if self.record.wait(steady, OK_LIMIT_S, since=self.mark()) is None:
            raise RuntimeError(f"the agent was not OK within {OK_LIMIT_S:g} s; see {self._stack.logs}")
