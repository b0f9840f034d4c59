"""`phm faults` with a log that cannot be read: it must not look like a log without faults."""

from __future__ import annotations

import errno
import gzip
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.core.clock import SystemClock
from phm.core.settings import Settings
from phm.reporters.status import StatusReporter
from phm.wire import json_log
from tests.cli.test_faults import DEAD, OPEN, RECOVERED, as_json, invoke, record
from tests.fakes.records import context, opened

JSON_LINE = b'{"event":"note","seq":1,"text":"a line that is long enough to be cut"}\n'


def damaged(file: Path) -> None:
    file.with_name(file.name + ".1.gz").write_bytes(b"this was never compressed")


def cut(file: Path) -> None:
    whole = gzip.compress(b"".join(b'{"seq":%d}\n' % number for number in range(1000)))
    file.with_name(file.name + ".1.gz").write_bytes(whole[:20])


def directory(file: Path) -> None:
    file.mkdir()


def fifo(file: Path) -> None:
    os.mkfifo(file)


def foreign(file: Path) -> None:
    file.write_bytes(b"\x89PNG\n not a log\n")


def denied(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """As for a user who may not read the file; root may, and tests may run as root."""
    opening = Path.open

    def no_open(self: Path, *words: Any, **more: Any) -> Any:
        if self.name == name:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self))
        return opening(self, *words, **more)

    monkeypatch.setattr(Path, "open", no_open)


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (damaged, "phm.jsonl.1.gz: damaged or unreadable: Not a gzipped file"),
        (cut, "phm.jsonl.1.gz: damaged or unreadable: Compressed file ended"),
        (directory, "phm.jsonl: not a regular file"),
        (fifo, "phm.jsonl: not a regular file"),
        (foreign, "2 lines are incomplete or not JSON"),
    ],
)
def test_a_log_that_cannot_be_read_is_not_one_without_faults(
    make: Callable[[Path], None], why: str, tmp_path: Path
) -> None:
    """Exit code 1, with the reason, and no list. A pipe does not block."""
    (tmp_path / "log").mkdir()
    make(tmp_path / "log" / "phm.jsonl")
    for words in ((), ("--json",)):
        shown = invoke(tmp_path, *words)
        assert (shown.exit_code, shown.stdout) == (1, "")
        assert why in shown.stderr and "nothing in the log" in shown.stderr, shown.stderr


def test_a_log_without_permission_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that root wrote, read by another user."""
    record(tmp_path, *OPEN)
    denied(monkeypatch, "phm.jsonl")
    shown = invoke(tmp_path)
    assert (shown.exit_code, shown.stdout) == (1, "")
    assert "phm.jsonl: damaged or unreadable: Permission denied" in shown.stderr


def test_a_log_in_a_folder_without_permission_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence, no traceback."""
    record(tmp_path, *OPEN)

    def no_stat(path: object) -> list[Path]:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(json_log, "files", no_stat)
    shown = invoke(tmp_path)
    assert (shown.exit_code, shown.stdout) == (1, "")
    assert f"the log in {tmp_path / 'log'} cannot be read: Permission denied" in shown.stderr


@pytest.mark.parametrize(("make", "why"), [(damaged, "phm.jsonl.1.gz"), (cut, "phm.jsonl.1.gz")])
def test_what_can_be_read_of_a_log_is_shown(make: Callable[[Path], None], why: str, tmp_path: Path) -> None:
    """The damage is named on stderr, and the list is that of the rest."""
    record(tmp_path, *RECOVERED)
    make(tmp_path / "log" / "phm.jsonl")
    shown = invoke(tmp_path)
    assert shown.exit_code == 0 and "ab12-1" in shown.stdout and why in shown.stderr


def test_open_faults_are_shown_when_the_log_cannot_be_read(tmp_path: Path) -> None:
    """They are those of the running daemon; the exit code says that the log is missing."""
    parts = context(Settings(run_dir=str(tmp_path / "run")), clock=SystemClock(), states=lambda: (DEAD,))
    status = StatusReporter.build(parts)
    status.handle(opened(DEAD, "ab12-3"))
    status.tick()
    (tmp_path / "log").mkdir()
    damaged(tmp_path / "log" / "phm.jsonl")
    shown = invoke(tmp_path)
    assert shown.exit_code == 1 and "ab12-3" in shown.stdout and "nothing in the log" in shown.stderr


def test_an_empty_log_has_no_faults(tmp_path: Path) -> None:
    """As after a power cut in the first seconds: it could be read."""
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "phm.jsonl").touch()
    assert as_json(tmp_path)["faults"] == []
    assert invoke(tmp_path).stderr == ""


def test_a_pipe_among_the_files_of_a_log_is_skipped(tmp_path: Path) -> None:
    """`phm.wire.json_log.read` does not wait for its other end."""
    os.mkfifo(tmp_path / "phm.jsonl.1")
    (tmp_path / "phm.jsonl").write_bytes(JSON_LINE)
    assert [event["seq"] for event in json_log.read(tmp_path)] == [1]


def test_logs_name_damaged_files_in_the_same_words(tmp_path: Path) -> None:
    """`phm logs` and `phm faults` read with the same code."""
    (tmp_path / "log").mkdir()
    damaged(tmp_path / "log" / "phm.jsonl")
    said = CliRunner().invoke(group, ["logs", str(tmp_path / "log")]).stderr.splitlines()[0]
    assert said in invoke(tmp_path).stderr
