"""Proves that an action has helped: by runs of the checks that began after it, of the unit and of all that needs it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from phm.model import Fault
from phm.recovery.lives import ENGINE, Life, by_phm
from phm.recovery.shop import Shop

POLL_S = 0.05
LOOK_AGAIN_S = 0.5
STILL_BAD_S = 2.0
"""A run that began this long after the action (beyond the unit's grace) and is still ERROR ends the wait."""


@dataclass(frozen=True, slots=True)
class Proof:
    """How it ended. Proven when both are empty.

    missing:   the first unit that has not come back.
    overtaken: who has started the container again meanwhile, in words; what was found then says little about the action.
    excused:   it was PHM itself, for another container's sake: nobody is to blame for what was found then.
    """

    missing: str = ""
    overtaken: str = ""
    excused: bool = False


def prove(shop: Shop, fault: Fault, target: str, proof_s: float, stopping: Callable[[], bool]) -> Proof:
    """Wait until runs that begin from now on have found the unit and all that needs it well.

    The unit itself gets `recovery.verify`, less when it is surely still bad; what needs it gets its grace. `proof_s` is
    the action's own (`phm.recovery.base.Action`). A life of the container that is not this action's doing ends the wait.
    """
    done = shop.clock.mono()
    verify_s = shop.context.settings.recovery.verify
    late = done + shop.grace_s(fault.unit) + STILL_BAD_S
    mine = shop.lives.look(target)
    asked = float("-inf")
    waiting: tuple[str, ...] = (fault.unit,)
    while not stopping():
        now = shop.clock.mono()
        if now - asked >= LOOK_AGAIN_S:
            asked = now
            overtaken = _overtaken(shop.lives.look(target), mine, target)
            if overtaken is not None:
                return overtaken
            shop.pipeline.look_again(fault.unit, *waiting)
        if shop.pipeline.well_since(fault.unit, done):
            waiting = shop.pipeline.suffering(fault.unit, done + proof_s)
            if not waiting and shop.pipeline.well_since(fault.unit, done + proof_s):
                return Proof()
            waiting = waiting or (fault.unit,)
            if now - done > max(shop.grace_s(name) for name in waiting) + STILL_BAD_S + proof_s:
                return Proof(missing=waiting[0])
        elif now - done > verify_s or shop.pipeline.bad_since(fault.unit, late):
            return Proof(missing=fault.unit)
        shop.clock.wait(threading.Event(), POLL_S)
    return Proof(missing=fault.unit)


def _overtaken(now: Life | None, mine: Life | None, target: str) -> Proof | None:
    """The engine's own restart policy overtakes nobody: whether the container is well then is what is to be proven."""
    if now is None or mine is None or now.same(mine) or now.by in (ENGINE, by_phm(target)):
        return None
    whose = now.whose
    return Proof(overtaken=f"the repair of {whose}" if whose else "somebody else", excused=bool(whose))
