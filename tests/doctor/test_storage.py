"""`phm doctor`: folders that PHM writes to."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from phm.doctor.storage import rows
from tests.doctor.places import doctor_context, row, states


def test_writable_folders_are_ok(tmp_path: Path) -> None:
    """The folders of log and state need no remedy if PHM can write to them."""
    (tmp_path / "log").mkdir()
    (tmp_path / "state").mkdir()
    assert states(list(rows(doctor_context(tmp_path)))) == {"log": "ok", "state": "ok"}


def test_a_missing_folder_is_missing_once_it_is_configured(tmp_path: Path) -> None:
    """Without a configuration it is limited: PHM may be set up later."""
    there = doctor_context(tmp_path)
    assert states(list(rows(there))) == {"log": "limited", "state": "limited"}
    there.configuration = "phm.yaml"
    assert states(list(rows(there))) == {"log": "missing", "state": "missing"}


def test_a_disk_without_room_for_the_log_is_limited(tmp_path: Path) -> None:
    """Less free space than `log.max_size` needs."""
    (tmp_path / "log").mkdir()
    there = doctor_context(tmp_path, log={"directory": str(tmp_path / "log"), "max_size": 1e18})
    assert row(list(rows(there)), "log").state == "limited"


def test_a_folder_that_cannot_be_written_is_given_to_phm_on_the_host(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In PHM's container no one may change the owner, and the folder has another name on the host."""
    (tmp_path / "log").mkdir()
    monkeypatch.setattr(os, "access", lambda *_: False)
    there = doctor_context(tmp_path)
    assert row(list(rows(there)), "log").remedy == f"chown {os.geteuid()} {tmp_path / 'log'}"
    there.container_mark.touch()
    found = row(list(rows(there)), "log")
    assert found.state == "missing" and found.remedy.startswith("on the host: `sudo chown -R ")
    assert found.remedy.endswith(f"mounts at {tmp_path / 'log'}")


def test_a_configuration_that_no_delivery_can_replace_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder that PHM cannot write, and mounted as a single file; not asked where nothing can be delivered."""
    there = doctor_context(tmp_path, delivery={"listen": "127.0.0.1:9465", "key": "/etc/phm/delivery.key"})
    assert "delivery" not in states(list(rows(there)))
    there.configuration = str(tmp_path / "phm.yaml")
    assert row(list(rows(there)), "delivery").state == "ok"
    monkeypatch.setattr(os.path, "ismount", lambda path: path == there.configuration)
    assert "mounted alone" in row(list(rows(there)), "delivery").text
    monkeypatch.undo()
    monkeypatch.setattr(os, "access", lambda path, mode: path != str(tmp_path))
    refused = row(list(rows(there)), "delivery")
    assert refused.state == "limited" and f"make {tmp_path} writable" in refused.remedy
    assert "docker/compose.deliver.yaml" in refused.remedy
    plain = doctor_context(tmp_path)
    plain.configuration = there.configuration
    assert "delivery" not in states(list(rows(plain)))
