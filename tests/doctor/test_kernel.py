"""`phm doctor`: features of the kernel."""

from __future__ import annotations

from pathlib import Path

import pytest

from phm.doctor import kernel
from tests.doctor.places import doctor_context, row, states


def kernel_of(folder: Path, *, watches: int = 65536, instances: int = 128, psi: bool = True) -> None:
    """Files of /proc in `folder`."""
    inotify = folder / "sys" / "fs" / "inotify"
    inotify.mkdir(parents=True)
    (inotify / "max_user_watches").write_text(f"{watches}\n")
    (inotify / "max_user_instances").write_text(f"{instances}\n")
    if psi:
        (folder / "pressure").mkdir()
        (folder / "pressure" / "cpu").write_text("some avg10=0.00\n")


def test_a_current_kernel_is_ok(tmp_path: Path) -> None:
    """The restriction of the ROS child is tried for real, in a separate process."""
    there = doctor_context(tmp_path)
    kernel_of(there.proc)
    (tmp_path / "cgroup").mkdir()
    (tmp_path / "cgroup" / "cgroup.controllers").touch()
    found = states(list(kernel.rows(there)))
    assert found.pop("Landlock, seccomp") in ("ok", "limited")
    assert set(found.values()) == {"ok"}


def test_features_that_an_old_kernel_lacks_are_limited_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """cgroup v2, PSI, Landlock and enough inotify watches: PHM runs without them."""
    monkeypatch.setattr(kernel, "_SANDBOX", "print('files: no Landlock (not supported)')")
    monkeypatch.setattr(kernel, "CHILD_LIMIT_S", 60.0)
    there = doctor_context(tmp_path)
    kernel_of(there.proc, watches=100, psi=False)
    (tmp_path / "cgroup" / "cpu").mkdir(parents=True)
    found = list(kernel.rows(there))
    limited = [one for one in found if one.state == "limited"]
    assert [one.name for one in limited] == ["cgroups", "PSI", "Landlock, seccomp", "inotify"]
    assert all(one.remedy for one in limited)
    assert "no Landlock" in row(found, "Landlock, seccomp").text


def test_unmounted_cgroups_are_limited(tmp_path: Path) -> None:
    """PHM then asks the engine for statistics."""
    there = doctor_context(tmp_path)
    assert "engine for statistics" in row(list(kernel.rows(there)), "cgroups").text
