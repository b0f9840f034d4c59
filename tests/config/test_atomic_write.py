"""A replaced configuration: no other group can read it than before. (That it is complete: tests/runtime/test_delivery.py.)"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

from phm.config.atomic_write import replace

STRANGER, GROUP = 65534, 4242


@pytest.mark.parametrize(("groups", "kept", "mode"), [([GROUP], GROUP, 0o640), ([], STRANGER, 0o600)])
def test_no_other_group_can_read_it(groups: list[int], kept: int, mode: int) -> None:
    """PHM's user cannot keep the owner, but the group if it is a member; else its own group must not get the permissions."""
    assert os.geteuid() == 0, "this test becomes another user: run it as root"
    mine = os.getgroups()
    with tempfile.TemporaryDirectory() as folder:  # tmp_path is for root alone
        os.chmod(folder, 0o777)
        file = Path(folder, "phm.yaml")
        file.write_text("old")
        os.chown(file, 0, GROUP)
        file.chmod(0o640)
        os.setgroups(groups)
        os.setegid(STRANGER)
        os.seteuid(STRANGER)
        try:
            replace(file, b"new")
        finally:
            os.seteuid(0)
            os.setegid(0)
            os.setgroups(mine)
        about = file.stat()
        assert (about.st_gid, about.st_mode & 0o777, file.read_text()) == (kept, mode, "new")
