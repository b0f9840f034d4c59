"""Carries out what the policy decides, one action at a time per container, and proves that it helped.

A fault is healed only when its own check has said OK in a run that began after the action. Until then
the tracker holds the target: what breaks because of the repair is no fault of its own. Each container
has its own thread, so that a container that cannot be stopped keeps nobody else from being healed.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from phm.clock import Clock
from phm.facts import CannotTell, NotPermitted
from phm.model import ActionEvent, Event, Fault, FaultClosed, FaultOpened, Phase, Transition
from phm.pipeline import Pipeline
from phm.recovery.base import Action, ActionContext, ActionFailed
from phm.recovery.policy import Act, Advise, Attempt, Decision, GiveUp, History, Wait, decide
from phm.settings import ContainerSettings

logger = logging.getLogger(__name__)

POLL_S = 0.05
LOOK_AGAIN_S = 1.0
STILL_BAD_S = 2.0
"""A run that began this long after the action (beyond the unit's grace) and is still ERROR ends the wait."""


@dataclass(frozen=True)
class Shop:
    """What all targets share: the tools of the executor."""

    pipeline: Pipeline
    publish: Callable[[Event], None]
    clock: Clock
    actions: Mapping[str, type[Action]]
    context: ActionContext
    armed: Callable[[], bool]
    grace_s: Callable[[str], float]

    @property
    def free_actions(self) -> frozenset[str]:
        return frozenset(name for name, action in self.actions.items() if action.on_myself)


@dataclass(slots=True)
class _Case:
    """An open fault in the hands of its target's thread. `told` remembers what was said, to say it once."""

    fault: Fault
    told: set[str] = field(default_factory=set)
    refused: bool = False


class TargetWorker:
    """The thread of one container. Invariant: at most one action on the container at any time."""

    def __init__(self, target: str, container: ContainerSettings | None, shop: Shop) -> None:
        self._target, self._container, self._shop = target, container, shop
        self._history = History()
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
            self._cases.pop(fault.unit, None)
        self._wake.set()

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
        with self._lock:
            cases = sorted(self._cases.values(), key=lambda case: case.fault.slot)
        waits: list[float] = []
        for case in cases:
            if case.refused:
                continue
            decision = self._decide(case.fault)
            if isinstance(decision, Act):
                self._perform(case, decision)
                return 0
            again = self._say(case, decision)
            if again is not None:
                waits.append(max(POLL_S, again - self._shop.clock.mono()))
        return min(waits, default=None)

    def _decide(self, fault: Fault) -> Decision:
        shop = self._shop
        return decide(
            fault,
            self._history,
            shop.clock.mono(),
            container=self._container,
            armed=shop.armed(),
            settings=shop.context.settings.recovery,
            free_actions=shop.free_actions,
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
        shop.pipeline.hold(self._target, fault.unit, act.action, action_class.deadline_s + verify_s + 5.0)
        worked = False
        try:
            self._publish(
                fault,
                act.action,
                Phase.STARTED,
                f"{act.action} {self._target} for: {fault.result.summary}",
                act.attempt,
            )
            detail, worked = self._run(case, action_class(), act)
            if worked:
                done = shop.clock.mono()
                self._publish(fault, act.action, Phase.DONE, detail, act.attempt)
                worked = self._verify(fault, done, verify_s)
                if worked:
                    took = shop.clock.mono() - began
                    self._publish(
                        fault,
                        act.action,
                        Phase.VERIFIED,
                        f"{fault.unit} is OK again {took:.1f} s after the action began",
                        act.attempt,
                    )
                else:
                    self._publish(
                        fault,
                        act.action,
                        Phase.FAILED,
                        f"{act.action} of {self._target} did not bring {fault.unit} back",
                        act.attempt,
                    )
            else:
                self._publish(fault, act.action, Phase.FAILED, detail, act.attempt)
        finally:
            self._history.add(Attempt(began, fault.unit, fault.result.condition, act.action, worked))
            shop.pipeline.release(self._target, worked=worked)

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

    def _verify(self, fault: Fault, done: float, verify_s: float) -> bool:
        """True as soon as a run that began after `done` says OK; False after `verify_s` or when still bad."""
        shop = self._shop
        late = done + shop.grace_s(fault.unit) + STILL_BAD_S
        asked = float("-inf")
        while not self._stopping:
            now = shop.clock.mono()
            if shop.pipeline.well_since(fault.unit, done):
                return True
            if now - done > verify_s or shop.pipeline.bad_since(fault.unit, late):
                return False
            if now - asked >= LOOK_AGAIN_S:
                asked = now
                shop.pipeline.look_again(fault.unit)
            shop.clock.wait(threading.Event(), POLL_S)
        return False

    def _publish(self, fault: Fault, action: str, phase: Phase, detail: str, attempt: int = 1) -> None:
        stamp = self._shop.clock.stamp()
        self._shop.publish(ActionEvent(stamp, fault.id, fault.unit, action, self._target, phase, detail, attempt))


class Executor:
    """Hands faults to the thread of their target. A fault without a target is only reported."""

    kinds = (FaultOpened, FaultClosed, Transition)

    def __init__(self, shop: Shop) -> None:
        self._shop = shop
        self._workers: dict[str, TargetWorker] = {}

    @staticmethod
    def key(event: Event) -> tuple[str, str]:
        """For the bus: the newest fault event and the newest transition of each unit are kept."""
        if isinstance(event, (FaultOpened, FaultClosed)):
            return ("fault", event.fault.unit)
        return ("transition", event.unit) if isinstance(event, Transition) else ("other", "")

    def handle(self, event: Event) -> None:
        if isinstance(event, FaultClosed):
            worker = self._workers.get(event.fault.result.target)
            if worker is not None:
                worker.closed(event.fault)
        elif isinstance(event, FaultOpened):
            self._give(event.fault)
        elif isinstance(event, Transition) and event.changed_text and event.state.fault:
            self._reworded(event)

    def _reworded(self, event: Transition) -> None:
        """The same fault now stands for something else (exited, then dead): the ladder may be another."""
        for fault in self._shop.pipeline.open_faults():
            if fault.id == event.state.fault:
                self._give(fault)

    def _give(self, fault: Fault) -> None:
        target = fault.result.target
        if not target:
            return
        worker = self._workers.get(target)
        if worker is None:
            container = self._shop.context.settings.container(target)
            worker = self._workers[target] = TargetWorker(target, container, self._shop)
        worker.opened(fault)

    def stop(self) -> None:
        for worker in self._workers.values():
            worker.stop()
