"""Restores the state of the previous run of PHM, and keeps that of this run (`phm.recovery.persistence.state_file`)."""

from __future__ import annotations

from dataclasses import replace

from phm.checking.pipeline import Pipeline
from phm.core.bus import Bus
from phm.core.clock import Clock
from phm.core.model import ActionEvent, Event, Fault, Phase, Stamp
from phm.recovery.executor import Executor
from phm.recovery.persistence.state import PersistedState, RecoveryState
from phm.recovery.persistence.state_file import StateFile, StateWriter
from phm.recovery.safety.armed_state import ArmedMonitor

WARNED_S = 12.0
"""A state that was lost is reported for this long after the start: one refresh of the status, every 10 s, contains it."""


class PersistenceService:
    """`restore` goes before the reporters start, `resume` after them and before the first result."""

    def __init__(
        self,
        state_dir: str,
        window_s: float,
        pipeline: Pipeline,
        bus: Bus,
        clock: Clock,
        armed: ArmedMonitor | None = None,
    ) -> None:
        """window_s: age from which attempts no longer count (`recovery.window`)."""
        self._armed = armed
        self._pipeline, self._bus, self._clock = pipeline, bus, clock
        self._window_s = window_s
        self._file = StateFile(state_dir, clock)
        self._state, self._warning = PersistedState(), ""
        self._warned_until = float("-inf")
        self._events: tuple[Event, ...] = ()
        self._keeper: StateWriter | None = None
        self._given = False

    def restore(self, given: PersistedState | None = None) -> None:
        """Put open faults back, from the file or as `given` by the daemon that this one replaces; nothing is published yet."""
        self._given = given is not None
        self._state, self._warning = (given, "") if given is not None else self._file.load(self._window_s)
        if not self._given:
            self._clock.steps.resume(self._state.clock)
        self._events = self._pipeline.restore(self._state.faults, self._state.given_up, self._state.fault_count)
        if self._armed is not None:
            self._armed.restore(self._state.recovery.armed)

    def requests(self) -> tuple[ActionEvent, ...]:
        """What was requested of the operator for the restored faults and is not answered. Recovery does not publish it again."""
        now, cases = self._clock.stamp(), self._state.recovery.cases
        advised = [(fault, cases[fault.id].advised) for fault in self._pipeline.open_faults() if fault.id in cases]
        return (
            *(_request(now, fault, action, Phase.ADVISED) for fault, action in advised if action),
            *(_request(now, fault, "", Phase.ESCALATED) for fault in self._pipeline.given_up()),
        )

    def resume(self, executor: Executor) -> None:
        """Publish what was restored, give recovery its part, and begin to keep."""
        if self._warning:
            self._note(f"warning: {self._warning}")
            self._warned_until = self._clock.mono() + WARNED_S
        for event in self._events:
            self._bus.publish(event)
        if not self._given:
            self._note_restored()
        for interrupted in executor.restore(self._state):
            self._note(interrupted)

        def kept() -> RecoveryState:
            return replace(executor.persisted(), armed=self._armed.kept() if self._armed is not None else None)

        keeper = self._keeper = StateWriter(self._file, self._pipeline, kept, self._clock)
        self._bus.subscribe(
            "state", keeper.handle, kinds=keeper.kinds, key=keeper.key, tick=keeper.tick, period_s=keeper.period_s
        )

    def state(self) -> PersistedState:
        """What this PHM knows now, for one that replaces it."""
        return self._keeper.state() if self._keeper is not None else self._state

    def _note_restored(self) -> None:
        for fault in self._pipeline.open_faults():
            self._note(f"{fault.unit}: fault {fault.id} was open when PHM stopped; recovery continues")
        for fault in self._pipeline.given_up():
            self._note(f"{fault.unit}: fault {fault.id} was given up before PHM stopped; no action follows")
        attempts = sum(len(made) for made in self._state.recovery.attempts.values())
        if attempts:
            self._note(f"restored {attempts} recovery attempts from before PHM stopped")

    def problem(self) -> str:
        """What to report: the state cannot be written; or, shortly after the start, the previous state was lost. Empty: nothing."""
        problem = self._keeper.problem() if self._keeper is not None else ""
        return problem or (self._warning if self._clock.mono() < self._warned_until else "")

    def close(self) -> None:
        """Write the state a last time; call after the bus has ended."""
        if self._keeper is not None:
            self._keeper.tick()

    def _note(self, text: str) -> None:
        self._pipeline.note("PHM", text)


def _request(at: Stamp, fault: Fault, action: str, phase: Phase) -> ActionEvent:
    return ActionEvent(at, fault.id, fault.unit, action, fault.result.target, phase)
