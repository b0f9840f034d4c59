"""Writing the folder of `phm init`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from phm.setup.folder import FilesExist, make_log_folder, write


def test_files_are_readable_whatever_the_umask(tmp_path: Path) -> None:
    """PHM's user in the container is another one."""
    old = os.umask(0o077)
    try:
        write(tmp_path / "new" / "folder", {"phm.yaml": "a", "compose.yaml": "b"}, force=False)
    finally:
        os.umask(old)
    folder = tmp_path / "new" / "folder"
    assert sorted(path.name for path in folder.iterdir()) == ["compose.yaml", "phm.yaml"]
    assert [(folder / name).stat().st_mode & 0o777 for name in ("compose.yaml", "phm.yaml")] == [0o644, 0o644]
    assert folder.stat().st_mode & 0o555 == 0o555


@pytest.mark.parametrize(("user", "given"), [(0, True), (1000, False)])
def test_what_root_writes_belongs_to_the_owner_of_the_place(
    user: int, given: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A container or sudo writes into the home of a user, who edits the files later; another user changes no owner."""
    owners: dict[str, tuple[int, int]] = {}
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(
        os, "chown", lambda path, uid, gid, **_: owners.update({str(Path(path).relative_to(tmp_path)): (uid, gid)})
    )
    write(tmp_path / "new" / "phm", {"phm.yaml": "a"}, force=False)
    place = tmp_path.stat()
    names = ["new", "new/phm", "new/phm/phm.yaml"] if given else []
    assert owners == dict.fromkeys(names, (place.st_uid, place.st_gid))


def test_nothing_is_overwritten_without_force(tmp_path: Path) -> None:
    """One file that exists keeps all others from being written."""
    (tmp_path / "phm.yaml").write_text("mine")
    with pytest.raises(FilesExist, match=r"already has phm\.yaml.*--force"):
        write(tmp_path, {"compose.yaml": "b", "phm.yaml": "a"}, force=False)
    assert not (tmp_path / "compose.yaml").exists()
    write(tmp_path, {"compose.yaml": "b", "phm.yaml": "a"}, force=True)
    assert (tmp_path / "phm.yaml").read_text() == "a"


def test_the_log_folder_can_be_written_by_the_user_of_the_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where this process may not change the owner, everyone may write."""

    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "chown", refuse)
    assert make_log_folder(tmp_path / "logs")
    assert (tmp_path / "logs").stat().st_mode & 0o7777 == 0o1777


def test_a_log_folder_that_exists_keeps_its_owner_and_mode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--logs /var/log` must not lock other services out."""
    changed: list[object] = []
    monkeypatch.setattr(os, "chown", lambda *words: changed.append(words))
    tmp_path.chmod(0o750)
    assert not make_log_folder(tmp_path)
    assert (changed, tmp_path.stat().st_mode & 0o7777) == ([], 0o750)
