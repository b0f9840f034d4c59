"""What happens around one container, apart from PHM's own attempts, and changes what these mean: others start it, something
that it needs comes back, another repair restarts it as a dependant."""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterable

from phm.core.model import Fault, Phase
from phm.recovery.containers.container_generation import Generation, by_phm
from phm.recovery.fault_cases import FaultCase
from phm.recovery.history import CLEAN_S, History
from phm.recovery.policy import DOWN, HOLD
from phm.recovery.shop import Shop


class ExternalChanges:
    """Belongs to the thread of its container, but for `dependency_recovered`, which any thread may call."""

    def __init__(self, target: str, shop: Shop, history: History) -> None:
        self._target, self._shop, self._history = target, shop, history
        self._life: Generation | None = None
        self._recovered_dependencies: list[tuple[Collection[str], float]] = []
        self._lock = threading.Lock()

    def dependency_recovered(self, units: Collection[str], down_from: float) -> None:
        """Something that these units of the target need has come back, after it was down from then on."""
        with self._lock:
            self._recovered_dependencies.append((units, down_from))

    def update(self, cases: Iterable[FaultCase]) -> bool:
        """Let the history and the cases follow what has happened; whether attempts count, so that it matters what will."""
        pipeline, lives = self._shop.pipeline, self._shop.lives
        given_up = [fault.unit for fault in pipeline.given_up() if fault.result.target == self._target]
        with self._lock:
            recovered, self._recovered_dependencies = self._recovered_dependencies, []
        for units, down_from in recovered:
            reset = self._history.reset_backoff(units, down_from).intersection(given_up)
            pipeline.clear_given_up(*reset)
        if not given_up and not self._history.within(self._shop.clock.mono() - CLEAN_S):
            lives.forget(self._target)
            self._life = None
            return False
        since = lives.external_start(self._target)
        if since is not None and (self._history.discount_before(since) or given_up):
            pipeline.note("PHM", f"{self._target} was started again by somebody else: recovery counts anew")
            pipeline.clear_given_up(*given_up)
        self._look_at_life(cases)
        return True

    def attempted(
        self, cases: Iterable[FaultCase], mine: FaultCase, before: Generation | None, *, superseded: bool
    ) -> None:
        """An attempt of the container's own, for the case `mine`, is over: the current life is expected.

        What was found until now says nothing about what to do next, for that case as for the others. These get the grace of
        their units when the container is no longer in the life that it was in `before`.
        """
        now, self._life = self._shop.clock.mono(), self._shop.lives.look(self._target)
        restarted = self._life is not None and not self._life.same(before)
        for case in cases:
            self._follow(case)
            waits = superseded or (restarted and case.fault.id != mine.fault.id)
            recheck_from = now + (self._shop.grace_s(case.fault.unit) if waits else 0.0)
            case.recheck_from = max(recheck_from, case.recheck_from or recheck_from)

    def generation_changed(self, case: FaultCase) -> bool:
        """Whether the container is no longer in the life in which the fault was found: it has had its restart, whoever did it.

        A run that begins after the grace of that restart must then find the unit in ERROR before anything is done.
        """
        life = self._shop.lives.look(self._target)
        if life is None or case.life in ("", life.name):
            return False
        case.life = life.name
        after_grace = self._shop.clock.mono() + self._shop.grace_s(case.fault.unit)
        case.recheck_from = max(after_grace, case.recheck_from or after_grace)
        return True

    def _follow(self, case: FaultCase) -> None:
        """What is required of the case from now on holds for the life at hand."""
        if self._life is not None:
            case.life = self._life.name

    def note_hold(self, case: FaultCase) -> None:
        """After a hold, or once it is decided that it was not stopped by hand, nothing is done before a fresh run has found the unit in ERROR."""
        held, now = case.on_hold, self._shop.clock.mono()
        case.on_hold = self._shop.holds.binds(self._target, now)
        if held and not case.on_hold:
            case.reported.discard(f"{Phase.REFUSED.value} {HOLD}")
            case.recheck_from = now if case.recheck_from is None else max(now, case.recheck_from)

    def left_down(self) -> list[Fault]:
        """Faults of the container that recovery has given up on, which was down then and is down now, as a fresh run says."""
        last = self._history.attempts[-1].at if self._history.attempts else float("-inf")
        return [
            fault
            for fault in self._shop.pipeline.given_up()
            if fault.result.target == self._target
            and fault.result.condition in DOWN
            and self._shop.pipeline.bad_since(fault.unit, last)
        ]

    def unchecked_since(self, case: FaultCase) -> float | None:
        """A run that begins after this must find the unit in ERROR before anything is done; None: one has."""
        recheck_from = self.recheck_from(case)
        known = recheck_from is None or self._shop.pipeline.bad_since(case.fault.unit, recheck_from)
        return None if known else recheck_from

    def recheck_from(self, case: FaultCase) -> float | None:
        """A run that began then must have found the unit in ERROR before anything is done; None: it is known."""
        dependent_restart_at = self._shop.hands.dependent_restart_at(self._target)
        if dependent_restart_at == float("-inf"):
            return case.recheck_from
        after_other = dependent_restart_at + self._shop.grace_s(case.fault.unit)
        return after_other if case.recheck_from is None else max(after_other, case.recheck_from)

    def _look_at_life(self, cases: Iterable[FaultCase]) -> None:
        """The container was started apart from an attempt: its parts get their grace. By others: the hold of a repair that was
        cut short ends. By PHM: the engine has done late what an attempt had asked for."""
        before, self._life = self._life, self._shop.lives.look(self._target)
        if self._life is None or before is None or self._life.same(before):
            return
        now, mine = self._shop.clock.mono(), self._life.by == by_phm(self._target)
        for case in cases:
            self._follow(case)
            if case.interrupted and not mine:
                case.interrupted = False
                self._shop.hands.release(self._target, case, worked=False)
            after_grace = now + self._shop.grace_s(case.fault.unit)
            if case.recheck_from is None or mine:
                case.recheck_from = max(after_grace, case.recheck_from or after_grace)
