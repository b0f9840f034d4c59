"""Units that evaluate nothing: `n/a`, and alone they leave their slot unused."""

from __future__ import annotations

import pytest

from phm.core.model import Level, Slot, worst_by_slot
from phm.wire import fleet_status, report, status_line, status_word
from tests.fakes.records import unit

RADIO = unit("radio/ground", Slot.RADIO, bypass=True)
COMPANION = unit("companion", Slot.COMPANION)


def test_a_slot_with_nothing_to_evaluate_is_unused() -> None:
    """As if the unit did not exist: in the word, the array and the slots of a report."""
    units = (COMPANION, unit("rates/a", Slot.RATES, bypass=True), RADIO)
    assert worst_by_slot(units) == {Slot.COMPANION: Level.OK}
    assert status_word.decode(status_word.encode(worst_by_slot(units))) == {Slot.COMPANION: Level.OK}
    assert report.status_array(units) == [1, *[None] * 7]
    assert report.report_json("agent_1", units)["slots"] == {"1": "OK"}
    assert status_line.refresh(1, units) == "A01 OK 1-------"


@pytest.mark.parametrize("level", [Level.OK, Level.WARN, Level.ERROR, Level.STALE])
def test_an_evaluated_unit_decides_its_slot(level: Level) -> None:
    """A unit beside it that evaluates nothing changes nothing."""
    units = (unit("gcs", Slot.COMPANION, bypass=True), unit("companion", Slot.COMPANION, level))
    assert worst_by_slot(units) == {Slot.COMPANION: level}


def test_an_unknown_slot_differs_from_an_unused_one() -> None:
    """STALE is among the slots of a report, and the refresh line names it."""
    units = (COMPANION, unit("rates/a", Slot.RATES, Level.STALE), RADIO)
    assert report.report_json("agent_1", units)["slots"] == {"1": "OK", "8": "STALE"}
    assert status_line.refresh(1, units) == "A01 STALE 1------- 8"


def test_only_an_ok_unit_can_be_not_applicable() -> None:
    """A problem or an unknown state is always reported."""
    assert report.unit_json(RADIO)["level"] == "n/a"
    assert report.unit_json(unit("radio/ground", Slot.RADIO, Level.STALE, bypass=True))["level"] == "STALE"


def test_a_path_that_was_never_used_is_not_known_to_the_fleet() -> None:
    """None; empty says that all hops are OK."""
    path = unit("path", Slot.AUTOPILOT, bypass=True)
    assert fleet_status.first_broken_hop([path]) is None
    assert fleet_status.first_broken_hop([unit("path", Slot.AUTOPILOT)]) == ""
