"""The thread of one container: carries out what the policy decides, one action at a time, and proves that it helped.

A fault is healed only when its own check has said OK in a run that began after the action. Until then
the tracker holds the target: what breaks because of the repair is no fault of its own. Each container
has its own thread, so that a container that cannot be stopped keeps nobody else from being healed.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Collection
from dataclasses import replace
from functools import partial

from phm.core import threads
from phm.core.model import ActionEvent, Fault, Phase
from phm.core.settings import ContainerSettings
from phm.recovery.attempt import Repair
from phm.recovery.containers.external_changes import ExternalChanges
from phm.recovery.fault_cases import FaultCase, FaultCases
from phm.recovery.history import AttemptRecord, History
from phm.recovery.holds.hold_registry import BEING_STOPPED
from phm.recovery.operator.announcements import announce, in_words
from phm.recovery.operator.approvals import Approvals
from phm.recovery.operator.manual_restart import NotAllowed, NotNow, check_permitted, request_as_fault
from phm.recovery.persistence.state import PersistedCase, UnfinishedAction
from phm.recovery.policy import Act, Advise, Decision, GiveUp, Skip, Wait, decide
from phm.recovery.shop import Shop
from phm.recovery.verification import LOOK_AGAIN_S, POLL_S

logger = logging.getLogger(__name__)

CUT_SHORT_S = 20.0
"""A target whose action was cut short is held this long, beyond the unit's grace, unless it is healed before."""
PROOF_S = 0.5
"""A fault that is to be judged afresh is looked at again this often."""
WAITS_S = 1.0
"""While something that an action needs is not there, it is looked for this often; mostly its event comes first."""
ENDED = "exited"
"""The condition of a container that may have been stopped by hand."""
LIFE_S = 2.0
"""While attempts on the container count, it is looked at this often to see whether somebody else has started it again."""


class NotApprovable(Exception):
    """There is nothing to approve about this fault; the message says why."""


