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

    def starving(self, unit: str) -> str:
        return ""


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


class Starved(Silent):
    """As Silent and Alone, of a container that is starved until `until`."""

    def __init__(self, started: float, *, well: bool, until: float = 100.0, condition: str = "node_unheard") -> None:
        super().__init__(started)
        self.well, self.until, self.now, self.condition = well, until, 0.0, condition

    def newest(self, unit: str, mono: float) -> Result | None:
        return error("bad", brief="bad", condition=self.condition) if self.started >= mono else None

    def well_since(self, unit: str, mono: float) -> bool:
        return self.well

    def suffering(self, unit: str, mono: float) -> tuple[str, ...]:
        return ("nodes/one",)

    def starving(self, unit: str) -> str:
        return "pressure/app" if self.now < self.until else ""

    def say(self, proving: Proving, now: float) -> Proof | None:
        self.now = now
        return proving.verdict(self, now)


@pytest.mark.parametrize("until", [1.0, 100.0])
@pytest.mark.parametrize("well", [True, False])
def test_what_starts_while_it_is_starved_gets_more_time_and_is_not_to_blame(well: bool, until: float) -> None:
    """As long again as `recovery.verify`, also when the starvation has ended meanwhile; then the attempt has failed, excused."""
    starved = Starved(1000.0 if well else 36.0, well=well, until=until)
    proving = Proving("container/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S)
    ends = GRACE_S + 4.0 + 30.0 if well else GRACE_S + 2.0 + 30.0
    for now in (0.5, 10.0, 34.0):
        starved.started = now
        assert starved.say(proving, now) is None
    starved.started = ends
    late = starved.say(proving, ends + 0.1)
    assert late is not None and late.excused and late.partly is well


def test_what_starvation_does_not_explain_is_to_blame() -> None:
    """The network of a container that was started is detached: neither more time nor another start changes that."""
    starved = Starved(100.0, well=True, condition="disconnected")
    proving = Proving("container/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S)
    ends = GRACE_S + 4.0
    assert starved.say(proving, ends) is None
    assert starved.say(proving, ends + 0.1) == Proof(missing="nodes/one", partly=True)
