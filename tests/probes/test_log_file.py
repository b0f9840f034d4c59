"""Following a real file through all that happens to log files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.facts import CannotTell
from phm.probes.log_file import READ_BYTES, LogFile


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = tmp_path / "app.log"
    made.write_text("old\n")
    return made


@pytest.fixture
def file(path: Path) -> Iterator[LogFile]:
    made = LogFile(str(path))
    assert made.read() == (b"", 0)
    yield made
    made.close()


def append(path: Path, text: str) -> None:
    with path.open("a") as log:
        log.write(text)


def test_only_what_was_written_since_is_read(path: Path, file: LogFile) -> None:
    """Not what was there before PHM."""
    append(path, "one\ntwo\n")
    assert file.read() == (b"one\ntwo\n", 0)
    assert file.read() == (b"", 0)


def test_a_line_is_read_when_it_is_complete(path: Path, file: LogFile) -> None:
    """A pattern may be in both halves."""
    append(path, "one\nhal")
    assert file.read() == (b"one\n", 0)
    append(path, "f\n")
    assert file.read() == (b"half\n", 0)


def test_rotation_loses_no_line(path: Path, file: LogFile) -> None:
    """The rest of the old file is read, then the new one from its start."""
    append(path, "last\n")
    path.rename(path.with_suffix(".1"))
    path.write_text("first\n")
    assert file.read() == (b"last\nfirst\n", 0)
    append(path, "second\n")
    assert file.read() == (b"second\n", 0)


def test_a_truncated_file_is_read_from_its_start(path: Path, file: LogFile) -> None:
    """As `copytruncate` of logrotate leaves it."""
    append(path, "a long line that is gone\n")
    file.read()
    os.truncate(path, 0)
    append(path, "new\n")
    assert file.read() == (b"new\n", 0)


def test_a_file_that_is_gone_is_unknown_and_read_when_it_is_back(path: Path, file: LogFile) -> None:
    """From its start: all of it is new."""
    path.unlink()
    with pytest.raises(CannotTell, match="No such file"):
        file.read()
    path.write_text("back\n")
    assert file.read() == (b"back\n", 0)


def test_a_file_that_comes_after_phm_is_read_from_its_start(tmp_path: Path) -> None:
    """The application starts later."""
    file = LogFile(str(tmp_path / "late.log"))
    with pytest.raises(CannotTell):
        file.read()
    (tmp_path / "late.log").write_text("first\n")
    assert file.read() == (b"first\n", 0)
    file.close()


def test_of_much_text_the_newest_is_read(path: Path, file: LogFile) -> None:
    """Memory and time are bounded; what was left out is counted."""
    append(path, "x\n" * READ_BYTES + "end\n")
    data, skipped = file.read()
    assert data.endswith(b"end\n") and len(data) <= READ_BYTES
    assert skipped == READ_BYTES * 2 + 4 - READ_BYTES


def test_a_pipe_is_not_read(tmp_path: Path) -> None:
    """It is not opened for long: a reader changes what its writer does."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(CannotTell, match="not an ordinary file"):
        LogFile(str(tmp_path / "pipe")).read()


def test_a_link_is_followed_within_its_folder_only(tmp_path: Path) -> None:
    """An application can replace its log by a link to a file that only PHM may read."""
    (tmp_path / "logs").mkdir()
    (tmp_path / "secret").write_text("key\n")
    (tmp_path / "logs" / "2026.log").write_text("old\n")
    link = tmp_path / "logs" / "latest.log"
    link.symlink_to("2026.log")
    file = LogFile(str(link))
    assert file.read() == (b"", 0)
    append(tmp_path / "logs" / "2026.log", "new\n")
    assert file.read() == (b"new\n", 0)
    link.unlink()
    link.symlink_to(tmp_path / "secret")
    with pytest.raises(CannotTell, match="out of its folder"):
        file.read()
    file.close()
