"""Holds by maintenance windows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from phm.recovery.holds.hold_registry import ALL
from phm.recovery.safety.armed_state import ArmedState as ArmedState
from tests.recovery.holds.scene import BY, Scene


def test_a_window_begins_and_ends_a_hold(scenes: Any) -> None:
    """FakeClock begins on 2023-11-14; the window applies once the clock was set."""
    scene = scenes(maintenance=[{"when": "02:00-02:10", "container": "cam", "reason": "upload"}])
    scene.clock.jump_utc(1795312740.0 - scene.clock.utc())  # 2026-11-22 01:59 UTC
    scene.agent.rest(50)
    assert scene.changes() == []
    scene.agent.rest(20)
    assert scene.changes() == [("cam", True)] and "maintenance window: upload" in scene.last()
    scene.agent.rest(600)
    assert scene.changes() == [("cam", True), ("cam", False)]


def test_a_released_window_does_not_open_again(scenes: Any) -> None:
    """An occurrence is one hold, however the clock is set."""
    scene = scenes(maintenance=[{"when": "02:00-02:10"}])
    scene.clock.jump_utc(1795312860.0 - scene.clock.utc())  # 2026-11-22 02:01 UTC
    scene.agent.rest(10)
    assert scene.changes() == [("", True)]
    scene.service.release(ALL, BY)
    scene.clock.jump_utc(-30)
    scene.agent.rest(30)
    assert scene.changes() == [("", True), ("", False)]


def test_a_label_defines_a_window_and_an_invalid_one_is_reported_once(scene: Scene) -> None:
    """The label holds its own container."""
    scene.containers.facts["cam"] = replace(scene.containers.facts["cam"], maintenance="00:00-23:59")
    scene.containers.facts["app"] = replace(scene.containers.facts["app"], maintenance="whenever")
    scene.clock.jump_utc(1795312860.0 - scene.clock.utc())
    scene.agent.rest(70)
    assert scene.changes() == [("cam", True)]
    assert len([text for text in scene.agent.notes() if "'whenever' is not a maintenance window" in text]) == 1


@pytest.mark.parametrize(
    ("armed", "opens"), [(ArmedState.DISARMED, ["app", "cam"]), (ArmedState.UNKNOWN, ["cam"]), (ArmedState.ARMED, [])]
)
def test_no_window_opens_in_flight(scenes: Any, armed: ArmedState, opens: list[str]) -> None:
    """For a flight-critical container only where the vehicle is known to be disarmed."""
    windows = [{"when": "00:00-23:59", "container": key} for key in ("app", "cam")]
    scene = scenes(maintenance=windows)
    scene.armed = armed
    scene.clock.jump_utc(1795312860.0 - scene.clock.utc())
    scene.agent.rest(10)
    assert sorted(hold["container"] for hold in scene.service.snapshot()) == opens
