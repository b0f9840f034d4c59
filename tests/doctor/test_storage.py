"""`phm doctor`: folders that PHM writes to."""

from __future__ import annotations

from pathlib import Path

from phm.doctor.storage import rows
from tests.doctor.places import row, states, surroundings


def test_writable_folders_are_ok(tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    (tmp_path / "state").mkdir()
    assert states(list(rows(surroundings(tmp_path)))) == {"log": "ok", "state": "ok"}


def test_a_missing_folder_is_missing_once_it_is_configured(tmp_path: Path) -> None:
    there = surroundings(tmp_path)
    assert states(list(rows(there))) == {"log": "limited", "state": "limited"}
    there.configuration = "phm.yaml"
    assert states(list(rows(there))) == {"log": "missing", "state": "missing"}


def test_a_disk_without_room_for_the_log_is_limited(tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    there = surroundings(tmp_path, log={"directory": str(tmp_path / "log"), "max_size": 1e18})
    assert row(list(rows(there)), "log").state == "limited"
