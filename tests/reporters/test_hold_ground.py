"""A hold as the ground sees it: lines, status word, digest and the output of `phm gcs`."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm.core.model import ON_HOLD, HoldChanged, Level, Slot, UnitState, worst_by_slot
from phm.gcs import statustext_parser
from phm.gcs.statustext_parser import LineKind
from phm.reporters.statustext import StatusTextBuilder
from phm.swarm import digest
from phm.wire import status_line, status_word
from tests.fakes.records import at, opened, transition, unit
from tests.gcs.bench import Ground, phm_heartbeat, text_frame

HELD = unit("container/ros_app", Slot.CONTAINER, Level.STALE, brief="ros_app on hold", condition=ON_HOLD)
BELOW = unit("nodes/a", Slot.NODES, Level.STALE, blocked_by="container/ros_app")
HEALTHY = unit("files/ros_app", Slot.FILES)


def changed(target: str, *, began: bool, for_s: float = 1200.0, reason: str = "new firmware") -> HoldChanged:
    return HoldChanged(at(), target, began, "operator", reason, for_s, "ros_app is on hold")


@pytest.mark.parametrize(
    ("target", "began", "for_s", "reason", "text"),
    [
        ("ros_app", True, 1200.0, "new firmware", "A01 HOLD 2 ros_app 20 min: new firmware"),
        ("ros_app", True, 90.0, "", "A01 HOLD 2 ros_app 90 s"),
        ("", True, 14400.0, "", "A01 HOLD 2 all 240 min"),
        ("ros_app", False, 5.0, "new firmware", "A01 HOLD 2 ros_app released"),
        ("", False, 0.0, "", "A01 HOLD 2 all released"),
    ],
)
def test_a_hold_is_a_line(target: str, began: bool, for_s: float, reason: str, text: str) -> None:
    """Target, duration and reason; and its end. It is parsed as a change without a failure."""
    line = StatusTextBuilder(1).hold(changed(target, began=began, for_s=for_s, reason=reason))[0]
    assert (line.text, int(line.severity)) == (text, 5)
    found = statustext_parser.parse(line.text)
    assert found is not None and (found.kind, found.word, found.level) == (LineKind.CHANGE, "HOLD", None)


def test_a_hold_line_fits_whatever_its_target_is_called() -> None:
    """At most 50 printable characters, and the end stays recognizable."""
    for began in (True, False):
        text = StatusTextBuilder(250).hold(changed("x" * 128, began=began, reason="\x1bümlaut " * 40))[0].text
        assert len(text) <= 50 and text.isascii() and text.isprintable()
        assert text.endswith(" released") is not began


def test_the_refresh_says_hold_when_all_unknown_units_are_on_hold() -> None:
    """A bad unit, or one unknown for another reason, comes first."""
    assert status_line.refresh(1, [HELD, BELOW, HEALTHY]) == "A01 HOLD --1----- 2 ros_app on hold"
    assert status_line.refresh(1, [HELD, replace(BELOW, blocked_by=""), HEALTHY]) == "A01 STALE --1----- 2"
    bad = unit("files/b", Slot.FILES, Level.ERROR, brief="b missing")
    assert status_line.refresh(1, [HELD, bad]).startswith("A01 FAIL ")


def test_a_held_slot_is_not_a_failed_slot() -> None:
    """Neither in the status word and the heartbeat's state, nor in the digest of the swarm."""
    states: tuple[UnitState, ...] = (HELD, BELOW, HEALTHY)
    word = status_word.encode(worst_by_slot(states))
    assert status_word.decode(word) == {Slot.FILES: Level.OK}
    assert status_word.system_status(states, complete=True) == status_word.ACTIVE
    assert digest.worst_slot(word)[0] is Level.OK


def test_a_failure_that_outlasts_a_hold_is_reported_again() -> None:
    """After a hold, the ground must not rely on the failure that was reported before it."""
    builder = StatusTextBuilder(1)
    bad = replace(unit("container/ros_app", Slot.CONTAINER, Level.ERROR, brief="ros_app exited"), fault="ab12-1")
    builder.fault(opened(bad))
    first = builder.transition(transition(bad))
    builder.transition(transition(replace(HELD, fault="ab12-1"), Level.ERROR))
    again = builder.transition(transition(bad, Level.STALE))
    assert [line.text for line in first] == [line.text for line in again] == ["A01 FAIL 2 ros_app exited"]


def test_the_ground_shows_a_hold_and_its_end() -> None:
    """From the line that begins it, and from each refresh."""
    ground = Ground()

    def how() -> tuple[str, bool]:
        agent = ground.store.snapshot(ground.clock.stamp())["agents"][0]
        return agent["how"], agent["on_hold"]

    ground.receive(phm_heartbeat(1, {Slot.CONTAINER: Level.STALE}))
    assert how() == ("OK", False)
    ground.receive(text_frame(1, "A01 HOLD 2 ros_app 20 min: new firmware", 5))
    assert how() == ("HOLD", True)
    ground.receive(text_frame(1, "A01 HOLD 1-111111 2 ros_app on hold", 6))
    assert how() == ("HOLD", True)
    ground.receive(phm_heartbeat(1, {Slot.CONTAINER: Level.STALE, Slot.NODES: Level.ERROR}))
    assert how() == ("ERROR", True)
    ground.receive(
        phm_heartbeat(1), text_frame(1, "A01 HOLD 2 ros_app released", 5), text_frame(1, "A01 OK 11111111", 6)
    )
    assert how() == ("OK", False)
