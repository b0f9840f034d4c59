"""When the state file is written."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from phm.core.model import ActionEvent, Phase, Stamp
from phm.recovery.persistence.state import PersistedState, RecoveryState
from phm.recovery.persistence.state_file import ALONG_S, StateWriter
from phm.testing import FakeClock


@pytest.mark.parametrize(("phase", "soon"), [(Phase.STARTED, True), (Phase.DONE, False)])
def test_the_beginning_of_an_action_is_written_immediately(phase: Phase, soon: bool) -> None:
    """It follows the opening of its fault within milliseconds; if the power fails in the next second, the attempt must count."""
    saved: list[PersistedState] = []
    numbers = iter(range(10))
    pipeline = SimpleNamespace(open_faults=tuple, given_up=tuple, fault_count=lambda: next(numbers))
    clock = FakeClock()
    writer = StateWriter(cast(Any, SimpleNamespace(save=saved.append)), cast(Any, pipeline), RecoveryState, clock)
    event = ActionEvent(Stamp(0.0, 0.0), "F1", "container/app", "start", "app", phase)
    writer.handle(event)
    clock.advance(ALONG_S / 2)
    writer.handle(event)
    assert len(saved) == (2 if soon else 1)
    clock.advance(ALONG_S)
    writer.handle(event)
    assert len(saved) == (3 if soon else 2)
