"""`phm doctor`: serial ports and configured devices."""

from __future__ import annotations

from pathlib import Path

from phm.doctor.devices import rows
from tests.doctor.places import doctor_context, states


def test_serial_ports_and_missing_devices_are_listed(tmp_path: Path) -> None:
    """A configured device that does not exist is limited."""
    there = doctor_context(tmp_path, containers=[{"name": "app", "devices": [{"path": "/dev/ttyACM9"}]}])
    (tmp_path / "dev" / "ttyUSB0").symlink_to("/dev/null")
    assert states(list(rows(there))) == {"/dev/ttyUSB0": "ok", "/dev/ttyACM9": "limited"}


def test_no_serial_port_is_not_a_defect(tmp_path: Path) -> None:
    """Many agents reach their autopilot by IP."""
    assert states(list(rows(doctor_context(tmp_path)))) == {"serial ports": "ok"}


def test_a_missing_folder_of_devices_is_missing(tmp_path: Path) -> None:
    """PHM_DEV_ROOT names the mount of the host's /dev."""
    there = doctor_context(tmp_path, environ={"PHM_DEV_ROOT": str(tmp_path / "host-dev")})
    assert states(list(rows(there))) == {"folder": "missing"}
