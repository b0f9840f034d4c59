"""One attempt at a repair: holds the target, acts, proves, and says what came of it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from phm.core.model import Fault, Phase
from phm.core.settings import ContainerSettings
from phm.facts import CannotTell
from phm.recovery.acting import Acting
from phm.recovery.base import Action, ActionFailed
from phm.recovery.safety.armed_state import ArmedState
from phm.recovery.safety.flight_critical import Impact
from phm.recovery.shop import Shop
from phm.recovery.verification import VerificationHooks, prove

logger = logging.getLogger(__name__)

MARGIN_S = 20.0
"""Beyond an action's deadline and `verify`, its hold lasts this long: what needs the target may come back last."""


@dataclass(frozen=True, slots=True)
class AttemptOutcome:
    """What came of an attempt: whether it worked, and a sentence for the log.

    refused:   PHM was told that it may not; it is not tried again for this fault.
    overtaken: somebody else has started the container meanwhile: it gets its grace before the next attempt.
    excused:   the failure says nothing about the target (`phm.recovery.history`).
    forbidden: not done, because the vehicle was armed meanwhile.
    postponed: nothing was done, since something that the step needs is not there: no attempt.
    undecided: time will tell; until then it has not failed.
    partly:    the unit itself came back, and not all that needs it.
    """

    worked: bool
    detail: str
    refused: bool = False
    superseded: bool = False
    not_counted: bool = False
    forbidden: bool = False
    postponed: bool = False
    undecided: bool = False
    partly: bool = False

    @property
    def phase(self) -> Phase:
        """Where the action stands now."""
        if self.worked:
            return Phase.VERIFIED
        if self.postponed or self.forbidden:
            return Phase.REFUSED
        return Phase.DONE if self.undecided else Phase.FAILED


class Repair:
    """`begin`, then `run`, then `release`. Each repair is an owner of its own (`phm.recovery.safety.target_locks`)."""

    def __init__(
        self,
        shop: Shop,
        target: ContainerSettings,
        fault: Fault,
        kind: type[Action],
        *,
        last: bool,
        approved_at: ArmedState | None = None,
    ) -> None:
        """last: no rung of the ladder follows. approved_at: as of `Acting`."""
        self._shop, self._target, self._fault, self._kind, self._last = shop, target.key, fault, kind, last
        # What disturbs the target in nothing keeps nothing of it back either.
        self._held = target.key if kind.impact is not Impact.OTHERS else f"{kind.name}:{target.key}"
        self._began, self._credited = shop.clock.mono(), True
        action = kind()
        self._missing = partial(action.waits_for, target, fault, shop.context)
        self._acting = Acting(shop, target, fault, action, approved_at)

    def waits_for(self) -> str:
        """What must be there first and is not; empty also when nobody can tell: then the action says what is wrong."""
        try:
            return self._missing()
        except (CannotTell, ActionFailed):
            return ""
        except Exception:  # plug-in code
            logger.exception("what action %s waits for could not be found out", self._kind.name)
            return ""

    def begin(self) -> bool:
        """Take the target in hand and hold it; False when another container's repair is restarting it."""
        if not self._acting.begin():
            return False
        at_most_s = self._kind.deadline_s + self._shop.context.settings.recovery.verify + MARGIN_S
        proving = self._held == self._target
        self._shop.hands.hold(self._held, self, self._fault.unit, self._kind.name, at_most_s, proving=proving)
        return True

    def release(self, *, worked: bool) -> None:
        """End the hold, and let the target go if that has not happened."""
        self._acting.release_target()
        if worked and not self._credited:
            self._shop.pipeline.clear_action_credit(self._fault.unit)
        self._shop.hands.release(self._held, self, worked=worked)
        if not worked:
            self._shop.pipeline.clear_action_credit(self._fault.unit)

    def run(
        self,
        tell: Callable[[Phase, str], None],
        stopping: Callable[[], bool],
        wanted: Callable[[], bool] = lambda: False,
    ) -> AttemptOutcome:
        """wanted: whether another fault of the container calls for an action (`phm.recovery.verification.VerificationHooks`)."""
        name, unit = self._kind.name, self._fault.unit
        tell(Phase.STARTED, f"{name} {self._target} for: {self._fault.result.summary}")
        done = self._acting.run()
        if not done.ok:
            not_done = done.forbidden or done.postponed
            return AttemptOutcome(
                False,
                done.detail,
                done.refused,
                not_counted=not_done,
                forbidden=done.forbidden,
                postponed=done.postponed,
            )
        tell(Phase.DONE, done.detail)
        proof = prove(
            self._shop, self._fault, self._target, self._kind, VerificationHooks(stopping, self._settle, wanted)
        )
        if proof.superseded_by:
            words = f"{self._target} was started again by {proof.superseded_by} before {name} was proven"
            return AttemptOutcome(False, words, superseded=True, not_counted=proof.not_counted)
        # On the last rung nothing more can be done for what has not come back: it is told as faults of its own.
        if not proof.missing or (self._last and proof.missing != unit):
            took_s = self._shop.clock.mono() - self._began
            words = f"{unit} is OK again {took_s:.1f} s after the action began"
            other = "there was nothing to do for it" if done.unneeded else self._acting.other_cause()
            self._credited = not other
            return AttemptOutcome(True, f"{words}, and not by {name}: {other}" if other else words)
        if proof.undecided:
            return AttemptOutcome(
                False, f"{name} of {self._target}: {unit} is not known yet, and PHM waits", undecided=True
            )
        words = f"{name} of {self._target} did not bring {proof.missing} back"
        return AttemptOutcome(False, words, not_counted=proof.not_counted, partly=proof.partly)

    def _settle(self) -> None:
        self._shop.hands.release(self._held, self, worked=True)
