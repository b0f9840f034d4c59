"""`phm doctor`: the clock."""

from __future__ import annotations

from pathlib import Path

import pytest

from phm.doctor import clock
from tests.doctor.places import doctor_context, row


@pytest.mark.parametrize(("synchronized", "state"), [(True, "ok"), (False, "limited"), (None, "limited")])
def test_a_clock_is_ok_only_when_it_is_synchronized(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, synchronized: bool | None, state: str
) -> None:
    """Also a state that is not known is limited."""
    monkeypatch.setattr(clock, "clock_synchronized", lambda: synchronized)
    found = list(clock.rows(doctor_context(tmp_path)))
    assert row(found, "time").state == state
    assert row(found, "boot").state == "ok"


def test_a_clock_without_a_battery_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A date before the first possible year means that the clock was never set."""
    monkeypatch.setattr(clock, "FIRST_YEAR", 9999)
    assert "is wrong" in row(list(clock.rows(doctor_context(tmp_path))), "time").text
