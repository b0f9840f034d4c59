"""A restart that an operator asks for: bound by opt-in, arming and budget like any other. Pure."""

from __future__ import annotations

from phm.core.model import Fault, Level, Result, Stamp, UnitState
from phm.core.settings import ContainerSettings, RecoverySettings
from phm.recovery.history import History

CONDITION = "asked"


class NotAllowed(Exception):
    """It is not done, whenever it is asked; the message says why."""


class NotNow(Exception):
    """It is not done now and may be later; the message says why."""


def check_permitted(
    container: ContainerSettings | None, history: History, now: float, *, forbidden: str, settings: RecoverySettings
) -> None:
    """Raises NotAllowed and NotNow. Mode `advise` does not bind: the operator has decided. Nor does back-off.

    forbidden: why the container must not be restarted while the vehicle may be armed; empty: it may.
    """
    if container is None:
        raise NotAllowed("there is no such container in the configuration")
    if settings.mode == "off":
        raise NotAllowed("recovery is off")
    if not container.recover:
        raise NotAllowed(f"{container.key} has not opted in (recover: true)")
    if forbidden:
        raise NotNow(f"{container.key} is not restarted: {forbidden}")
    recent = history.within(now - settings.window)
    if len(recent) >= settings.budget:
        left_s = recent[0].at + settings.window - now
        raise NotNow(f"the budget of {settings.budget} actions on {container.key} is used up for {left_s:.0f} s")


def request_as_fault(state: UnitState, target: str, by: str, now: Stamp) -> Fault:
    """What the restart is done for, in the form that a repair takes: no fault is open, so it has no id."""
    result = Result(Level.ERROR, f"asked for by {by}", "restart asked", CONDITION, target)
    return Fault("", state.unit, state.slot, state.layer, result, now)
