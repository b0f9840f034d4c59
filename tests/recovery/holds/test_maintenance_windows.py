"""Holds by maintenance windows."""

from __future__ import annotations

import re
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


@pytest.mark.parametrize("labelled", [False, True])
def test_overlapping_windows_are_both_in_force(scenes: Any, labelled: bool) -> None:
    """The container is on hold until the last one ends. They replaced each other every five seconds."""
    first, second = ({"when": when, "container": "cam"} for when in ("02:00-02:02", "02:01-02:03"))
    scene = scenes(maintenance=[first] if labelled else [first, second])
    if labelled:
        scene.containers.facts["cam"] = replace(scene.containers.facts["cam"], maintenance="02:01-02:03")
    scene.clock.jump_utc(1795312855.0 - scene.clock.utc())  # 2026-11-22 02:00:55 UTC
    scene.agent.rest(45)
    assert scene.changes() == [("cam", True)] * 2
    scene.agent.rest(45)
    assert scene.changes()[2:] == [("cam", True)] and len(scene.service.snapshot()) == 1
    assert re.search(r"is over: it has expired; cam is still on hold until 02:0\d:\d\d UTC by maint", scene.last())
    scene.agent.rest(45)
    assert scene.changes()[3:] == [("cam", False)] and scene.service.snapshot() == []


def test_the_end_of_a_hold_on_all_names_what_is_still_on_hold(scenes: Any) -> None:
    """Only `all released` would be wrong for that container."""
    scene = scenes(maintenance=[{"when": "02:00-02:02"}, {"when": "02:00-02:04", "container": "cam"}])
    scene.clock.jump_utc(1795312860.0 - scene.clock.utc())  # 2026-11-22 02:01 UTC
    scene.agent.rest(70)
    assert scene.changes() == [("", True), ("cam", True), ("", False), ("cam", True)]
    scene.agent.rest(120)
    assert scene.changes()[4:] == [("cam", False)] and scene.service.snapshot() == []


def test_a_release_names_the_hold_that_still_applies(scene: Scene) -> None:
    """A container is not free while all are on hold."""
    scene.hold(ALL, 600.0)
    scene.hold("cam")
    scene.service.release("cam", BY)
    scene.agent.rest(1)
    assert scene.changes() == [("", True), ("cam", True), ("cam", True)]
    assert "is over: released by operator (uid 0); cam is still on hold until" in scene.last()


def test_a_release_ends_all_windows_that_are_open(scenes: Any) -> None:
    """None of them begins again."""
    scene = scenes(maintenance=[{"when": when} for when in ("02:00-02:10", "02:00-02:20")])
    scene.clock.jump_utc(1795312860.0 - scene.clock.utc())  # 2026-11-22 02:01 UTC
    scene.agent.rest(10)
    scene.service.release(ALL, BY)
    scene.agent.rest(30)
    assert scene.changes() == [("", True)] * 2 + [("", False)] * 2
