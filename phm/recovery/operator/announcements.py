"""What recovery reports about its decisions and actions, in words for the log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from phm.core.clock import Clock
from phm.core.model import ActionEvent, Event, Fault, Phase
from phm.recovery.fault_cases import FaultCase
from phm.recovery.policy import Act, Advise, Decision, GiveUp, Wait
from phm.recovery.target import Target


@dataclass(frozen=True, slots=True)
class Announcement:
    """One step of an action, to be published once for each fault."""

    action: str
    phase: Phase
    detail: str


def announce(decision: Decision, target: Target) -> Announcement | None:
    """What to publish about a decision that is not to act; None: nothing. Pure."""
    name = target.name
    if isinstance(decision, Advise):
        return Announcement(decision.action, Phase.ADVISED, f"advised: {decision.action} {name} ({decision.why})")
    if isinstance(decision, Wait) and decision.report:
        return Announcement(decision.subject, Phase.REFUSED, f"no action on {name} for now: {decision.why}")
    if isinstance(decision, GiveUp):
        step = target.manual_step()
        return Announcement(decision.action, Phase.ESCALATED, f"gave up on {name}: {decision.why}; {step}")
    return None


def in_words(decision: Decision) -> str:
    """Why this was decided, as part of a sentence."""
    return f"{decision.action} is about to be done" if isinstance(decision, Act) else decision.why


class ActionReporter:
    """Publishes the steps of actions on the target of this name."""

    def __init__(self, target: str, clock: Clock, publish: Callable[[Event], None]) -> None:
        self._target, self._clock, self._publish = target, clock, publish

    def report(self, fault: Fault, action: str, phase: Phase, detail: str, attempt: int = 1) -> None:
        """Publish one step."""
        stamp = self._clock.stamp()
        self._publish(ActionEvent(stamp, fault.id, fault.unit, action, self._target, phase, detail, attempt))

    def report_once(self, case: FaultCase, action: str, phase: Phase, detail: str) -> None:
        """Publish one step, unless it was published for this fault before."""
        step = f"{phase.value} {action}"
        if step not in case.reported:
            case.reported.add(step)
            self.report(case.fault, action, phase, detail)
