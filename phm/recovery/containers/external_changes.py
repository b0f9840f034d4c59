"""Changes of one target that are not caused by its own attempts, and their effect on these: the container is started by
others, a dependency recovers, or another recovery restarts it as a dependent."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable

from phm.checking.pipeline import Pipeline
from phm.core.clock import Clock
from phm.core.model import Fault, Phase
from phm.recovery.containers.container_generation import Generation, GenerationTracker, by_phm
from phm.recovery.fault_cases import FaultCase
from phm.recovery.history import CLEAN_S, History
from phm.recovery.policy import DOWN, HOLD
from phm.recovery.safety.action_limits import ActionLimits
from phm.recovery.safety.target_locks import TargetLocks


class ExternalChanges:
    """Used by the target's worker thread, except `dependency_recovered`, which any thread may call.

    grace_s: of a unit, seconds.
    """

    def __init__(
        self,
        target: str,
        history: History,
        pipeline: Pipeline,
        clock: Clock,
        generations: GenerationTracker,
        locks: TargetLocks,
        limits: ActionLimits,
        grace_s: Callable[[str], float],
    ) -> None:
        self._target, self._history, self._pipeline, self._clock = target, history, pipeline, clock
        self._generations, self._locks, self._limits, self._grace_s = generations, locks, limits, grace_s
        self._generation: Generation | None = None
        self._recovered: list[tuple[Collection[str], float]] = []
        self._lock = threading.Lock()

    def dependency_recovered(self, units: Collection[str], down_from: float) -> None:
        """A dependency of these units of the target has recovered; it was down from this time on."""
        with self._lock:
            self._recovered.append((units, down_from))

    def update(self, cases: Iterable[FaultCase]) -> bool:
        """Apply the changes to the history and the cases. Returns whether any attempt counts, so that further changes
        matter."""
        given_up = [fault.unit for fault in self._pipeline.given_up() if fault.result.target == self._target]
        with self._lock:
            recovered, self._recovered = self._recovered, []
        for units, down_from in recovered:
            reset = self._history.reset_backoff(units, down_from).intersection(given_up)
            self._pipeline.clear_given_up(*reset)
        if not given_up and not self._history.within(self._clock.mono() - CLEAN_S):
            self._generations.forget(self._target)
            self._generation = None
            return False
        since = self._generations.external_start(self._target)
        if since is not None and (self._history.discount_before(since) or given_up):
            self._pipeline.note("PHM", f"{self._target} was started again outside PHM: recovery attempts reset")
            self._pipeline.clear_given_up(*given_up)
        self._follow_generation(cases)
        return True

    def attempted(
        self, cases: Iterable[FaultCase], mine: FaultCase, before: Generation | None, *, superseded: bool
    ) -> None:
        """An attempt on the target, for the case `mine`, has ended: the current generation is expected.

        Earlier results do not decide what to do next, for that case and for the others. The others get the grace of
        their units if the container is no longer in the generation `before`.
        """
        now, self._generation = self._clock.mono(), self._generations.current(self._target)
        restarted = self._generation is not None and not self._generation.same(before)
        for case in cases:
            self._expect_current(case)
            waits = superseded or (restarted and case.fault.id != mine.fault.id)
            recheck_from = now + (self._grace_s(case.fault.unit) if waits else 0.0)
            case.recheck_from = max(recheck_from, case.recheck_from or recheck_from)

    def generation_changed(self, case: FaultCase) -> bool:
        """Whether the container is no longer in the generation in which the fault was found: it has already been
        restarted.

        A run that begins after the grace of that restart must then find the unit in ERROR before any action.
        """
        generation = self._generations.current(self._target)
        if generation is None or case.generation in ("", generation.name):
            return False
        case.generation = generation.name
        after_grace = self._clock.mono() + self._grace_s(case.fault.unit)
        case.recheck_from = max(after_grace, case.recheck_from or after_grace)
        return True

    def note_hold(self, case: FaultCase) -> None:
        """After a hold, or once it is decided that an operator did not stop the container, a new run must confirm the fault."""
        held, now = case.on_hold, self._clock.mono()
        case.on_hold = self._limits.on_hold
        if held and not case.on_hold:
            case.reported.discard(f"{Phase.REFUSED.value} {HOLD}")
            case.recheck_from = now if case.recheck_from is None else max(now, case.recheck_from)

    def left_down(self) -> list[Fault]:
        """Faults that recovery has given up on, of a container that was down then and is still down in a newer run."""
        last = self._history.attempts[-1].at if self._history.attempts else float("-inf")
        return [
            fault
            for fault in self._pipeline.given_up()
            if fault.result.target == self._target
            and fault.result.condition in DOWN
            and self._pipeline.bad_since(fault.unit, last)
        ]

    def unconfirmed_since(self, case: FaultCase) -> float | None:
        """A run that begins after this must find the unit in ERROR before any action; None: one has."""
        recheck_from = self._recheck_from(case)
        confirmed = recheck_from is None or self._pipeline.bad_since(case.fault.unit, recheck_from)
        return None if confirmed else recheck_from

    def _recheck_from(self, case: FaultCase) -> float | None:
        restarted_at = self._locks.dependent_restart_at(self._target)
        if restarted_at == float("-inf"):
            return case.recheck_from
        after_restart = restarted_at + self._grace_s(case.fault.unit)
        return after_restart if case.recheck_from is None else max(after_restart, case.recheck_from)

    def _expect_current(self, case: FaultCase) -> None:
        if self._generation is not None:
            case.generation = self._generation.name

    def _follow_generation(self, cases: Iterable[FaultCase]) -> None:
        """The container was started without an attempt: its parts get their grace. If others started it, the action
        hold of an interrupted action ends. If PHM did, the engine has completed the request of an attempt late."""
        before, self._generation = self._generation, self._generations.current(self._target)
        if self._generation is None or before is None or self._generation.same(before):
            return
        now, mine = self._clock.mono(), self._generation.by == by_phm(self._target)
        for case in cases:
            self._expect_current(case)
            if case.interrupted and not mine:
                case.interrupted = False
                self._locks.end_hold(self._target, case, worked=False)
            after_grace = now + self._grace_s(case.fault.unit)
            if case.recheck_from is None or mine:
                case.recheck_from = max(after_grace, case.recheck_from or after_grace)
