"""Passes each fault to the worker of its target (`phm.recovery.worker`), and restores the state of an earlier run of PHM."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from phm.checking.pipeline import Pipeline
from phm.core.clock import Clock
from phm.core.model import Event, Fault, FaultClosed, FaultOpened, Level, Outcome, Transition
from phm.recovery.attempt import Attempt
from phm.recovery.base import Action, ActionCatalog, ActionContext, Target, TargetKind
from phm.recovery.fault_cases import History, PersistedCase
from phm.recovery.holds.hold_registry import HoldRegistry
from phm.recovery.operator.approval import NotAllowed, NotApprovable, NotNow
from phm.recovery.ownership import GenerationTracker, Shared, TargetLocks
from phm.recovery.persistence.state import PersistedState, RecoveryState
from phm.recovery.policy import ActionRules
from phm.recovery.safety.armed_state import ArmedStatus
from phm.recovery.safety.flight_critical import FlightCriticalGuard, critical_containers
from phm.recovery.worker import TargetWorker

__all__ = ["Executor", "NotAllowed", "NotApprovable", "NotNow"]


def _no_dependents(unit: str) -> Mapping[str, frozenset[str]]:
    return {}


class Executor:
    """A fault without a target is only reported.

    armed:   the armed state of the vehicle now.
    grace_s: of a unit, seconds.
    below:   units that need a unit and are other targets', by target (`phm.checking.plan.CheckPlan.below`).
    """

    kinds = (FaultOpened, FaultClosed, Transition)

    def __init__(
        self,
        pipeline: Pipeline,
        publish: Callable[[Event], None],
        clock: Clock,
        actions: Mapping[str, type[Action]],
        context: ActionContext,
        armed: Callable[[], ArmedStatus],
        grace_s: Callable[[str], float],
        below: Callable[[str], Mapping[str, frozenset[str]]] = _no_dependents,
        holds: HoldRegistry | None = None,
    ) -> None:
        self._pipeline, self._publish, self._clock, self._context = pipeline, publish, clock, context
        self._below = below
        settings = context.settings
        self._containers, self._verify_s = settings.containers, settings.recovery.verify
        self.holds = holds if holds is not None else HoldRegistry()
        self.catalog = ActionCatalog(actions, settings)
        self.locks = TargetLocks(pipeline, clock)
        self._generations = GenerationTracker(context.container, clock, self._verify_s)
        guard = None
        if critical_containers(self._containers):
            guard = FlightCriticalGuard(
                self._containers, context.container, context.own_container, armed, context.engine.inspect
            )
        self._shared = Shared(pipeline, clock, self.locks, self._generations, grace_s)
        self._rules = ActionRules(settings.recovery, settings.start_s, self.catalog, self.holds, armed, guard)
        self._new_attempt = partial(
            _new_attempt,
            context=replace(context, armed=armed),
            shared=self._shared,
            guard=guard,
            verify_s=self._verify_s,
        )
        self._workers: dict[str, TargetWorker] = {}
        self._histories: dict[str, History] = {}
        self._given_up: dict[str, Fault] = {}
        self._lock = threading.Lock()
        self._stopping = False
        self.holds.changed = self._wake_all
        self._generations.on_unanswered = self._observe

    @staticmethod
    def key(event: Event) -> tuple[str, str]:
        """For the bus: the newest fault event and the newest transition of each unit are kept."""
        if isinstance(event, (FaultOpened, FaultClosed)):
            return ("fault", event.fault.unit)
        return ("transition", event.unit) if isinstance(event, Transition) else ("other", "")

    def handle(self, event: Event) -> None:
        """Take an event from the bus."""
        if self._stopping:
            return
        if isinstance(event, FaultClosed):
            self._closed(event.fault)
        elif isinstance(event, FaultOpened):
            self._opened(event.fault)
        elif isinstance(event, Transition) and event.new is Level.ERROR and event.state.fault:
            self._changed(event)
        elif isinstance(event, Transition) and event.state.result.ends_fault:
            fault = self._given_up.pop(event.unit, None)
            if fault is not None:
                self._recovered(fault)

    def _closed(self, fault: Fault) -> None:
        worker = self._workers.get(fault.result.target)
        if worker is not None:
            worker.closed(fault)
        if fault.outcome is Outcome.ESCALATED:
            self._given_up[fault.unit] = fault
        elif fault.outcome is Outcome.RESOLVED:
            self._recovered(fault)

    def _opened(self, fault: Fault) -> None:
        if fault.result.target:
            self._worker(fault.result.target).opened(fault)

    def _changed(self, event: Transition) -> None:
        """The same fault may have another condition now (exited, then dead), and with it another ladder or target."""
        for fault in self._pipeline.open_faults():
            if fault.id == event.state.fault:
                self._opened(fault)

    def _recovered(self, fault: Fault) -> None:
        """Inform the targets that need what has recovered; the verification of one attempt reaches that far back."""
        down_from = fault.opened.mono - self._verify_s
        for target, units in self._below(fault.unit).items():
            if target in self._histories:
                self._worker(target).dependency_recovered(units, down_from)

    def _wake_all(self) -> None:
        with self._lock:
            workers = tuple(self._workers.values())
        for worker in workers:
            worker.wake()

    def _observe(self, container: str) -> None:
        """Have its worker observe a container that the engine may still start for PHM."""
        if not self._stopping:
            self._worker(container).wake()

    def _worker(self, name: str) -> TargetWorker:
        with self._lock:
            worker = self._workers.get(name)
            if worker is None:
                target = Target.parse(name, self._containers)
                history = self._histories.setdefault(name, History())
                worker = self._workers[name] = TargetWorker(
                    target, history, self._shared, self._rules, self._new_attempt, self._publish
                )
                if self._stopping:
                    worker.stop()
            return worker

    # ------------------------------------------------------------ over a restart of PHM

    def restore(self, state: PersistedState) -> tuple[str, ...]:
        """Take over attempts and open faults; call before the first event. Returns sentences about interrupted actions.

        Such an action counts as an attempt that did not help. PHM decides again what to do once a new result
        has confirmed the fault.
        """
        recovery = state.recovery
        for target, attempts in recovery.attempts.items():
            self._histories[target] = History(list(attempts))
        notes = []
        for target, interrupted in recovery.under_way.items():
            self._histories.setdefault(target, History()).add(interrupted.attempt)
            what = f"{interrupted.attempt.action} {target} for {interrupted.attempt.unit} ({interrupted.fault})"
            notes.append(f"{what} was interrupted when PHM stopped: it counts as an attempt and is repeated if needed")
        self._restore_generations(recovery)
        if self._context.relief is not None:
            self._context.relief.restore(recovery.lowered)
        armed = recovery.armed is not None and recovery.armed.armed
        self.holds.restore(recovery.holds, recovery.stops, recovery.windows, armed=armed)
        for fault in self._pipeline.given_up():
            self._given_up[fault.unit] = fault
            if fault.result.target:
                self._worker(fault.result.target)  # it detects when something else starts the container
        for fault in self._pipeline.open_faults():
            if fault.result.target:
                self._restore_fault(fault, recovery)
        for container in self._generations.unfinished():
            self._observe(container)
        return tuple(notes)

    def _restore_generations(self, recovery: RecoveryState) -> None:
        self._generations.restore(recovery.generations)
        cut_off = {name: cut for name, cut in recovery.under_way.items() if not cut.returned}
        starts = {name for name, cut in cut_off.items() if self.catalog.may_start(cut.attempt.action)}
        for key, who in {**recovery.unfinished, **{name: name for name in starts}}.items():
            self._generations.add_unfinished(key, who)

    def _restore_fault(self, fault: Fault, recovery: RecoveryState) -> None:
        target, case = fault.result.target, recovery.cases.get(fault.id, PersistedCase())
        action = recovery.under_way.get(target)
        interrupted = action if action is not None and action.fault == fault.id else None
        self._worker(target).restored(fault, case, interrupted)

    def persisted(self) -> RecoveryState:
        """What is to survive a restart of PHM; any thread may ask."""
        with self._lock:
            workers, histories = dict(self._workers), dict(self._histories)
        cases: dict[str, PersistedCase] = {}
        under_way = {}
        attempts = {target: tuple(history.attempts) for target, history in histories.items() if history.attempts}
        for target, worker in workers.items():
            reported, action = worker.persisted()
            cases.update(reported)
            if action is not None:
                under_way[target] = action
        relief = self._context.relief
        return RecoveryState(
            attempts,
            cases,
            under_way,
            self._generations.snapshot(),
            unfinished=self._generations.unfinished(),
            lowered=relief.kept() if relief is not None else (),
            holds=self.holds.kept(self._clock.mono()),
            stops=self.holds.stops(),
            windows=self.holds.done(),
        )

    def in_progress(self) -> dict[str, str]:
        """The action by target that is under way, or that an operator has requested without a fault; any thread may ask."""
        with self._lock:
            workers = dict(self._workers)
        return {target: action for target, worker in workers.items() if (action := worker.in_progress())}

    # ------------------------------------------------------------ requests of an operator

    def approve(self, fault_id: str) -> str:
        """An operator approves what is advised for an open fault. Returns what will be done.

        Raises NotApprovable, and NotNow when it may be possible later.
        """
        faults = self._pipeline.open_faults()
        fault = next((fault for fault in faults if fault.id == fault_id), None)
        if fault is None:
            raise NotApprovable(f"there is no open fault {fault_id}; open: {_listed(faults)}")
        worker = self._workers.get(fault.result.target)
        if worker is None:
            raise NotApprovable(f"{fault_id} ({fault.unit}) is only reported: there is no container to act on")
        return worker.approve(fault_id)

    def restart(self, container: str, by: str) -> str:
        """An operator requests a restart of a container. Returns what will be done. Raises NotAllowed, and NotNow when it may be
        possible later."""
        target = Target.parse(container, self._containers)
        if target.kind is not TargetKind.CONTAINER or not target.configured:
            raise NotAllowed(f"there is no container {container!r} in the configuration")
        if self._stopping:
            raise NotNow("PHM is being stopped")
        return self._worker(container).restart(by)

    def action_on(self, target: str) -> bool:
        """Whether PHM may be ending or starting it: an action has requested that, or such a call got no answer."""
        return self._generations.disturbed(target)

    def stop(self) -> None:
        """Have all workers begin nothing more."""
        with self._lock:
            self._stopping, workers = True, tuple(self._workers.values())
        for worker in workers:
            worker.stop()


def _new_attempt(*args: Any, context: ActionContext, alone: bool = False, **more: Any) -> Attempt:
    """alone: as of `ActionContext`."""
    return Attempt(*args, context=replace(context, alone=alone), **more)


def _listed(faults: Iterable[Fault]) -> str:
    return ", ".join(f"{fault.id} ({fault.unit})" for fault in faults) or "none"
