"""How long the proof of an action waits before it says that the action has not helped. Pure."""

from __future__ import annotations

import pytest

from phm.api import Result, error
from phm.recovery.proof import Proof, Proving

GRACE_S = 3.0


class Silent:
    """A unit that every run finds bad; the newest run began at `started`."""

    def __init__(self, started: float) -> None:
        self.started = started

    def well_since(self, unit: str, mono: float) -> bool:
        return False

    def suffering(self, unit: str, mono: float) -> tuple[str, ...]:
        return ()

    def newest(self, unit: str, mono: float) -> Result | None:
        found = error("silent", brief="silent", condition="address_silent")
        return found if self.started >= mono else None


class Alone(Silent):
    """The unit is well, and what needs it stays away."""

    def well_since(self, unit: str, mono: float) -> bool:
        return True

    def suffering(self, unit: str, mono: float) -> tuple[str, ...]:
        return ("nodes/one",)


def verdict(started: float, shows_s: float | None) -> Proof | None:
    """0 is when the action was over."""
    return Proving("network/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S, shows_s).verdict(Silent(started), started + 2.0)


def test_what_works_at_once_or_never_is_not_waited_for() -> None:
    """A reconnected address that is silent after a second has failed, whatever grace the unit has."""
    assert verdict(0.5, shows_s=1.0) is None
    assert verdict(1.0, shows_s=1.0) == Proof(missing="network/app")


def test_other_actions_are_given_the_grace_of_the_unit() -> None:
    """A container that was started needs its time."""
    assert verdict(4.5, shows_s=None) is None
    assert verdict(5.0, shows_s=None) == Proof(missing="network/app")


@pytest.mark.parametrize(("follow_s", "longest_s"), [(6.0, 6.0), (None, GRACE_S + 4.0)])
def test_what_needs_the_unit_is_waited_for_as_long_as_the_action_says(follow_s: float | None, longest_s: float) -> None:
    """After a reconnection nothing has to start: the nodes find each other soon, or not before they are restarted."""
    proving = Proving("network/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S, follow_s=follow_s)
    assert proving.verdict(Alone(0.0), longest_s) is None
    assert proving.verdict(Alone(0.0), longest_s + 0.1) == Proof(missing="nodes/one", partly=True)
