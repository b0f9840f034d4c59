"""Flap damping counts failures and recoveries, not the changing texts of a failure that lasts."""

from __future__ import annotations

from phm.core.model import Level
from phm.reporters.flap_damping import CALM_S, MANY, FlapDamper
from phm.reporters.statustext import StatusTextLine
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
