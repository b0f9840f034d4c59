"""What is said about a decision of the policy, in words for the log. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from phm.core.model import Phase
from phm.core.settings import ContainerSettings
from phm.recovery import disks, links
from phm.recovery.policy import Act, Advise, Decision, GiveUp, Wait


@dataclass(frozen=True, slots=True)
class Announcement:
    """One step of an action to be published once for each fault."""

    action: str
    phase: Phase
    detail: str


def announce(decision: Decision, target: str, container: ContainerSettings | None) -> Announcement | None:
    """What to publish about a decision that is not to act; None: nothing."""
    if isinstance(decision, Advise):
        return Announcement(decision.action, Phase.ADVISED, f"advised: {decision.action} {target} ({decision.why})")
    if isinstance(decision, Wait) and decision.tell:
        return Announcement(decision.subject, Phase.REFUSED, f"{target} is left alone for now: {decision.why}")
    if isinstance(decision, GiveUp):
        named = container.name if container is not None else None
        step = disks.by_hand(target) if disks.path_of(target) else links.by_hand(target, named)
        return Announcement(decision.action, Phase.ESCALATED, f"gave up on {target}: {decision.why}; {step}")
    return None


def in_words(decision: Decision) -> str:
    """Why this was decided, as part of a sentence."""
    return f"{decision.action} is about to be done" if isinstance(decision, Act) else decision.why
