"""Which fault belongs to which injection, in Table 2 of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.review.records import Flown, report

NODE = "node_killed: nodes/node_1"


def injected(folder: Path, *notes: tuple[float, str]) -> Flown:
    """An agent with INJECT notes at these seconds."""
    made = Flown(folder)
    for at_s, words in notes:
        made.until(at_s)
        made.note(f"INJECT {words}")
    return made


def table(made: Flown, folder: Path) -> list[Any]:
    """The fault of each injection, in order."""
    made.until(made.now + 20)
    made.close()
    return [one["fault"] for one in report(folder)["injection_metrics"]["injections"]]


def test_injections_that_follow_each_other_get_the_faults_that_their_notes_name(tmp_path: Path) -> None:
    """The alarm of the first comes after the note of the second."""
    made = injected(tmp_path, (50, NODE), (51, "container_killed: container/ros_app"))
    second = made.fail("container/ros_app", lasts=2.0)
    first = made.fail("nodes/node_1", lasts=2.0)
    assert table(made, tmp_path) == [first, second]


def test_a_fault_that_another_note_names_is_not_taken_instead(tmp_path: Path) -> None:
    """The second injection was not detected; the first one's alarm came late."""
    made = injected(tmp_path, (50, NODE), (51, "container_killed: container/ros_app"))
    first = made.fail("nodes/node_1", lasts=2.0)
    assert table(made, tmp_path) == [first, None]


def test_a_fault_belongs_to_the_last_note_that_names_it(tmp_path: Path) -> None:
    """The first of two equal injections was not detected."""
    made = injected(tmp_path, (50, NODE), (60, NODE))
    second = made.fail("nodes/node_1", lasts=2.0)
    assert table(made, tmp_path) == [None, second]


def test_a_fault_long_after_the_next_note_is_another_one(tmp_path: Path) -> None:
    """Without a bound, each later fault of the unit would count as detected."""
    made = injected(tmp_path, (50, NODE), (60, "battery"))
    made.until(91)
    made.fail("nodes/node_1", lasts=2.0)
    assert table(made, tmp_path)[0] is None
