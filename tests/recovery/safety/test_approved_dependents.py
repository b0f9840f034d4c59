"""What an approval covers, beside the target of the approved action."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import Any, cast

import pytest

from phm.core.model import Evidence, Fault, Layer, Level, Result, Slot, Stamp
from phm.recovery.actions.restart import Restart
from phm.recovery.actions.start import Start
from phm.recovery.attempt import Attempt
from phm.recovery.base import Action, FlightCriticalError, Target
from phm.recovery.ownership import Shared
from phm.recovery.safety.armed_state import ArmedState
from phm.testing import FakeClock
from tests.recovery.safety.test_flight_critical import Calls, Scene

GONE = Result(Level.ERROR, "exited", "exited", "exited", "base", evidence=Evidence())
FAULT = Fault("F1", "container/base", Slot.CONTAINER, Layer.DOCKER, GONE, Stamp(0.0, 0.0))


@pytest.mark.parametrize(("kind", "named"), [(Start, False), (Restart, True)])
def test_only_what_the_advice_names_is_approved(kind: type[Action], named: bool) -> None:
    """An operator approves in flight that `base` is started. That does not approve the restart of what runs and depends on it."""
    scene = Scene()
    assert ("fc_app" in scene.flight_critical_guard.forbids("base", kind.impact)) is named
    attempt, calls = approved(scene, kind)
    attempt._engine.start("base")
    with contextlib.suppress(FlightCriticalError), attempt._lock_dependent("fc_app", FAULT, "restart", 5.0):
        attempt._engine.restart("fc_app")
    assert ("restart fc_app" in calls.made) is named
    assert "start base" in calls.made


def approved(scene: Scene, kind: type[Action]) -> tuple[Attempt, Calls]:
    """An attempt on `base` that was approved while armed, and the calls that reach the engine."""
    calls = Calls(scene)
    locks = SimpleNamespace(
        begin_action=lambda *more, **marks: None,
        end_action=lambda *more, **marks: None,
        locked_dependent=lambda *more: contextlib.nullcontext(),
    )
    generations = SimpleNamespace(acting=lambda *more: contextlib.nullcontext())
    pipeline = SimpleNamespace(is_stopping=lambda target: False)
    attempt = Attempt(
        Target.of(scene.settings.container("base")),
        FAULT,
        kind,
        last=True,
        approved_at=ArmedState.ARMED,
        context=cast(Any, SimpleNamespace(settings=scene.settings, engine=calls)),
        shared=Shared(cast(Any, pipeline), FakeClock(), cast(Any, locks), cast(Any, generations), lambda unit: 0.0),
        guard=scene.flight_critical_guard,
        verify_s=30.0,
    )
    attempt._until = 100.0
    return attempt, calls
