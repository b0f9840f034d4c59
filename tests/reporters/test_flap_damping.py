"""Flap damping counts failures and recoveries, not the changing texts of a failure that lasts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from phm.core.model import ON_HOLD, Level, Result, Transition
from phm.reporters.flap_damping import CALM_S, MANY, RARE_S, FlapDamper
from phm.reporters.statustext import StatusTextLine
from phm.transport.priority import MessagePriority
from phm.wire.status_line import Severity
from tests.reporters.test_mavlink import Scene

FLAPPING = "A01 WARN 6 flapping: a dead"
FAIL, WARN, OK = Severity.CRITICAL, Severity.WARNING, Severity.NOTICE


def line(severity: Severity, text: str = "") -> StatusTextLine:
    return StatusTextLine("nodes/a", severity, text or severity.name)


def passed(damper: FlapDamper, now: float, severity: Severity, text: str = "") -> list[str]:
    return [one.text for one in damper.filter([line(severity, text)], now, FLAPPING)]


def flap(damper: FlapDamper, bad: Severity = WARN) -> float:
    """Fail and recover until it flaps. Returns the time."""
    for second in range(MANY):
        sent = passed(damper, float(second), OK if second % 2 else bad)
    assert sent == [FLAPPING]
    return float(second)


def test_one_long_outage_is_not_flapping_and_its_end_is_sent_immediately() -> None:
    """Its text changes five times within a minute, as the number of seconds without a heartbeat does."""
    scene = Scene(refresh=600).running()
    briefs = [f"no heartbeat {seconds} s" for seconds in (3, 6, 12, 24, 48)]
    for brief in briefs:
        scene.become("host", Level.ERROR, brief)
        scene.pass_time(10.0)
    scene.become("host", Level.OK)
    lines = [words for _, words in scene.port.lines()]
    assert lines[:-1] == [f"A01 FAIL 9 {brief}" for brief in briefs]
    assert lines[-1].startswith("A01 OK 9 ")


def test_a_text_that_changes_all_the_time_is_limited_and_its_end_is_not_late() -> None:
    """Six texts, then the newest every half minute; without `flapping`."""
    damper = FlapDamper()
    sent = []
    for second in range(601):
        sent += passed(damper, float(second), FAIL, f"text {second}")
        sent += [one.text for one in damper.settled(float(second))]
    assert sent[:MANY] == [f"text {second}" for second in range(MANY)]
    assert MANY + 600 / CALM_S - 1 <= len(sent) <= MANY + 600 / CALM_S + 1
    assert passed(damper, 602.0, OK) == ["NOTICE"]
    assert damper.settled(700.0) == [], "the text that waited is outdated"


def test_after_many_texts_of_a_failure_the_next_are_sent_as_refreshes() -> None:
    """Also those with long enough pauses that none is held back. Its worsening and its end are changes, and the texts of
    the next failure.
    """
    damper = FlapDamper()
    kinds = []
    for number in range(2 * MANY):
        now = number * CALM_S
        kinds += [one.kind for one in damper.filter([line(WARN, f"text {number}")], now, FLAPPING)]
    assert kinds == [MessagePriority.TRANSITION] * (MANY + 1) + [MessagePriority.REFRESH] * (MANY - 1)
    for severity in (FAIL, OK, WARN):
        (sent,) = damper.filter([line(severity)], now + 200.0, FLAPPING)
        assert sent.kind is MessagePriority.TRANSITION
    (sent,) = damper.filter([line(WARN, "another text")], now + 201.0, FLAPPING)
    assert sent.kind is MessagePriority.TRANSITION


def test_texts_that_change_rarely_are_changes() -> None:
    """The text may be another problem of the unit."""
    damper = FlapDamper()
    kinds = [
        one.kind
        for number in range(2 * MANY)
        for one in damper.filter([line(FAIL, f"text {number}")], number * RARE_S, FLAPPING)
    ]
    assert kinds == [MessagePriority.TRANSITION] * 2 * MANY


def test_a_new_fault_is_a_change_although_the_end_of_the_last_one_had_no_line() -> None:
    """The unit recovered during a hold."""
    scene = Scene(refresh=600).running()
    for number in range(MANY + 2):
        scene.become("host", Level.ERROR, f"text {number}")
        scene.pass_time(CALM_S)
    failed = scene.units["host"]
    scene.units["host"] = replace(failed, level=Level.STALE, result=Result(Level.STALE, "", "on hold", ON_HOLD))
    scene.reporter.handle(Transition(scene.clock.stamp(), failed.level, scene.units["host"]))
    scene.become("host", Level.OK)
    scene.pass_time(RARE_S / 2)
    kinds: list[MessagePriority] = []
    scene.port.to = lambda message, kind, key, urgency: kinds.append(kind)
    scene.port.sent.clear()
    scene.become("host", Level.ERROR, "new")
    assert [text for _, text in scene.port.lines()] == ["A01 FAIL 9 new"]
    assert kinds == [MessagePriority.TRANSITION]


def test_a_text_that_was_held_back_is_sent_as_a_refresh() -> None:
    """It is one of many."""
    damper = FlapDamper()
    for number in range(MANY + 2):
        passed(damper, 0.0, FAIL, f"text {number}")
    (sent,) = damper.settled(CALM_S)
    assert (sent.text, sent.kind) == (f"text {MANY + 1}", MessagePriority.REFRESH)


def texts_used_up() -> Scene:
    """A unit that fails, and whose newest text is held back."""
    scene = Scene(refresh=600).running()
    for number in range(MANY + 2):
        scene.become("nodes/a", Level.ERROR, f"a at {number} %")
        scene.pass_time(0.2)
    assert scene.port.lines()[-1] == (2, f"A01 FAIL 6 a at {MANY} %")
    return scene


def flapped() -> Scene:
    """A unit that flaps, and fails now."""
    scene = Scene(refresh=600).running()
    for _ in range(MANY):
        scene.become("nodes/a", Level.ERROR, "a dead")
        scene.become("nodes/a", Level.OK)
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert scene.port.lines()[-1] == (4, FLAPPING)
    return scene


@pytest.mark.parametrize("held", [texts_used_up, flapped])
@pytest.mark.parametrize("blocked_by", ["", "container/app"])
def test_a_failure_that_was_held_back_is_not_sent_while_its_unit_is_unknown(
    held: Callable[[], Scene], blocked_by: str
) -> None:
    """Or a consequence of another fault. It is sent when the unit is found bad again, and its end always."""
    for again in (Level.ERROR, Level.OK):
        scene = held()
        brief = scene.units["nodes/a"].result.brief
        scene.become("nodes/a", Level.STALE, blocked_by=blocked_by)
        scene.pass_time(40.0)
        assert [line for line in scene.port.lines() if line[0] < 6] == []
        scene.become("nodes/a", again, brief)
        scene.pass_time(1.0)
        ((severity, words),) = [line for line in scene.port.lines() if line[0] < 6]
        assert (severity, words) == (2, f"A01 FAIL 6 {brief}") if again is Level.ERROR else severity == 5


def test_a_worsening_is_sent_and_not_replaced_by_a_warning() -> None:
    """Suppression begins with a recovery. A failure worse than all reported ones is sent during it."""
    damper = FlapDamper()
    for second in range(MANY):
        sent = passed(damper, float(second), FAIL if second % 2 else OK)
    assert sent == ["CRITICAL"]
    assert passed(damper, float(MANY), OK) == [FLAPPING]
    damper = FlapDamper()
    now = flap(damper, WARN)
    assert passed(damper, now + 1, WARN) == []
    assert passed(damper, now + 2, FAIL) == ["CRITICAL"]
    assert passed(damper, now + 3, OK) == []
    assert passed(damper, now + 4, FAIL) == []
    assert passed(damper, now + 5, OK) == []
    assert [one.text for one in damper.settled(now + 5 + CALM_S)] == ["NOTICE"]


def test_a_failure_of_a_unit_that_flaps_is_not_sent_as_a_warning() -> None:
    """Of a unit of PHM, whose faults begin before their first line: only a recovery begins the suppression."""
    scene = Scene(refresh=600).running()
    for _ in range(3):
        scene.become("nodes/a", Level.ERROR, "a dead")
        scene.pass_time(15.0)
        scene.become("nodes/a", Level.OK)
        scene.pass_time(9.0)
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert scene.port.lines()[-1] == (2, "A01 FAIL 6 a dead"), "the sixth change within a minute"
    scene.become("nodes/a", Level.OK)
    assert scene.port.lines()[-1] == (4, FLAPPING)


def test_failures_without_a_line_about_their_end_are_limited() -> None:
    """Each follows from another fault two seconds later, and the next one has another text."""
    scene = Scene(refresh=600).running()
    for number in range(30):
        scene.become("nodes/a", Level.ERROR, f"a at {number} Hz")
        scene.pass_time(2.0)
        scene.become("nodes/a", Level.STALE, blocked_by="container/app")
        scene.pass_time(2.0)
    lines = [line for line in scene.port.lines() if line[0] < 6]
    assert [severity for severity, _ in lines] == [2] * (MANY - 1) + [4]


def test_changed_texts_do_not_prolong_the_suppression() -> None:
    """The unit has failed for CALM_S: its newest text is sent."""
    damper = FlapDamper()
    now = flap(damper)
    for second in range(int(CALM_S)):
        assert passed(damper, now + 1 + second, WARN, f"text {second}") == []
    assert [one.text for one in damper.settled(now + 1 + CALM_S)] == [f"text {int(CALM_S) - 1}"]


def test_lines_without_a_recovery_between_them_count_where_each_is_a_change() -> None:
    """An agent that loses the ground again and again: its return is not a line."""
    damper = FlapDamper(every_line=True)
    sent = [passed(damper, float(second), WARN) for second in range(MANY + 1)]
    assert sent[-2:] == [[FLAPPING], []]
