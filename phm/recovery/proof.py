"""Proves that an action has helped: by runs of the checks that began after it, of the unit and of all that needs it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from phm.model import Fault, Level, Result
from phm.recovery.base import Action
from phm.recovery.lives import ENGINE, Life, by_phm
from phm.recovery.policy import OUTSIDE
from phm.recovery.shop import Shop
from phm.tracker.starvation import explained

POLL_S = 0.05
LOOK_AGAIN_S = 0.5
STILL_BAD_S = 2.0
"""A run that began this long after the action (beyond the unit's grace) and is still ERROR ends the wait."""


class Seen(Protocol):
    """What runs have found; `phm.pipeline.Pipeline` is one."""

    def well_since(self, unit: str, mono: float) -> bool: ...

    def suffering(self, unit: str, mono: float) -> tuple[str, ...]: ...

    def newest(self, unit: str, mono: float) -> Result | None: ...

    def starving(self, unit: str) -> str: ...


@dataclass(frozen=True, slots=True)
class Proof:
    """How it ended. Proven when both are empty.

    missing:   the first unit that has not come back.
    overtaken: who has started the container again meanwhile, in words; what was found then says little about the action.
    excused:   PHM itself has started it, for another container, or what is missing now is outside of every container, or the
               unit was starved meanwhile: the action is not to blame.
    partly:    the unit itself is OK; what is missing is something that needs it.
    undecided: only time can show whether the unit is OK (`Result.decides_s`): the action has neither helped nor failed.
    """

    missing: str = ""
    overtaken: str = ""
    excused: bool = False
    partly: bool = False
    undecided: bool = False


@dataclass(slots=True)
class Proving:
    """The proof of one action that was over at `done` (monotonic seconds). Pure.

    The unit itself gets `verify_s`, less when it is surely still bad, more while its check says that only time can tell
    (a HEALTHCHECK that is `starting`); what needs it gets its grace. Runs count that began `proof_s` after the action, which is
    the action's own, as are `shows_s` and `follow_s` (`phm.recovery.base.Action`).
    """

    unit: str
    done: float
    proof_s: float
    verify_s: float
    grace_s: Callable[[str], float]
    shows_s: float | None = None
    follow_s: float | None = None
    waiting: tuple[str, ...] = ()
    """Units that have not come back."""
    starved: bool = False
    """It was short of the processor, memory or the disk at some time since."""

    def verdict(self, seen: Seen, now: float) -> Proof | None:
        """None: to be seen."""
        self.waiting = (self.unit,)
        self.starved = self.starved or bool(seen.starving(self.unit))
        # What starts without the processor or the disk that it needs gets as much more as recovery waits for anything.
        more_s = self.verify_s if self.starved else 0.0
        if not seen.well_since(self.unit, self.done):
            late = self.done + (self.grace_s(self.unit) + STILL_BAD_S if self.shows_s is None else self.shows_s)
            newest = seen.newest(self.unit, late + more_s)
            if newest is not None and newest.level is Level.ERROR:
                return Proof(missing=self.unit, excused=newest.condition in OUTSIDE or self.starved)
            decides_s = self.decides_s(seen)
            if now - self.done <= self.verify_s + decides_s + more_s:
                return None
            return Proof(missing=self.unit, undecided=decides_s > 0, excused=self.starved)
        suffering = seen.suffering(self.unit, self.done + self.proof_s)
        if not suffering and seen.well_since(self.unit, self.done + self.proof_s):
            return Proof()
        self.waiting = suffering or self.waiting
        longest_s = self.follow_s
        if longest_s is None:
            longest_s = max(self.grace_s(name) for name in self.waiting) + STILL_BAD_S + self.proof_s
        starved = self.starved and self._may_be_starvation(seen)
        if now - self.done <= longest_s + (more_s if starved else 0.0):
            return None
        return Proof(missing=self.waiting[0], partly=self.waiting[0] != self.unit, excused=starved)

    def _may_be_starvation(self, seen: Seen) -> bool:
        """Whether starvation can explain that the first unit has not come back: not where a network is detached, for instance.
        Such a failure counts, or the same step would be repeated for as long as the machine is busy."""
        newest = seen.newest(self.waiting[0], self.done + self.proof_s)
        return newest is None or newest.level is not Level.ERROR or explained(newest) is not None

    def decides_s(self, seen: Seen) -> float:
        """How long the unit's check needs from the start of the container, as it now says; 0: it does not wait for time."""
        newest = seen.newest(self.unit, self.done)
        return (newest.decides_s or 0.0) if newest is not None and newest.level is Level.STALE else 0.0


@dataclass(frozen=True, slots=True)
class Meanwhile:
    """What a long verification must not hold back.

    stopping: PHM ends.
    settled:  called once when `recovery.verify` is over and only time can tell about the unit: all else in the container is
              judged by itself from now on.
    wanted:   another fault of the container calls for an action; asked only after that.
    """

    stopping: Callable[[], bool]
    settled: Callable[[], None] = lambda: None
    wanted: Callable[[], bool] = lambda: False


def prove(shop: Shop, fault: Fault, target: str, kind: type[Action], meanwhile: Meanwhile) -> Proof:
    """Wait for the verdict. A life of the container that is not this action's doing ends the wait."""
    clock, pipeline = shop.clock, shop.pipeline
    verify_s = shop.context.settings.recovery.verify
    proving = Proving(fault.unit, clock.mono(), kind.proof_s, verify_s, shop.grace_s, kind.shows_s, kind.follow_s)
    mine = shop.lives.look(target)
    asked, settled = float("-inf"), False
    while not meanwhile.stopping():
        now = clock.mono()
        look_again = now - asked >= LOOK_AGAIN_S
        if look_again:
            asked = now
            taken = overtaken(shop.lives.look(target), mine, target)
            if taken is not None:
                return taken
        proof = proving.verdict(pipeline, now)
        if proof is not None:
            return proof
        if not settled and now - proving.done > verify_s and proving.decides_s(pipeline) > 0:
            settled = True
            meanwhile.settled()
        if look_again and settled and meanwhile.wanted():
            return Proof(missing=fault.unit, undecided=True)
        if look_again:
            pipeline.look_again(fault.unit, *proving.waiting)
        clock.wait(threading.Event(), POLL_S)
    return Proof(missing=fault.unit)


def overtaken(now: Life | None, mine: Life | None, target: str) -> Proof | None:
    """The engine's own restart policy overtakes nobody: whether the container is well then is what is to be proven."""
    if now is None or mine is None or now.same(mine) or now.by in (ENGINE, by_phm(target)):
        return None
    whose = now.whose
    return Proof(overtaken=f"the repair of {whose}" if whose else "somebody else", excused=bool(whose))
