"""Connect check scheduler, tracker and event bus: results in, events out, reruns back. Also runs the report passes.

One lock protects the tracker. Only computation and queueing happen under it, so a check's thread that delivers a result never
waits for input or output here.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable

from phm.checking.check_turns import FOR_REPORT
from phm.core.bus import Bus
from phm.core.clock import Clock
from phm.core.model import Event, Fault, FaultClosed, Note, Report, ReportStarted, Result, Stamp, UnitState
from phm.tracker import Effects, Tracker

WakeUnits = Callable[[Iterable[str], str], None]
RECENT_FAULTS = 20


class Pipeline:
    """The only owner of the tracker. `pass_limit_s` ends a pass whose slowest check does not return."""

    def __init__(self, tracker: Tracker, bus: Bus, clock: Clock, pass_limit_s: float = 15.0) -> None:
        self._tracker, self._bus, self._clock, self._pass_limit_s = tracker, bus, clock, pass_limit_s
        self._lock = threading.Lock()
        self._wake_units: WakeUnits = lambda units, reason: None
        self._pass_number = 0
        self._pass_started: Stamp | None = None
        self._outstanding: set[str] = set()
        self._overdue: set[str] = set()
        """Units whose check has exceeded its deadline and not returned since: no pass waits for them."""
        self._recent: list[Fault] = []
        self.last_result_at = clock.mono()
        """When a check last returned (monotonic seconds): shows that the scheduler works."""
        self.complete = False
        """Whether the first report is complete."""
        self.waiting = True
        """Whether `tick` may have something to do before the next result, e.g. while a unit settles or an action is in progress."""
        self._wake_loop: Callable[[], None] = lambda: None

    def attach(self, wake_units: WakeUnits, wake_loop: Callable[[], None] = lambda: None) -> None:
        """Set how to run units again, and what to call when `waiting` becomes true."""
        self._wake_units, self._wake_loop = wake_units, wake_loop

    def restore(self, faults: Iterable[Fault], given_up: Iterable[Fault], fault_count: int = 0) -> tuple[Event, ...]:
        """Before anything runs: see `Tracker.restore`. The caller publishes the events once subscribers exist."""
        with self._lock:
            return tuple(self._tracker.restore(faults, given_up, self._clock.stamp(), fault_count).events)

    # ------------------------------------------------------------ from the scheduler

    def observe(self, results: dict[str, Result], started: float, duration_s: float, *, overdue: bool = False) -> None:
        """Take the results of one run; `started` in monotonic seconds."""
        now = self._clock.stamp()
        rerun: set[str] = set()
        with self._lock:
            if overdue:
                self._overdue.update(results)
            else:
                self.last_result_at = now.mono
                self._overdue.difference_update(results)
            changed = False
            for unit, result in results.items():
                effects = self._tracker.observe(unit, result, started, now, duration_s)
                rerun |= self._publish(effects)
                changed = changed or effects.waiting or bool(effects.events or effects.rerun)
            if not overdue and self._pass_started is not None and started >= self._pass_started.mono:
                self._outstanding.difference_update(results)
            self._finish_pass(now)
        self._wake(rerun)
        if changed:
            self._wait()

    def tick(self) -> None:
        """Apply the passing of time; called a few times a second."""
        now = self._clock.stamp()
        with self._lock:
            effects = self._tracker.tick(now)
            rerun, self.waiting = self._publish(effects), effects.waiting
            if self._pass_started is not None and now.mono - self._pass_started.mono >= self._pass_limit_s:
                self._end_pass(now, self._pass_started)
        self._wake(rerun)

    def begin_pass(self) -> None:
        """Begin a report: it ends when every check has run since now, except checks that hang.

        A pass that is still open is published first, with the current state.
        """
        with self._lock:
            now = self._clock.stamp()
            if self._pass_started is not None:
                self._end_pass(now, self._pass_started)
            self._pass_number += 1
            self._pass_started = now
            self._outstanding = {state.unit for state in self._tracker.states()}
            self._bus.publish(ReportStarted(now, self._pass_number))
            units = set(self._outstanding)
            self._finish_pass(now)
        self._wake_units(units, FOR_REPORT)

    # ------------------------------------------------------------ from recovery and from events

    def begin_action(
        self,
        target: str,
        owner: str,
        action: str,
        at_most_s: float,
        *,
        verifying: bool = False,
        leaves_running: bool = False,
    ) -> None:
        self._apply(
            lambda now: self._tracker.begin_action(
                target, owner, action, now, at_most_s, verifying=verifying, leaves_running=leaves_running
            )
        )

    def end_action(self, target: str, *, worked: bool) -> None:
        self._apply(lambda now: self._tracker.end_action(target, now, worked=worked))

    def action_not_needed(self, target: str) -> None:
        """The action in progress on the target found nothing to do: see `Tracker.action_not_needed`."""
        self._apply(lambda now: self._tracker.action_not_needed(target))

    def clear_action_credit(self, unit: str) -> None:
        self._apply(lambda now: self._tracker.clear_action_credit(unit))

    def action_on(self, target: str) -> str:
        """The recovery action in progress on the target; empty: none."""
        with self._lock:
            return self._tracker.action_on(target)

    def put_on_hold(self, target: str, words: str, conditions: frozenset[str] = frozenset()) -> None:
        """The target is on hold: see `Tracker.put_on_hold`."""
        self._apply(lambda now: self._tracker.put_on_hold(target, words, conditions, now))

    def end_hold(self, target: str) -> None:
        """The hold of the target is over: see `Tracker.end_hold`."""
        self._apply(lambda now: self._tracker.end_hold(target, now))

    def expect_stop(self, target: str, at_most_s: float) -> None:
        """The container received a stop signal (`docker stop`): see `Tracker.expect_stop`."""
        self._apply(lambda now: self._tracker.expect_stop(target, now, at_most_s))

    def container_ended(self, target: str) -> None:
        """An event reports that the container has exited: see `Tracker.container_ended`."""
        self._apply(lambda now: self._tracker.container_ended(target, now))

    def is_stopping(self, target: str) -> bool:
        """Whether the container received a stop signal and has not exited yet."""
        with self._lock:
            return self._tracker.is_stopping(target, self._clock.mono())

    def container_started(self, target: str) -> None:
        """An event reports a start of the container: see `Tracker.container_started`."""
        self._apply(lambda now: self._tracker.container_started(target, now))

    def escalate(self, fault_id: str) -> None:
        self._apply(lambda now: self._tracker.escalate(fault_id, now))

    def clear_given_up(self, *units: str) -> None:
        """Recovery has a reason to try again: see `Tracker.clear_given_up`."""
        self._apply(lambda now: self._tracker.clear_given_up(units, now))

    def recheck(self, *units: str) -> None:
        """Run these units' checks now, e.g. to verify an action."""
        self._wake_units(units, "verify")

    def found_ok(self, unit: str, mono: float) -> bool:
        """Whether a run that began after `mono` found the unit OK: see `Tracker.found_ok`."""
        with self._lock:
            return self._tracker.found_ok(unit, mono)

    def failing_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        """Dependents of `unit` that have not been found free of ERROR since `mono`: see `Tracker.failing_dependents`."""
        with self._lock:
            return self._tracker.failing_dependents(unit, mono)

    def unknown_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        """Dependents of `unit` that were OK before and are unknown by their runs since `mono`: see `Tracker.unknown_dependents`."""
        with self._lock:
            return self._tracker.unknown_dependents(unit, mono)

    def dependencies(self, unit: str) -> tuple[str, ...]:
        """Dependencies of `unit` in the same target without a separate fault: see `Tracker.dependencies`."""
        with self._lock:
            return self._tracker.dependencies(unit)

    def confirmed_bad(self, unit: str, mono: float) -> bool:
        """Whether the unit is still in ERROR by a run that began after `mono`: see `Tracker.confirmed_bad`."""
        with self._lock:
            return self._tracker.confirmed_bad(unit, mono)

    def starved_by(self, unit: str) -> str:
        """The pressure unit that explains this unit's problem; empty: none. See `Tracker.starved_by`."""
        with self._lock:
            return self._tracker.starved_by(unit, self._clock.stamp())

    def active_pressure(self, unit: str) -> str:
        """The pressure unit of this one that is in ERROR now: see `Tracker.active_pressure`."""
        with self._lock:
            return self._tracker.active_pressure(unit)

    def newest(self, unit: str, mono: float = float("-inf")) -> Result | None:
        """The unit's newest result, published or not, if its run began after `mono`; None, too, if there is no such unit."""
        with self._lock:
            return self._tracker.newest(unit, mono)

    # ------------------------------------------------------------ for reporters

    def note(self, kind: str, text: str) -> None:
        self._bus.publish(Note(self._clock.stamp(), kind, text))

    def states(self) -> tuple[UnitState, ...]:
        with self._lock:
            return self._tracker.states()

    def undecided(self) -> tuple[str, ...]:
        """Units that need more time or more results before their level is published: see `Tracker.undecided`."""
        with self._lock:
            return self._tracker.undecided(self._clock.stamp())

    def open_faults(self) -> tuple[Fault, ...]:
        with self._lock:
            return self._tracker.open_faults()

    def fault_count(self) -> int:
        """The number of the last fault that was opened."""
        with self._lock:
            return self._tracker.fault_count

    def given_up(self) -> tuple[Fault, ...]:
        """Escalated faults of units that have not been OK since."""
        with self._lock:
            return self._tracker.given_up()

    def recent_faults(self) -> tuple[Fault, ...]:
        """The last RECENT_FAULTS closed faults, oldest first."""
        with self._lock:
            return tuple(self._recent)

    # ------------------------------------------------------------ internal

    def _apply(self, change: Callable[[Stamp], Effects]) -> None:
        with self._lock:
            rerun = self._publish(change(self._clock.stamp()))
        self._wake(rerun)
        self._wait()

    def _publish(self, effects: Effects) -> set[str]:
        for event in effects.events:
            if isinstance(event, FaultClosed):
                self._recent = [*self._recent, event.fault][-RECENT_FAULTS:]
            self._bus.publish(event)
        return effects.rerun

    def _wait(self) -> None:
        if not self.waiting:
            self.waiting = True
            self._wake_loop()

    def _wake(self, units: set[str]) -> None:
        if units:
            self._wake_units(units, "confirm")

    def _finish_pass(self, now: Stamp) -> None:
        if self._pass_started is not None and self._outstanding <= self._overdue:
            self._end_pass(now, self._pass_started)

    def _end_pass(self, now: Stamp, began: Stamp) -> None:
        states = self._tracker.states()
        missing = tuple(state.unit for state in states if state.unit in self._outstanding)
        self._bus.publish(Report(now, self._pass_number, began, states, missing))
        self._pass_started, self.complete = None, True
