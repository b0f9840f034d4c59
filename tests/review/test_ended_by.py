"""What ended a fault: only an action that was begun for it is credited, and only an end that was observed has a time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from phm.core.model import ActionEvent, Fault, FaultClosed, FaultOpened, Level, Outcome, Phase, Transition
from tests.review.records import Flown, flown, report


def fail(made: Flown, by: str, lasts: float) -> None:
    """A fault for which a `reopen` was begun in vain, and that something else ended."""
    name = "nodes/node_1"
    state = made._state(name, Level.ERROR, "gone", "gone")
    opened = Fault("f1", name, state.slot, state.layer, state.result, made.at)
    made.log.handle(FaultOpened(made.at, opened))
    made.log.handle(Transition(made.at, Level.OK, replace(state, fault=opened.id)))
    for phase in (Phase.STARTED, Phase.FAILED):
        made.log.handle(ActionEvent(made.at, opened.id, name, "reopen", "link:ap", phase, "reopen"))
    made._advance(lasts)
    made.log.handle(Transition(made.at, Level.ERROR, made._state(name, Level.OK)))
    made.log.handle(FaultClosed(made.at, replace(opened, closed=made.at, outcome=Outcome.RESOLVED, by=by)))


@pytest.mark.parametrize(
    ("by", "credited", "mttr_s"),
    [
        ("reopen", 1, 20.0),
        ("restart", 0, 20.0),
        ("reboot", 0, 20.0),
        ("timeout", 0, None),
        ("configuration", 0, None),
    ],
)
def test_only_an_action_that_was_begun_is_credited(
    tmp_path: Path, by: str, credited: int, mttr_s: float | None
) -> None:
    """The end of a fault whose unit was not observed again says nothing about its duration."""
    with flown(tmp_path) as made:
        made.until(100)
        fail(made, by, 20.0)
        made.until(300)
    document = report(tmp_path)
    (row,) = (row for row in document["checks"] if row["faults"])
    assert (row["resolved"], row["by_action"], row["mttr_s"]) == (1, credited, mttr_s)
    assert f"{credited} ended by an action of PHM and {1 - credited} otherwise" in document["sentences"][1]
    assert ("on average" in document["sentences"][1]) is (mttr_s is not None)
