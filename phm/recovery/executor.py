"""Hands each fault to the thread of its container (`phm.recovery.worker`), and gives back what an earlier PHM knew."""

from __future__ import annotations

import threading
from collections.abc import Iterable

from phm.core.model import Event, Fault, FaultClosed, FaultOpened, Level, Outcome, Transition
from phm.recovery import disks, links
from phm.recovery.history import History
from phm.recovery.operator.manual_restart import NotAllowed, NotNow
from phm.recovery.persistence.state import PersistedCase, PersistedState, RecoveryState
from phm.recovery.shop import Shop
from phm.recovery.worker import NotApprovable, TargetWorker

__all__ = ["Executor", "NotAllowed", "NotApprovable", "NotNow", "Shop"]


class Executor:
    """Hands faults to the thread of their target. A fault without a target is only reported."""

    kinds = (FaultOpened, FaultClosed, Transition)

    def __init__(self, shop: Shop) -> None:
        self._shop = shop
        self._workers: dict[str, TargetWorker] = {}
        self._histories: dict[str, History] = {}
        self._given_up: dict[str, Fault] = {}
        self._lock = threading.Lock()
        shop.holds.changed = self._wake_all

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
            if event.fault.outcome is Outcome.ESCALATED:
                self._given_up[event.fault.unit] = event.fault
            elif event.fault.outcome is Outcome.RESOLVED:
                self._recovered(event.fault)
        elif isinstance(event, FaultOpened):
            self._give(event.fault)
        elif isinstance(event, Transition) and event.changed_text and event.state.fault:
            self._reworded(event)
        elif isinstance(event, Transition) and event.new is Level.OK:
            fault = self._given_up.pop(event.unit, None)
            if fault is not None:
                self._recovered(fault)

    def _wake_all(self) -> None:
        with self._lock:
            workers = tuple(self._workers.values())
        for worker in workers:
            worker.wake()

    def _recovered(self, fault: Fault) -> None:
        """What is well again may be what others waited for, who are told so; one attempt's proof reaches that far back."""
        down_from = fault.opened.mono - self._shop.context.settings.recovery.verify
        for target, units in self._shop.below(fault.unit).items():
            if target in self._histories:
                self._worker(target).dependency_recovered(units, down_from)

    def _reworded(self, event: Transition) -> None:
        """The same fault now stands for something else (exited, then dead): the ladder may be another."""
        for fault in self._shop.pipeline.open_faults():
            if fault.id == event.state.fault:
                self._give(fault)

    def _give(self, fault: Fault) -> None:
        if fault.result.target:
            self._worker(fault.result.target).opened(fault)

    def _worker(self, target: str) -> TargetWorker:
        with self._lock:
            worker = self._workers.get(target)
            if worker is None:
                container = (
                    self._shop.context.settings.container(target)
                    or links.as_container(target)
                    or disks.as_container(target)
                )
                history = self._histories.setdefault(target, History())
                worker = self._workers[target] = TargetWorker(target, container, self._shop, history)
            return worker

    # ------------------------------------------------------------ over a restart of PHM

    def restore(self, state: PersistedState) -> tuple[str, ...]:
        """Take over attempts and open faults, before the first event; sentences about actions that were cut short.

        Such an action counts as an attempt that did not help; what to do is decided afresh, once a fresh
        result has said that the fault is still there.
        """
        for target, attempts in state.recovery.attempts.items():
            self._histories[target] = History(list(attempts))
        notes = []
        for target, cut in state.recovery.under_way.items():
            self._histories.setdefault(target, History()).add(cut.attempt)
            what = f"{cut.attempt.action} of {target} for {cut.attempt.unit} ({cut.fault})"
            notes.append(
                f"{what} was cut short when PHM ended: it counts as an attempt and is taken up again if needed"
            )
        self._shop.lives.restore(state.recovery.generations)
        interrupted = {target for target, cut in state.recovery.under_way.items() if self._starts(cut.attempt.action)}
        for key, who in {**state.recovery.unfinished, **{target: target for target in interrupted}}.items():
            self._shop.lives.unfinished(key, who)
        if self._shop.context.relief is not None:
            self._shop.context.relief.restore(state.recovery.lowered)
        last = state.recovery.armed
        self._shop.holds.restore(
            state.recovery.holds, state.recovery.stops, state.recovery.windows, armed=last is not None and last.armed
        )
        for fault in self._shop.pipeline.given_up():
            self._given_up[fault.unit] = fault
            if fault.result.target:
                self._worker(fault.result.target)  # which sees whether somebody else begins anew
        for fault in self._shop.pipeline.open_faults():
            if fault.result.target:
                target, case = fault.result.target, state.recovery.cases.get(fault.id, PersistedCase())
                action = state.recovery.under_way.get(target)
                mine = action if action is not None and action.fault == fault.id else None
                self._worker(target).restored(fault, case, mine)
        return tuple(notes)

    def _starts(self, action: str) -> bool:
        """Whether it may start its container again; True also for one that is no longer installed."""
        kind = self._shop.actions.get(action)
        return kind is None or kind.starts

    def kept(self) -> RecoveryState:
        """What is to survive PHM; any thread may ask."""
        with self._lock:
            workers, histories = dict(self._workers), dict(self._histories)
        cases: dict[str, PersistedCase] = {}
        under_way = {}
        attempts = {target: tuple(history.attempts) for target, history in histories.items()}
        for target, worker in workers.items():
            said, action = worker.kept()
            cases.update(said)
            if action is not None:
                under_way[target] = action
        made = {target: tried for target, tried in attempts.items() if tried}
        lives, holds = self._shop.lives, self._shop.holds
        return RecoveryState(
            made,
            cases,
            under_way,
            lives.kept(),
            unfinished=lives.unfinished_now(),
            lowered=self._shop.context.relief.kept() if self._shop.context.relief is not None else (),
            holds=holds.kept(self._shop.clock.mono()),
            stops=holds.stops(),
            windows=holds.done(),
        )

    # ------------------------------------------------------------ the operator's hand

    def approve(self, fault_id: str) -> str:
        """An operator approves what is advised for an open fault; what will be done.

        Raises NotApprovable, and NotNow when it may be later.
        """
        faults = self._shop.pipeline.open_faults()
        fault = next((fault for fault in faults if fault.id == fault_id), None)
        if fault is None:
            raise NotApprovable(f"there is no open fault {fault_id}; open: {_listed(faults)}")
        worker = self._workers.get(fault.result.target)
        if worker is None:
            raise NotApprovable(f"{fault_id} ({fault.unit}) is only reported: no container can be acted on for it")
        return worker.approve(fault_id)

    def action_on(self, target: str) -> bool:
        """Whether what the engine does to it may be PHM's doing: an action at work, or a call without an answer."""
        return target in self._shop.lives.unfinished_now()

    def restart(self, target: str, by: str) -> str:
        """An operator wants a container restarted; what will be done. Raises NotAllowed, and NotNow when it may be later."""
        if self._shop.context.settings.container(target) is None:
            raise NotAllowed(f"there is no container {target!r} in the configuration")
        return self._worker(target).restart(by)

    def stop(self) -> None:
        for worker in self._workers.values():
            worker.stop()


def _listed(faults: Iterable[Fault]) -> str:
    return ", ".join(f"{fault.id} ({fault.unit})" for fault in faults) or "none"
