"""What happens around one container, apart from PHM's own attempts, and changes what these mean: others start it, something
that it needs comes back, another repair restarts it as a dependant."""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterable

from phm.core.model import Fault, Phase
from phm.recovery.cases import Case
from phm.recovery.history import CLEAN_S, History
from phm.recovery.lives import Life, by_phm
from phm.recovery.policy import DOWN, HOLD
from phm.recovery.shop import Shop


class Surroundings:
    """Belongs to the thread of its container, but for `eased`, which any thread may call."""

    def __init__(self, target: str, shop: Shop, history: History) -> None:
        self._target, self._shop, self._history = target, shop, history
        self._life: Life | None = None
        self._eased: list[tuple[Collection[str], float]] = []
        self._lock = threading.Lock()

    def eased(self, units: Collection[str], down_from: float) -> None:
        """Something that these units of the target need has come back, after it was down from then on."""
        with self._lock:
            self._eased.append((units, down_from))

    def take_note(self, cases: Iterable[Case]) -> bool:
        """Let the history and the cases follow what has happened; whether attempts count, so that it matters what will."""
        pipeline, lives = self._shop.pipeline, self._shop.lives
        given_up = [fault.unit for fault in pipeline.given_up() if fault.result.target == self._target]
        with self._lock:
            eased, self._eased = self._eased, []
        for units, down_from in eased:
            wronged = self._history.ease(units, down_from).intersection(given_up)
            pipeline.judge_afresh(*wronged)
        if not given_up and not self._history.within(self._shop.clock.mono() - CLEAN_S):
            lives.forget(self._target)
            self._life = None
            return False
        since = lives.begun_anew(self._target)
        if since is not None and (self._history.begin_anew(since) or given_up):
            pipeline.note("PHM", f"{self._target} was started again by somebody else: recovery counts anew")
            pipeline.judge_afresh(*given_up)
        self._look_at_life(cases)
        return True

    def attempted(self, cases: Iterable[Case], mine: Case, before: Life | None, *, overtaken: bool) -> None:
        """An attempt of the container's own, for the case `mine`, is over: the current life is expected.

        What was found until now says nothing about what to do next, for that case as for the others. These get the grace of
        their units when the container is no longer in the life that it was in `before`.
        """
        now, self._life = self._shop.clock.mono(), self._shop.lives.look(self._target)
        restarted = self._life is not None and not self._life.same(before)
        for case in cases:
            self._follow(case)
            waits = overtaken or (restarted and case.fault.id != mine.fault.id)
            proof_from = now + (self._shop.grace_s(case.fault.unit) if waits else 0.0)
            case.proof_from = max(proof_from, case.proof_from or proof_from)

    def outlived(self, case: Case) -> bool:
        """Whether the container is no longer in the life in which the fault was found: it has had its restart, whoever did it.

        A run that begins after the grace of that restart must then find the unit in ERROR before anything is done.
        """
        life = self._shop.lives.look(self._target)
        if life is None or case.life in ("", life.name):
            return False
        case.life = life.name
        after_grace = self._shop.clock.mono() + self._shop.grace_s(case.fault.unit)
        case.proof_from = max(after_grace, case.proof_from or after_grace)
        return True

    def _follow(self, case: Case) -> None:
        """What is required of the case from now on holds for the life at hand."""
        if self._life is not None:
            case.life = self._life.name

    def note_hold(self, case: Case) -> None:
        """After a hold, or once it is decided that it was not stopped by hand, nothing is done before a fresh run has found the unit in ERROR."""
        held, now = case.on_hold, self._shop.clock.mono()
        case.on_hold = self._shop.holds.binds(self._target, now)
        if held and not case.on_hold:
            case.told.discard(f"{Phase.REFUSED.value} {HOLD}")
            case.proof_from = now if case.proof_from is None else max(now, case.proof_from)

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

    def unproven_from(self, case: Case) -> float | None:
        """A run that begins after this must find the unit in ERROR before anything is done; None: one has."""
        proof_from = self.proof_from(case)
        known = proof_from is None or self._shop.pipeline.bad_since(case.fault.unit, proof_from)
        return None if known else proof_from

    def proof_from(self, case: Case) -> float | None:
        """A run that began then must have found the unit in ERROR before anything is done; None: it is known."""
        moved_at = self._shop.hands.moved_at(self._target)
        if moved_at == float("-inf"):
            return case.proof_from
        after_other = moved_at + self._shop.grace_s(case.fault.unit)
        return after_other if case.proof_from is None else max(after_other, case.proof_from)

    def _look_at_life(self, cases: Iterable[Case]) -> None:
        """The container was started apart from an attempt: its parts get their grace. By others: the hold of a repair that was
        cut short ends. By PHM: the engine has done late what an attempt had asked for."""
        before, self._life = self._life, self._shop.lives.look(self._target)
        if self._life is None or before is None or self._life.same(before):
            return
        now, mine = self._shop.clock.mono(), self._life.by == by_phm(self._target)
        for case in cases:
            self._follow(case)
            if case.cut_short and not mine:
                case.cut_short = False
                self._shop.hands.release(self._target, case, worked=False)
            after_grace = now + self._shop.grace_s(case.fault.unit)
            if case.proof_from is None or mine:
                case.proof_from = max(after_grace, case.proof_from or after_grace)
