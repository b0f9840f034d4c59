"""The thread of one container: carries out what the policy decides, one action at a time, and proves that it helped.

A fault is healed only when its own check has said OK in a run that began after the action. Until then
the tracker holds the target: what breaks because of the repair is no fault of its own. Each container
has its own thread, so that a container that cannot be stopped keeps nobody else from being healed.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass, field, replace

from phm.facts import CannotTell, NotPermitted
from phm.model import ActionEvent, Fault, Phase
from phm.recovery.base import Action, ActionFailed
from phm.recovery.policy import Act, Advise, Attempt, Decision, GiveUp, History, Leave, Wait, decide, ladder_of
from phm.recovery.shop import Shop
from phm.recovery.state import MAX_TOLD, Case, UnderWay
from phm.settings import ContainerSettings

logger = logging.getLogger(__name__)

POLL_S = 0.05
LOOK_AGAIN_S = 0.5
CUT_SHORT_S = 20.0
"""A target whose action was cut short is held this long, beyond the unit's grace, unless it is healed before."""
PROOF_S = 0.5
"""A restored fault that has not been judged yet is looked at again this often."""
PROOF_MARGIN_S = 20.0
"""Beyond an action's deadline and `verify`, its hold lasts this long: what needs the target may come back last."""
STILL_BAD_S = 2.0
"""A run that began this long after the action (beyond the unit's grace) and is still ERROR ends the wait."""


@dataclass(slots=True)
class _Case:
    """An open fault in the hands of its target's thread. `told` remembers what was said, to say it once."""

    fault: Fault
    told: set[str] = field(default_factory=set)
    refused: bool = False
    approved: bool = False
    """An operator has said yes; holds for one action, and not over a restart of PHM."""
    proof_from: float | None = None
    """Restored: nothing is done before a run that began after this (monotonic seconds) has found the unit in ERROR."""
    cut_short: bool = False
    """Restored, with an action under way: the target is held until it is healed or acted on anew."""


class NotApprovable(Exception):
    """There is nothing to approve about this fault; the message says why."""


