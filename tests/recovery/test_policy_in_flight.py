"""Which step of a ladder recovery takes while the vehicle may be armed; no action is executed here."""

from __future__ import annotations

import pytest

from phm.core.model import Fault, Layer, Level, Result, Slot, Stamp
from phm.core.settings import ContainerSettings, RecoverySettings
from phm.recovery.base import Target
from phm.recovery.fault_cases import AttemptRecord, History
from phm.recovery.policy import Act, Advise, Wait, decide

APP = Target.of(ContainerSettings(name="app", recover=True))
RULES = RecoverySettings()
SHARED = frozenset({"restart"})
"""Actions on the entire container, which the armed vehicle forbids."""


def fault(condition: str) -> Fault:
    result = Result(Level.ERROR, "it is broken", "broken", condition, "app")
    return Fault("F1", "health/app", Slot.CONTAINER, Layer.DOCKER, result, Stamp(0.0, 1000.0))


@pytest.mark.parametrize(("condition", "first"), [("exited", "start"), ("oom", "start"), ("paused", "unpause")])
def test_what_disturbs_no_other_container_is_repeated_in_flight(condition: str, first: str) -> None:
    """A restart might take down a flight-critical container that uses its network. The first step cannot."""
    history = History([AttemptRecord(1000.0, "health/app", condition, first, False)])

    def say_while(forbidden: frozenset[str], now: float = 1001.0) -> object:
        given = {"target": APP, "settings": RULES, "container_wide": SHARED}
        return decide(fault(condition), history, now, forbids=lambda action: "armed" * (action in forbidden), **given)  # type: ignore[arg-type]

    assert say_while(frozenset()) == Act("restart", 2)
    assert say_while(SHARED) == Act(first, 2)
    assert say_while(SHARED, 1000.9) == Wait(1001.0, "backing off")
    assert say_while(SHARED | {first}) == Advise("restart", "armed", again_at=1003.0)


@pytest.mark.parametrize(("condition", "first"), [("exited", "start"), ("paused", "unpause")])
def test_in_flight_an_approval_is_for_the_step_that_was_advised(condition: str, first: str) -> None:
    """Else it would expire immediately, or an approved start would become a restart."""
    history = History([AttemptRecord(1000.0, "health/app", condition, first, False)])

    def say_in_flight(*, approved: bool) -> object:
        given = {"target": APP, "settings": RecoverySettings(mode="advise"), "container_wide": SHARED}
        return decide(
            fault(condition),
            history,
            1100.0,
            forbids=lambda action: "armed" * (action in SHARED),
            approved=approved,
            **given,  # type: ignore[arg-type]
        )

    assert say_in_flight(approved=False) == Advise(first, "recovery only advises")
    assert say_in_flight(approved=True) == Act(first, 2)


def test_what_stays_paused_in_flight_is_restarted_after_landing() -> None:
    """Only the restart was forbidden, and it was never tried."""
    history = History([AttemptRecord(1000.0 + at, "health/app", "paused", "unpause", False) for at in range(3)])

    def say_while(armed: str) -> object:
        given = {"target": APP, "settings": RULES, "container_wide": SHARED}
        return decide(fault("paused"), history, 1100.0, forbids=lambda action: armed * (action in SHARED), **given)  # type: ignore[arg-type]

    assert say_while("armed") == Act("unpause", 4)
    assert say_while("") == Act("restart", 4)
