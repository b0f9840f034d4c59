"""A restart that an operator requests: limited by opt-in, holds, armed state and budget like any other action."""

from __future__ import annotations

import threading

from phm.checking.pipeline import Pipeline
from phm.core.clock import Clock
from phm.core.model import Fault, Level, Phase, Result, Stamp, UnitState
from phm.core.settings import RecoverySettings
from phm.recovery.fault_cases import FaultCase
from phm.recovery.history import History
from phm.recovery.operator.announcements import ActionReporter
from phm.recovery.operator.approvals import Approvals
from phm.recovery.operator.refusals import NotAllowed, NotNow
from phm.recovery.safety.action_limits import ActionLimits
from phm.recovery.target import Target

CONDITION = "restart_requested"
RESTART = "restart"


class ManualRestart:
    """Restarts of one target that an operator requests. `request` may be called by any thread, the rest by the worker's."""

    def __init__(
        self,
        target: Target,
        history: History,
        settings: RecoverySettings,
        limits: ActionLimits,
        approvals: Approvals,
        reporter: ActionReporter,
        pipeline: Pipeline,
        clock: Clock,
    ) -> None:
        self._target, self._history, self._settings, self._limits = target, history, settings, limits
        self._approvals, self._reporter, self._pipeline, self._clock = approvals, reporter, pipeline, clock
        self._case: FaultCase | None = None
        self._lock = threading.Lock()

    @property
    def pending(self) -> bool:
        """Whether a restart has been requested and has not ended."""
        return self._case is not None

    def request(self, by: str, *, busy: bool) -> str:
        """Request a restart; what will be done. busy: an action is under way.

        Raises NotAllowed, and NotNow when it may be possible later.
        """
        self._check_limits()
        name = self._target.name
        unit = f"container/{name}"
        state = next((state for state in self._pipeline.states() if state.unit == unit), None)
        if state is None:
            raise NotAllowed(f"the check of {unit} is off: the restart could not be verified")
        with self._lock:
            if self._case is not None or busy:
                raise NotNow(f"another action on {name} is under way")
            fault = request_as_fault(state, name, by, self._clock.stamp())
            self._case = FaultCase(fault, approval=self._approvals.grant(RESTART))
        return f"restart {name}, requested by {by}"

    def next(self) -> FaultCase | None:
        """The case to restart for; None when the request was refused. Checked again each time: the autopilot may have been armed
        since, or another action may have used up the budget."""
        case = self._case
        if case is None:
            return None
        try:
            self._check_limits()
            void = self._approvals.void(case, RESTART)
            if void:
                raise NotNow(f"{self._target.name} is not restarted: {void}")
        except (NotAllowed, NotNow) as error:
            self._reporter.report(case.fault, RESTART, Phase.REFUSED, str(error))
            self._case = None
            return None
        return FaultCase(case.fault, case.reported)

    def end(self) -> None:
        """Forget the request, because the restart was tried."""
        self._case = None

    def _check_limits(self) -> None:
        why = self._limits.why_on_hold()
        if why:
            raise NotNow(f"{self._target.name} is {why}")
        check_permitted(
            self._target,
            self._history,
            self._clock.mono(),
            forbidden=self._limits.forbids(RESTART),
            settings=self._settings,
        )


def check_permitted(
    target: Target, history: History, now: float, *, forbidden: str, settings: RecoverySettings
) -> None:
    """Raises NotAllowed and NotNow. Neither mode `advise` nor back-off apply: the operator has decided. Pure.

    forbidden: why the container must not be restarted while the vehicle may be armed; empty: it may.
    """
    if target.container is None:
        raise NotAllowed("there is no such container in the configuration")
    if settings.mode == "off":
        raise NotAllowed("recovery is off")
    if not target.opted_in:
        raise NotAllowed(f"{target.key} has not opted in (recover: true)")
    if forbidden:
        raise NotNow(f"{target.key} is not restarted: {forbidden}")
    recent = history.within(now - settings.window)
    if len(recent) >= settings.budget:
        left_s = recent[0].at + settings.window - now
        raise NotNow(f"the budget of {settings.budget} actions on {target.key} is used up for {left_s:.0f} s")


def request_as_fault(state: UnitState, target: str, by: str, now: Stamp) -> Fault:
    """What the restart is done for, in the form that an attempt takes: no fault is open, so it has no id."""
    result = Result(Level.ERROR, f"requested by {by}", "restart requested", CONDITION, target)
    return Fault("", state.unit, state.slot, state.layer, result, now)
