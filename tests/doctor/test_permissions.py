"""`phm doctor`: groups of PHM's user."""

from __future__ import annotations

import os
import pwd
from pathlib import Path

import pytest

from phm.doctor.permissions import group_name, rows
from tests.doctor.places import doctor_context, row


def test_a_socket_that_may_not_be_opened_names_the_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a container the remedy is a line of the compose file, else a command for the user of PHM."""
    (tmp_path / "engine.sock").touch()
    group = os.getegid() or 4242
    os.chown(tmp_path / "engine.sock", -1, group)
    monkeypatch.setattr(os, "access", lambda *_: False)
    there = doctor_context(tmp_path, docker={"socket": f"unix://{tmp_path}/engine.sock"})
    found = row(list(rows(there)), "socket")
    user = pwd.getpwuid(os.geteuid()).pw_name
    assert found.state == "missing" and f"usermod -aG {group_name(group)} {user}," in found.remedy
    there.container_mark.touch()
    assert f'add "{group}" to group_add' in row(list(rows(there)), "socket").remedy


def test_a_socket_of_the_group_of_root_needs_the_group_docker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No one should join the group of root. PHM's container may: it has nothing else of this group."""
    monkeypatch.setattr(os, "access", lambda *_: False)
    there = doctor_context(tmp_path, docker={"socket": "unix:///etc/passwd"})
    assert "sudo groupadd docker" in row(list(rows(there)), "socket").remedy
    there.container_mark.touch()
    assert 'add "0" to group_add' in row(list(rows(there)), "socket").remedy


def test_a_socket_that_may_be_opened_is_ok(tmp_path: Path) -> None:
    """Permission alone: whether an engine answers is another row."""
    (tmp_path / "engine.sock").touch()
    there = doctor_context(tmp_path, docker={"socket": f"unix://{tmp_path}/engine.sock"})
    assert row(list(rows(there)), "socket").state == "ok"


def test_no_socket_is_missing(tmp_path: Path) -> None:
    """A missing Unix socket is a defect; an engine over TCP needs none."""
    assert row(list(rows(doctor_context(tmp_path))), "socket").state == "missing"
    remote = doctor_context(tmp_path, docker={"socket": "tcp://10.0.0.1:2375"})
    assert row(list(rows(remote)), "socket").state == "ok"


def test_the_group_of_the_port_of_an_endpoint_is_compared(tmp_path: Path) -> None:
    """/dev/ttyS0 is listed for no other reason."""
    there = doctor_context(tmp_path, mavlink={"endpoints": [{"url": "/dev/ttyS0"}]})
    (tmp_path / "dev" / "ttyS0").symlink_to("/dev/null")
    assert "/dev/ttyS0" in next(one.text for one in rows(there) if one.name.startswith("group "))


def test_the_group_of_a_serial_port_is_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Root needs no group."""
    there = doctor_context(tmp_path)
    (tmp_path / "dev" / "ttyUSB0").symlink_to("/dev/null")
    monkeypatch.setattr(os, "geteuid", lambda: 10001)
    monkeypatch.setattr(os, "getegid", lambda: 10001)
    monkeypatch.setattr(os, "getgroups", lambda: [10001])
    port = next(one for one in rows(there) if one.name.startswith("group "))
    assert port.state == "limited" and "/dev/ttyUSB0" in port.text
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert next(one for one in rows(there) if one.name.startswith("group ")).state == "ok"
