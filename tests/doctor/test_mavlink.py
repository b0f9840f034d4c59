"""`phm doctor`: endpoints of the configuration."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest

from phm.doctor import mavlink
from phm.doctor.context import DoctorContext
from phm.doctor.mavlink import rows
from phm.doctor.row import Row
from tests.doctor.places import doctor_context


def judged(there: Path, url: str, **more: Any) -> tuple[Row, DoctorContext]:
    found = doctor_context(there, mavlink={"endpoints": [{"url": url}]}, **more)
    (only,) = rows(found)
    return only, found


def test_a_port_in_use_is_missing_with_the_command_that_finds_the_program(tmp_path: Path) -> None:
    """When the port is free again, the row is ok."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        url = f"udpin:127.0.0.1:{taken.getsockname()[1]}"
        used, _ = judged(tmp_path, url)
    free, _ = judged(tmp_path, url)
    assert (used.state, free.state) == ("missing", "ok") and "ss -lntup" in used.remedy


def test_the_loopback_of_a_bridged_container_leads_nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the host's network it is another program of the machine."""
    monkeypatch.setattr(mavlink, "is_private", lambda: False)
    outside, there = judged(tmp_path, "udpout:127.0.0.1:14550")
    monkeypatch.setattr(mavlink, "is_private", lambda: True)
    (inside,) = rows(there)
    assert (outside.state, inside.state) == ("ok", "limited") and "own container" in inside.text


def test_who_reaches_a_waiting_endpoint_of_a_bridged_container_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a defect: a router may be in a container beside it. On the host's network any program reaches it."""
    monkeypatch.setattr(mavlink, "is_private", lambda: True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("0.0.0.0", 0))
        port = free.getsockname()[1]
    inside, there = judged(tmp_path, f"udpin:0.0.0.0:{port}")
    alone, _ = judged(tmp_path, f"udpin:127.0.0.1:{port}")
    monkeypatch.setattr(mavlink, "is_private", lambda: False)
    (outside,) = rows(there)
    assert (inside.state, outside.state) == ("ok", "ok")
    assert "`ports:` of its Compose file" in inside.text and "Compose" not in outside.text
    assert alone.state == "limited" and alone.remedy == f"write udpin:0.0.0.0:{port}"


@pytest.mark.parametrize(
    ("host", "remedy"),
    [("host.docker.internal", 'extra_hosts: ["host.docker.internal:host-gateway"]'), ("gcs", "correct")],
)
def test_a_name_that_is_not_known_has_a_remedy(
    host: str, remedy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name of the host needs a line in the Compose file; any other one may be wrong."""

    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    found, _ = judged(tmp_path, f"udpout:{host}:14551")
    assert found.state == "missing" and remedy in found.remedy


def test_a_serial_port_must_exist(tmp_path: Path) -> None:
    """A missing port has the remedy to map the device into the container."""
    absent, _ = judged(tmp_path, str(tmp_path / "ttyACM0"))
    assert absent.state == "missing" and "devices:" in absent.remedy
    (tmp_path / "ttyACM0").touch()
    assert judged(tmp_path, str(tmp_path / "ttyACM0"))[0].state == "ok"


def test_a_serial_port_may_be_in_the_mount_of_the_hosts_devices(tmp_path: Path) -> None:
    """As PHM opens it where `device_cgroup_rules` permit it."""
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev" / "phm-no-such-port").touch()
    assert judged(tmp_path, "/dev/phm-no-such-port")[0].state == "ok"


def test_no_endpoint_is_said(tmp_path: Path) -> None:
    """A configuration without endpoints is valid, and the row says so."""
    (only,) = rows(doctor_context(tmp_path))
    assert only.state == "ok" and "none configured" in only.text
