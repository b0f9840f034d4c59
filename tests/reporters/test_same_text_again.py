"""A failure with a text that was sent before: another failure, or one that was on hold."""

from __future__ import annotations

from dataclasses import replace

from phm.core.model import ON_HOLD, Level, Result, Transition
from tests.reporters.test_mavlink import Scene

UNIT, FAILS, OVER = "nodes/a", (2, "A01 FAIL 6 a dead"), (5, "A01 OK 6 a recovered")


def hold(scene: Scene) -> None:
    old = scene.units[UNIT]
    scene.units[UNIT] = replace(old, level=Level.STALE, result=Result(Level.STALE, "", "on hold", ON_HOLD))
    scene.reporter.handle(Transition(scene.clock.stamp(), old.level, scene.units[UNIT]))


def test_a_failure_that_is_a_new_fault_is_sent() -> None:
    """The first one was a consequence in between, and the ground has removed its text."""
    scene = Scene().running()
    scene.become(UNIT, Level.ERROR, "a dead")
    scene.become(UNIT, Level.STALE, blocked_by="container/app")
    scene.become(UNIT, Level.ERROR, "a dead")
    assert scene.port.lines() == [FAILS, FAILS]


def test_an_unknown_moment_of_the_same_fault_is_not_sent() -> None:
    """One line for one fault."""
    scene = Scene().running()
    for level in (Level.ERROR, Level.STALE, Level.ERROR):
        scene.become(UNIT, level, "a dead")
    assert scene.port.lines() == [FAILS]


def test_the_end_of_a_failure_during_its_hold_is_sent() -> None:
    """An operator repairs what is on hold; without it, the failure is sent again after the hold."""
    scene = Scene().running()
    scene.become(UNIT, Level.ERROR, "a dead")
    hold(scene)
    scene.become(UNIT, Level.OK)
    assert scene.port.lines() == [FAILS, OVER]
    scene.become(UNIT, Level.ERROR, "a dead")
    hold(scene)
    scene.become(UNIT, Level.ERROR, "a dead")
    assert scene.port.lines() == [FAILS, FAILS]
