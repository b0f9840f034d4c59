"""An operator's approval: for one action, in the situation in which it was given, for a limited time; and refusals. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from phm.recovery.safety.armed_state import ArmedState


@dataclass(frozen=True, slots=True)
class Situation:
    """The situation in which an operator approves.

    armed:      the assessed armed state.
    generation: the container as `id@StartedAt`; empty: there is none, or it is not known.
    """

    action: str
    armed: ArmedState
    generation: str


@dataclass(frozen=True, slots=True)
class Approval:
    """An approval of an operator. given, until: monotonic seconds."""

    situation: Situation
    given: float
    until: float

    def void(self, now: float, situation: Situation) -> str:
        """Why it does not hold any more; empty: it does."""
        then = self.situation
        if now >= self.until:
            return f"it was not possible within {self.until - self.given:g} s"
        if situation.armed is not then.armed:
            return f"the vehicle was {_in_words(then.armed)} when it was given, and is {_in_words(situation.armed)} now"
        if situation.generation != then.generation:
            return "the container has been started or recreated since"
        if situation.action != then.action:
            return f"the next step is {situation.action or 'not known'} now"
        return ""


def _in_words(state: ArmedState) -> str:
    return "neither reliably armed nor disarmed" if state is ArmedState.UNKNOWN else state.value


class NotApprovable(Exception):
    """There is nothing to approve about this fault."""


class NotAllowed(Exception):
    """It is not done, whenever it is requested."""


class NotNow(Exception):
    """It is not done now and may be later."""