class TargetWorker:
    """The thread of one container. Invariant: at most one action on the container at any time.

    `_history` is changed by the thread alone; `_asked` is set with `_lock` held.
    """

    def __init__(self, target: str, container: ContainerSettings | None, shop: Shop, history: History) -> None:
        self._target, self._container, self._shop = target, container, shop
        self._history = history
        self._under_way: UnfinishedAction | None = None
        self._asked: FaultCase | None = None
        self._left_down: dict[str, FaultCase] = {}
        self._cases, self._around = FaultCases(target), ExternalChanges(target, shop, history)
        self._approvals = Approvals(target, shop, self._publish)
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._stopping = False
        self._thread = threading.Thread(target=self._loop, name=f"phm-heal-{target}", daemon=True)
        threads.start(self._thread)

    def opened(self, fault: Fault) -> None:
        self._cases.opened(fault)
        self._wake.set()

    def closed(self, fault: Fault) -> None:
        case = self._cases.closed(fault.unit)
        if case is not None and case.interrupted:
            self._shop.hands.release(self._target, case, worked=True)
        self._wake.set()

    def dependency_recovered(self, units: Collection[str], down_from: float) -> None:
        """Something that these units of the target need has come back, after it was down from then on."""
        self._around.dependency_recovered(units, down_from)
        self._wake.set()

    def restored(self, fault: Fault, case: PersistedCase, cut: UnfinishedAction | None) -> None:
        """A fault of an earlier run of PHM: what was said of it is not said again, and it is judged afresh first.

        cut: an action for it that PHM's end cut short. What it broke is no fault of its own: the target is held.
        """
        grace_s = self._shop.grace_s(fault.unit)
        recheck_from = self._shop.clock.mono() + grace_s
        mine = FaultCase(
            fault, set(case.reported), case.refused, recheck_from=recheck_from, interrupted=cut is not None
        )
        self._cases.put(mine)
        if case.approved:
            self._approvals.expire(mine, case.approved, "PHM has been restarted")
        if cut is not None:
            self._shop.hands.hold(self._target, mine, fault.unit, cut.attempt.action, grace_s + CUT_SHORT_S)
        self._wake.set()

    def kept(self) -> tuple[dict[str, PersistedCase], UnfinishedAction | None]:
        """For the state file: the cases by fault id, and the action under way."""
        return self._cases.kept(), self._under_way

    def approve(self, fault_id: str) -> str:
        """An operator approves what is advised: what will be done now. Raises NotApprovable, and NotNow when it may be later."""
        self._current()
        case = self._cases.find(fault_id)
        if case is None:
            raise NotApprovable(f"{fault_id} is not in the hands of recovery")
        unbound = self._decide(case.fault, approved=False)
        if not isinstance(unbound, Advise) and not case.refused:
            raise NotApprovable(f"nothing is advised for {fault_id}: {in_words(unbound)}")
        decision = self._decide(case.fault, approved=True)
        if isinstance(decision, (Skip, GiveUp)):
            raise NotApprovable(f"{fault_id} cannot be helped by a yes: {in_words(decision)}")
        action = unbound.action if isinstance(unbound, Advise) else getattr(decision, "action", "recovery")
        approval = self._approvals.grant(action)
        if isinstance(decision, Wait) and decision.until >= approval.until:
            holds_s = approval.until - approval.given
            raise NotNow(
                f"{decision.why}: not possible within the {holds_s:g} s of an approval, approve it again later"
            )
        later = f", when it may: {decision.why}" if isinstance(decision, Wait) else ""
        detail = f"approved: {action} {self._target} for {case.fault.unit}{later}"
        case.reported.discard(f"{Phase.ADVISED.value} {action}")
        self._publish(case.fault, action, Phase.APPROVED, detail)
        case.refused, case.approval = False, approval
        self._wake.set()
        return detail

    def restart(self, by: str) -> str:
        """An operator wants it restarted: what will be done now. Raises NotAllowed, and NotNow when it may be later."""
        self._permit()
        unit = f"container/{self._target}"
        state = next((state for state in self._shop.pipeline.states() if state.unit == unit), None)
        if state is None:
            raise NotAllowed(f"the check of {unit} is off: nobody could tell whether the restart helped")
        with self._lock:
            if self._asked is not None or self._under_way is not None:
                raise NotNow(f"{self._target} is being acted on")
            fault = request_as_fault(state, self._target, by, self._shop.clock.stamp())
            self._asked = FaultCase(fault, approval=self._approvals.grant("restart"))
        self._wake.set()
        return f"restart {self._target}, asked for by {by}"

    def wake(self) -> None:
        """Something that decisions depend on has changed."""
        self._wake.set()

    def stop(self) -> None:
        self._stopping = True
        self._wake.set()

    # ------------------------------------------------------------ deciding

    def _permit(self) -> None:
        shop = self._shop
        settings, now = shop.context.settings.recovery, shop.clock.stamp()
        hold = shop.holds.on(self._target, now.mono)
        if hold is not None:
            raise NotNow(f"{self._target} is {hold.words(now)}")
        if shop.holds.undecided(self._target, now.mono) is not None:
            raise NotNow(f"{self._target} is {BEING_STOPPED}")
        forbidden = shop.forbids(self._target, "restart")
        check_permitted(self._container, self._history, now.mono, forbidden=forbidden, settings=settings)

    def _as_asked(self, asked: FaultCase) -> float:
        """As `_perform`; 0 also when it was refused. Decided again each time: the autopilot may have been armed since, or
        another action may have used the budget up."""
        try:
            self._permit()
            void = self._approvals.void(asked, "restart")
            if void:
                raise NotNow(f"{self._target} is not restarted: {void}")
        except (NotAllowed, NotNow) as error:
            self._publish(asked.fault, "restart", Phase.REFUSED, str(error))
            self._asked = None
            return 0
        wait_s = self._perform(FaultCase(asked.fault, asked.reported), Act("restart", 1))
        if wait_s == 0:
            self._asked = None
        return wait_s

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
        cases = self._current()
        waits = [LIFE_S] if self._around.update(cases) else []
        if self._asked is not None:
            wait_s = self._as_asked(self._asked)
            if wait_s == 0:
                return 0
            waits.append(wait_s)
        for case in cases:
            waits += self._check_approval(case)
            if case.refused:
                continue
            self._around.note_hold(case)
            recheck_from = self._around.unchecked_since(case)
            if recheck_from is not None:
                waits.append(self._wait_for_proof(case.fault.unit, recheck_from))
                continue
            case.recheck_from = None
            decision = self._decide(case.fault, approved=case.approval is not None)
            if isinstance(decision, Act):
                if decision.action not in self._shop.unrestricted_actions and self._around.generation_changed(case):
                    return 0  # judged by what is found in this life
                wait_s = self._perform(case, decision)
                if wait_s == 0:
                    return 0
                waits.append(wait_s)  # nothing was done: other faults must not wait for that
                continue
            again = self._say(case, decision)
            if again is not None:
                waits.append(max(POLL_S, again - self._shop.clock.mono()))
        return self._keep_starting(waits)

    def _keep_starting(self, waits: list[float]) -> float | None:
        """A container that is down is worth a start now and then, also when recovery has given up on it. As `_next`."""
        down = self._around.left_down()
        self._left_down = {fault.id: self._left_down.get(fault.id, FaultCase(fault)) for fault in down}
        for fault in down:
            decision = self._decide(fault, approved=False, given_up=True)
            if isinstance(decision, Act):
                wait_s = self._perform(self._left_down[fault.id], decision)
                if wait_s == 0:
                    return 0
                waits.append(wait_s)
                continue
            again = decision.until if isinstance(decision, Wait) else getattr(decision, "again_at", None)
            if again is not None:
                waits.append(max(POLL_S, again - self._shop.clock.mono()))
        return min(waits, default=None)

    def _check_approval(self, case: FaultCase) -> list[float]:
        """When to look at its approval again, in seconds; empty: it has none, or it has just been found to be void."""
        if case.approval is None:
            return []
        decision = self._decide(case.fault, approved=True)
        return self._approvals.check(case, decision.action if isinstance(decision, Act) else "")

    def _current(self) -> list[FaultCase]:
        """The tracker knows first what is over and what is wrong now; its event may still be on its way through the bus."""
        return self._cases.current(self._shop.pipeline.open_faults)

    def _another_calls(self, case: FaultCase) -> bool:
        """Whether there is something to do on the container that is not this case's."""
        return any(
            isinstance(self._decide(other.fault, approved=other.approval is not None), Act)
            for other in self._current()
            if other.fault.id != case.fault.id and not other.refused and self._around.unchecked_since(other) is None
        )

    def _wait_for_proof(self, unit: str, recheck_from: float) -> float:
        now = self._shop.clock.mono()
        hold = self._shop.holds.on(self._target, now)
        if hold is not None:
            return hold.until - now  # until then its units are STALE, whatever their checks find
        left_s = recheck_from - now
        if left_s > 0:
            return min(left_s, PROOF_S)
        self._shop.pipeline.recheck(unit, *self._shop.pipeline.failing_dependents(unit, recheck_from))
        return PROOF_S

    def _decide(self, fault: Fault, *, approved: bool, given_up: bool = False) -> Decision:
        shop, now = self._shop, self._shop.clock.stamp()
        hold = shop.holds.on(self._target, now.mono)
        return decide(
            fault,
            self._history,
            now.mono,
            container=self._container,
            forbids=partial(shop.forbids, self._target),
            settings=shop.context.settings.recovery,
            unrestricted_actions=shop.unrestricted_actions,
            usable=shop.usable(self._container, fault),
            start_s=shop.context.settings.ros.grace,
            approved=approved,
            given_up=given_up,
            container_actions=shop.container_actions,
            starved=shop.pipeline.starved_by(fault.unit),
            hold=(hold.until, hold.words(now)) if hold is not None else None,
            undecided=shop.holds.undecided(self._target, now.mono, ended=fault.result.condition == ENDED),
            stopped_by_hand=shop.holds.stopped_by_hand(self._target),
        )

    def _say(self, case: FaultCase, decision: Decision) -> float | None:
        """Tell a decision that is not to act, once; when to look again, or None when only an event helps."""
        announced = announce(decision, self._target, self._container)
        if announced is not None:
            self._once(case, announced.action, announced.phase, announced.detail)
        if isinstance(decision, GiveUp):
            case.refused = True
            self._shop.pipeline.escalate(case.fault.id)
        if isinstance(decision, Wait):
            return decision.until
        return decision.again_at if isinstance(decision, Advise) else None

    def _once(self, case: FaultCase, action: str, phase: Phase, detail: str) -> None:
        said = f"{phase.value} {action}"
        if said not in case.reported:
            case.reported.add(said)
            self._publish(case.fault, action, phase, detail)

    # ------------------------------------------------------------ acting

    def _perform(self, case: FaultCase, act: Act) -> float:
        """Seconds to wait before the next look."""
        shop, fault = self._shop, case.fault
        kind = shop.actions.get(act.action)
        if kind is None or self._container is None:
            what = f"no installed package provides the action {act.action!r}: correct recovery.ladders"
            self._once(case, act.action, Phase.FAILED, what)
            case.refused = True
            return 0
        last = shop.is_last(self._container, fault, act.action)
        approved_at = case.approval.situation.armed if case.approval is not None else None
        repair = Repair(shop, self._container, fault, kind, last=last, approved_at=approved_at)
        missing = repair.waits_for()
        if missing:
            self._once(case, act.action, Phase.REFUSED, f"{self._target} is left alone for now: {missing}")
            return WAITS_S
        attempt = AttemptRecord(shop.clock.mono(), fault.unit, fault.result.condition, act.action, worked=False)
        if not repair.begin():
            return LOOK_AGAIN_S  # another container's repair restarts this one: decided afresh when that is over
        if act.action not in shop.unrestricted_actions and shop.holds.binds(self._target, shop.clock.mono()):
            repair.release(worked=False)  # put on hold, or stopped by hand, since the decision
            return LOOK_AGAIN_S
        case.approval, case.interrupted = None, False
        self._under_way = UnfinishedAction(fault.id, attempt)
        worked, life = False, shop.lives.look(self._target)
        try:
            tell = partial(self._publish, fault, act.action, attempt=act.attempt)
            verdict = repair.run(tell, lambda: self._stopping, lambda: self._another_calls(case))
            if self._stopping and not verdict.worked:
                return 0  # cut short by the end of PHM: the state file still says that it was under way
            worked = verdict.worked or verdict.undecided
            case.refused = verdict.refused
            self._around.attempted(self._current(), case, life, superseded=verdict.superseded)
            done = replace(attempt, worked=verdict.worked, not_counted=verdict.not_counted, partly=verdict.partly)
            self._end(None if verdict.postponed else done)
            tell(verdict.phase, verdict.detail)
        finally:
            if self._under_way is not None and not self._stopping:
                self._end(attempt)
            repair.release(worked=worked)
        return 0

    def _end(self, attempt: AttemptRecord | None) -> None:
        """Counted before it is published: no attempt is lost when PHM is killed in between. None: nothing was tried."""
        if attempt is not None:
            self._history.add(attempt)
        self._under_way = None

    def _publish(self, fault: Fault, action: str, phase: Phase, detail: str, attempt: int = 1) -> None:
        stamp = self._shop.clock.stamp()
        self._shop.publish(ActionEvent(stamp, fault.id, fault.unit, action, self._target, phase, detail, attempt))
