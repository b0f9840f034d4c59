"""Flights are numbered from armed to disarmed, over restarts of PHM."""

from __future__ import annotations

from pathlib import Path

import pytest

from phm.reporters.flights import NAME, FlightChange, FlightCounter


def test_a_flight_begins_armed_and_ends_disarmed(tmp_path: Path) -> None:
    """Once each; while the state is unknown nothing changes."""
    counter = FlightCounter(str(tmp_path))
    states = [None, False, True, True, None, True, False, False, True]
    changes = [counter.update(armed, float(now)) for now, armed in enumerate(states)]
    assert [change for change in changes if change] == [
        FlightChange(1, began=True),
        FlightChange(1, began=False, duration_s=4.0),
        FlightChange(2, began=True),
    ]
    assert changes[2] is not None and changes[2].text == "flight 1 began: the autopilot is armed"
    assert changes[6] is not None and changes[6].text == "flight 1 ended after 4 s: the autopilot is disarmed"


def test_a_restart_in_flight_continues_it(tmp_path: Path) -> None:
    """And one that was over when PHM started again has ended, after a time that is not known."""
    FlightCounter(str(tmp_path)).update(True, 0.0)
    assert FlightCounter(str(tmp_path)).update(None, 1.0) is None
    resumed = FlightCounter(str(tmp_path)).update(True, 2.0)
    assert resumed == FlightChange(1, began=True, continued=True)
    assert resumed is not None and resumed.text == "flight 1 continues: the autopilot is armed"
    ended = FlightCounter(str(tmp_path)).update(False, 3.0)
    assert ended == FlightChange(1, began=False)
    assert ended is not None and ended.text == "flight 1 ended: the autopilot is disarmed"
    assert FlightCounter(str(tmp_path)).update(True, 4.0) == FlightChange(2, began=True)


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[1]", b'{"number": -1, "open": false}', b'{"number": "x", "open": 1}']
)
def test_a_damaged_file_begins_at_one(tmp_path: Path, content: bytes) -> None:
    """A number is not worth a start that fails."""
    (tmp_path / NAME).write_bytes(content)
    assert FlightCounter(str(tmp_path)).update(True, 0.0) == FlightChange(1, began=True)


def test_without_a_place_for_the_number_flights_are_still_marked(tmp_path: Path) -> None:
    """In the log of this run."""
    (tmp_path / "file").write_text("in the way")
    counter = FlightCounter(str(tmp_path / "file"))
    assert counter.update(True, 0.0) == FlightChange(1, began=True)
    assert counter.update(False, 9.0) == FlightChange(1, began=False, duration_s=9.0)
