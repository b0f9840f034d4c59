"""Groups of `phm doctor` run side by side, and none can hide the others."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

from phm.doctor.context import DoctorContext
from phm.doctor.examination import GROUPS, examine
from phm.doctor.row import Row, ok
from tests.doctor.places import doctor_context
from tests.fakes.until import until


def fine(_: DoctorContext) -> Iterator[Row]:
    yield ok("fine", "fine")


def test_a_group_that_hangs_or_fails_has_one_row(tmp_path: Path) -> None:
    """The deadline is for all groups together."""
    never = threading.Event()

    def hangs(_: DoctorContext) -> Iterator[Row]:
        never.wait()
        yield ok("late", "late")

    def fails(_: DoctorContext) -> Iterator[Row]:
        yield ok("first", "first")
        raise RuntimeError("broken")

    def examined() -> dict[str, list[Row]] | None:
        """None: the machine let the threads of the other groups wait for all of the time, too."""
        found = examine(doctor_context(tmp_path), {"a": hangs, "b": fails, "c": fine}, limit_s=0.2)
        late = [group for group, rows in found.items() if rows[0].text.startswith("not known within")]
        return found if late == ["a"] else None

    try:
        found: dict[str, list[Row]] = until(examined, "the groups that end")
    finally:
        never.set()
    assert {group: [(row.name, row.state) for row in rows] for group, rows in found.items()} == {
        "a": [("answer", "limited")],
        "b": [("answer", "limited")],
        "c": [("fine", "ok")],
    }
    assert "broken" in found["b"][0].text and "0.2 s" in found["a"][0].text


def test_every_row_that_is_not_ok_has_a_remedy(tmp_path: Path) -> None:
    """On a machine with nothing: no engine, no devices, no folders, no configuration."""
    found = examine(doctor_context(tmp_path), limit_s=120.0)
    assert list(found) == list(GROUPS)
    assert [row for rows in found.values() for row in rows if row.state != "ok" and not row.remedy] == []
    assert not any(row.text.startswith("not known within") for rows in found.values() for row in rows)
