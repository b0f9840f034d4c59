"""Programs that use a serial port."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

from phm.probes.serial_port_users import users
from tests.fakes.until import until


def test_users_of_a_port_are_named(tmp_path: Path) -> None:
    """Another program by name and pid; PHM itself is omitted; a symlink to the port is resolved."""
    far, near = pty.openpty()
    path = os.ttyname(near)
    named = tmp_path / "by-id"
    named.symlink_to(path)
    code = f"import os; os.open({path!r}, os.O_RDWR | os.O_NOCTTY); print('open', flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"open\n"
        found = users(str(named))
        assert len(found) == 1
        assert found[0].endswith(f"({other.pid})")
        assert "python" in found[0]
        other.communicate(b"\n")
    until(lambda: not users(path), "the port to be free")
    os.close(far)
    os.close(near)


def test_inaccessible_processes_are_skipped(tmp_path: Path) -> None:
    """Processes that terminate meanwhile, or belong to other users, raise nothing."""
    (tmp_path / "1").mkdir()
    (tmp_path / "2" / "fd").mkdir(parents=True)
    (tmp_path / "2" / "fd" / "0").write_text("no link")
    (tmp_path / "self").mkdir()
    assert users("/dev/ttyUSB0", tmp_path) == ()