class TargetWorker:
    """The thread of one container. Invariant: at most one action on the container at any time."""

    def __init__(self, target: str, container: ContainerSettings | None, shop: Shop, history: History) -> None:
        self._target, self._container, self._shop = target, container, shop
        self._history = history
        self._under_way: UnderWay | None = None
        self._cases: dict[str, _Case] = {}
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._stopping = False
        self._thread = threading.Thread(target=self._loop, name=f"phm-heal-{target}", daemon=True)
        self._thread.start()

    def opened(self, fault: Fault) -> None:
        with self._lock:
            case = self._cases.get(fault.unit)
            if case is not None and case.fault.id == fault.id:
                case.fault = fault
            else:
                self._cases[fault.unit] = _Case(fault)
        self._wake.set()

    def closed(self, fault: Fault) -> None:
        with self._lock:
            case = self._cases.pop(fault.unit, None)
        if case is not None and case.cut_short:
            self._shop.pipeline.release(self._target, worked=True)
        self._wake.set()

    def restored(self, fault: Fault, case: Case, cut: UnderWay | None) -> None:
        """A fault of an earlier run of PHM: what was said of it is not said again, and it is judged afresh first.

        cut: an action for it that PHM's end cut short. What it broke is no fault of its own: the target is held.
        """
        grace_s = self._shop.grace_s(fault.unit)
        proof_from = self._shop.clock.mono() + grace_s
        told, held = set(case.told), cut is not None
        with self._lock:
            self._cases[fault.unit] = _Case(fault, told, case.refused, proof_from=proof_from, cut_short=held)
        if cut is not None:
            self._shop.pipeline.hold(self._target, fault.unit, cut.attempt.action, grace_s + CUT_SHORT_S)
        self._wake.set()

    def kept(self) -> tuple[dict[str, Case], UnderWay | None]:
        """For the state file: the cases by fault id, and the action under way."""
        with self._lock:
            cases = list(self._cases.values())
        said = {case.fault.id: Case(case.refused, tuple(sorted(case.told)[:MAX_TOLD])) for case in cases}
        return said, self._under_way

    def approve(self, fault_id: str) -> str:
        """An operator says yes: what will be done now. Raises NotApprovable."""
        with self._lock:
            case = next((case for case in self._cases.values() if case.fault.id == fault_id), None)
        if case is None:
            raise NotApprovable(f"{fault_id} is not in the hands of recovery")
        unbound = self._decide(case.fault, approved=False)
        if not isinstance(unbound, Advise) and not case.refused:
            raise NotApprovable(f"nothing is advised for {fault_id}: {_in_words(unbound)}")
        decision = self._decide(case.fault, approved=True)
        if isinstance(decision, (Leave, GiveUp)):
            raise NotApprovable(f"{fault_id} cannot be helped by a yes: {_in_words(decision)}")
        action = unbound.action if isinstance(unbound, Advise) else getattr(decision, "action", "recovery")
        later = f", when it may: {decision.why}" if isinstance(decision, Wait) else ""
        detail = f"approved: {action} {self._target} for {case.fault.unit}{later}"
        case.told.discard(f"{Phase.ADVISED.value} {action}")
        self._publish(case.fault, action, Phase.APPROVED, detail)
        case.refused, case.approved = False, True
        self._wake.set()
        return detail

    def stop(self) -> None:
        self._stopping = True
        self._wake.set()

    # ------------------------------------------------------------ deciding

    def _loop(self) -> None:
        while not self._stopping:
            self._wake.clear()
            try:
                wait_s = self._next()
            except Exception:  # a defect here must not end healing for this container for ever
                logger.exception("recovery of %s failed unexpectedly", self._target)
                wait_s = 5.0
            if wait_s != 0:
                self._shop.clock.wait(self._wake, wait_s)

    def _next(self) -> float | None:
        """Do the most upstream thing there is to do; seconds to wait (0: look again now, None: until woken)."""
        # The tracker knows first what is over; its event may still be on its way through the bus.
        still_open = {fault.id for fault in self._shop.pipeline.open_faults()}
        with self._lock:
            self._cases = {unit: case for unit, case in self._cases.items() if case.fault.id in still_open}
            cases = sorted(self._cases.values(), key=lambda case: case.fault.slot)
        waits: list[float] = []
        for case in cases:
            if case.refused:
                continue
            if case.proof_from is not None and not self._shop.pipeline.bad_since(case.fault.unit, case.proof_from):
                waits.append(PROOF_S)
                continue
            case.proof_from = None
            decision = self._decide(case.fault, approved=case.approved)
            if isinstance(decision, Act):
                self._perform(case, decision)
                return 0
            again = self._say(case, decision)
            if again is not None:
                waits.append(max(POLL_S, again - self._shop.clock.mono()))
        return min(waits, default=None)

    def _usable(self, fault: Fault) -> frozenset[str] | None:
        """The rungs of the fault's ladder that apply to it. One that is not installed stays, to be told as such."""
        if self._container is None:
            return None
        actions, settings = self._shop.actions, self._shop.context.settings
        return frozenset(
            rung
            for rung in ladder_of(fault.result.condition, settings.recovery)
            if rung not in actions or actions[rung].applies(self._container, fault, settings)
        )

    def _decide(self, fault: Fault, *, approved: bool) -> Decision:
        shop = self._shop
        return decide(
            fault,
            self._history,
            shop.clock.mono(),
            container=self._container,
            armed=shop.armed(),
            settings=shop.context.settings.recovery,
            free_actions=shop.free_actions,
            usable=self._usable(fault),
            approved=approved,
        )

    def _say(self, case: _Case, decision: Decision) -> float | None:
        """Tell a decision that is not to act, once; when to look again, or None when only an event helps."""
        if isinstance(decision, Advise):
            self._once(
                case, decision.action, Phase.ADVISED, f"advised: {decision.action} {self._target} ({decision.why})"
            )
            return decision.again_at
        if isinstance(decision, Wait):
            if decision.tell:
                self._once(case, "wait", Phase.REFUSED, f"{self._target} is left alone for now: {decision.why}")
            return decision.until
        if isinstance(decision, GiveUp):
            named = self._container.name if self._container is not None else None
            step = f"look at it by hand: docker logs --tail 50 {named or self._target}"
            self._once(case, decision.action, Phase.ESCALATED, f"gave up on {self._target}: {decision.why}; {step}")
            case.refused = True
            self._shop.pipeline.escalate(case.fault.id)
        return None

    def _once(self, case: _Case, action: str, phase: Phase, detail: str) -> None:
        said = f"{phase.value} {action}"
        if said not in case.told:
            case.told.add(said)
            self._publish(case.fault, action, phase, detail)

    # ------------------------------------------------------------ acting

    def _perform(self, case: _Case, act: Act) -> None:
        fault, shop = case.fault, self._shop
        action_class = shop.actions.get(act.action)
        if action_class is None or self._container is None:
            self._once(
                case,
                act.action,
                Phase.FAILED,
                f"no installed package provides the action {act.action!r}: correct recovery.ladders",
            )
            case.refused = True
            return
        verify_s = shop.context.settings.recovery.verify
        began = shop.clock.mono()
        case.approved = case.cut_short = False
        attempt = Attempt(began, fault.unit, fault.result.condition, act.action, worked=False)
        self._under_way = UnderWay(fault.id, attempt)
        at_most_s = action_class.deadline_s + verify_s + PROOF_MARGIN_S
        shop.pipeline.hold(self._target, fault.unit, act.action, at_most_s, proving=True)
        worked = False
        try:
            what = f"{act.action} {self._target} for: {fault.result.summary}"
            self._publish(fault, act.action, Phase.STARTED, what, act.attempt)
            detail, worked = self._run(case, action_class(), act)
            if worked:
                done = shop.clock.mono()
                self._publish(fault, act.action, Phase.DONE, detail, act.attempt)
                missing = self._verify(fault, done, verify_s, action_class.proof_s)
                took = shop.clock.mono() - began
                # On the last rung nothing more can be done for what has not come back: it is told as faults of its own.
                worked = not missing or (missing != fault.unit and not self._has_next_rung(fault, act.action))
                detail = f"{act.action} of {self._target} did not bring {missing} back"
                if worked:
                    detail = f"{fault.unit} is OK again {took:.1f} s after the action began"
            if self._stopping and not worked:
                return  # cut short by the end of PHM: the state file still says that it was under way
            self._end(replace(attempt, worked=worked))
            self._publish(fault, act.action, Phase.VERIFIED if worked else Phase.FAILED, detail, act.attempt)
        finally:
            if self._under_way is not None and not self._stopping:
                self._end(attempt)
            shop.pipeline.release(self._target, worked=worked)

    def _end(self, attempt: Attempt) -> None:
        """Counted before it is told: whoever kills PHM in between loses no attempt."""
        self._history.add(attempt)
        self._under_way = None

    def _run(self, case: _Case, action: Action, act: Act) -> tuple[str, bool]:
        """Run the action in a thread of its own, so that a plug-in that hangs costs its deadline and no more."""
        outcome: list[tuple[str, bool]] = []
        finished = threading.Event()

        def work() -> None:
            try:
                assert self._container is not None
                outcome.append((action.run(self._container, case.fault, self._shop.context), True))
            except NotPermitted as error:
                case.refused = True
                outcome.append((f"healing not permitted: {error}; PHM only reports this fault", False))
            except (ActionFailed, CannotTell) as error:
                outcome.append((str(error), False))
            except BaseException as error:  # plug-in code
                logger.exception("action %s crashed", act.action)
                outcome.append((f"the action crashed: {type(error).__name__}: {error}", False))
            finally:
                finished.set()

        threading.Thread(target=work, name=f"phm-act-{act.action}-{self._target}", daemon=True).start()
        if not self._shop.clock.wait(finished, action.deadline_s):
            return f"{act.action} has not come back within {action.deadline_s:g} s", False
        return outcome[0]

    def _verify(self, fault: Fault, done: float, verify_s: float, proof_s: float) -> str:
        """What has not come back: empty as soon as runs that began after `done` find the unit and all that needs it well.

        The unit itself gets `verify_s`, less when it is surely still bad; what needs it gets its grace. Then the name
        of the first that is missing.
        """
        shop = self._shop
        late = done + shop.grace_s(fault.unit) + STILL_BAD_S
        asked = float("-inf")
        waiting: tuple[str, ...] = (fault.unit,)
        while not self._stopping:
            now = shop.clock.mono()
            if shop.pipeline.well_since(fault.unit, done):
                waiting = shop.pipeline.suffering(fault.unit, done + proof_s)
                if not waiting and shop.pipeline.well_since(fault.unit, done + proof_s):
                    return ""
                waiting = waiting or (fault.unit,)
                if now - done > max(shop.grace_s(name) for name in waiting) + STILL_BAD_S + proof_s:
                    return waiting[0]
            elif now - done > verify_s or shop.pipeline.bad_since(fault.unit, late):
                return fault.unit
            if now - asked >= LOOK_AGAIN_S:
                asked = now
                shop.pipeline.look_again(fault.unit, *waiting)
            shop.clock.wait(threading.Event(), POLL_S)
        return fault.unit

    def _has_next_rung(self, fault: Fault, action: str) -> bool:
        ladder = ladder_of(fault.result.condition, self._shop.context.settings.recovery)
        usable = self._usable(fault)
        rungs = [rung for rung in ladder if usable is None or rung in usable]
        return action in rungs[:-1]

    def _publish(self, fault: Fault, action: str, phase: Phase, detail: str, attempt: int = 1) -> None:
        stamp = self._shop.clock.stamp()
        self._shop.publish(ActionEvent(stamp, fault.id, fault.unit, action, self._target, phase, detail, attempt))


def _in_words(decision: Decision) -> str:
    return f"{decision.action} is about to be done" if isinstance(decision, Act) else decision.why
