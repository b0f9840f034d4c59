"""One attempt at a repair: holds the target, acts, proves, and says what came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from phm.model import Fault, Phase
from phm.recovery.acting import Acting
from phm.recovery.armed import State
from phm.recovery.base import Action
from phm.recovery.proof import prove
from phm.recovery.shop import Shop
from phm.settings import ContainerSettings

MARGIN_S = 20.0
"""Beyond an action's deadline and `verify`, its hold lasts this long: what needs the target may come back last."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What came of an attempt: whether it worked, and a sentence for the log.

    refused:   PHM was told that it may not; it is not tried again for this fault.
    overtaken: somebody else has started the container meanwhile: it gets its grace before the next attempt.
    excused:   the failure says nothing about the target (`phm.recovery.history`).
    forbidden: not done, because the vehicle was armed meanwhile.
    """

    worked: bool
    detail: str
    refused: bool = False
    overtaken: bool = False
    excused: bool = False
    forbidden: bool = False


class Repair:
    """`begin`, then `run`, then `release`. Each repair is an owner of its own (`phm.recovery.hands`)."""

    def __init__(
        self, shop: Shop, target: ContainerSettings, fault: Fault, kind: type[Action], *, last: bool,
        approved_at: State | None = None,
    ) -> None:  # fmt: skip
        """last: no rung of the ladder follows. approved_at: as of `Acting`."""
        self._shop, self._target, self._fault, self._kind, self._last = shop, target.key, fault, kind, last
        self._began = shop.clock.mono()
        self._acting = Acting(shop, target, fault, kind(), approved_at)

    def begin(self) -> bool:
        """Take the target in hand and hold it; False when another container's repair is restarting it."""
        if not self._acting.begin():
            return False
        at_most_s = self._kind.deadline_s + self._shop.context.settings.recovery.verify + MARGIN_S
        self._shop.hands.hold(self._target, self, self._fault.unit, self._kind.name, at_most_s, proving=True)
        return True

    def release(self, *, worked: bool) -> None:
        """End the hold, and let the target go if that has not happened."""
        self._acting.let_go()
        self._shop.hands.release(self._target, self, worked=worked)

    def run(self, tell: Callable[[Phase, str], None], stopping: Callable[[], bool]) -> Verdict:
        name, unit = self._kind.name, self._fault.unit
        tell(Phase.STARTED, f"{name} {self._target} for: {self._fault.result.summary}")
        done = self._acting.run()
        if not done.ok:
            return Verdict(False, done.detail, done.refused, excused=done.forbidden, forbidden=done.forbidden)
        tell(Phase.DONE, done.detail)
        proof = prove(self._shop, self._fault, self._target, self._kind, stopping)
        if proof.overtaken:
            words = f"{self._target} was started again by {proof.overtaken} before {name} was proven"
            return Verdict(False, words, overtaken=True, excused=proof.excused)
        # On the last rung nothing more can be done for what has not come back: it is told as faults of its own.
        if not proof.missing or (self._last and proof.missing != unit):
            took_s = self._shop.clock.mono() - self._began
            return Verdict(True, f"{unit} is OK again {took_s:.1f} s after the action began")
        return Verdict(False, f"{name} of {self._target} did not bring {proof.missing} back")
