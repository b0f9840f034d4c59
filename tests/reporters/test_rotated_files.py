"""Compressed files of a log: nothing is lost or read twice, whatever happens in between."""

from __future__ import annotations

import gzip
import json
import os
import threading
from pathlib import Path

import pytest

from phm.reporters import rotated_files
from phm.reporters.rotating_file import RotatingFile
from phm.testing import FakeClock
from phm.wire import json_log
from tests.fakes.until import until


def make(path: Path, *, max_size: int = 10_000, files: int = 3) -> RotatingFile:
    return RotatingFile(
        str(path), max_size=max_size, files=files, clock=FakeClock(), lost_line=lambda *_: b"lost", compress=True
    )


def line(number: int) -> bytes:
    return json.dumps({"seq": number, "text": f"{number} " * 20}).encode()


def numbers(path: Path) -> list[int]:
    return [event["seq"] for event in json_log.read(path)]


def plain(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir() if not entry.name.endswith(".gz"))


def compressed(folder: Path) -> None:
    """Wait until all rotated files are."""
    until(lambda: plain(folder) == ["phm.jsonl"], "the compression")


def test_rotated_files_are_compressed_and_read_back(tmp_path: Path) -> None:
    """In order and completely, also while they are written."""
    path = tmp_path / "phm.jsonl"
    log = make(path)
    for number in range(600):
        log.write(line(number))
        if number % 50 == 0:
            assert numbers(path) == list(range(number + 1))
            compressed(tmp_path)
    compressed(tmp_path)
    assert numbers(path) == list(range(600))
    log.close()
    assert len(list(tmp_path.iterdir())) > 3, "more files than without compression"


def test_as_many_files_are_kept_as_fit(tmp_path: Path) -> None:
    """All together stay below the limit, and the newest lines are there without a gap."""
    path = tmp_path / "phm.jsonl"
    log = make(path, max_size=2000, files=2)
    for number in range(600):
        log.write(line(number))
        if number % 10 == 0:
            compressed(tmp_path)
            assert sum(entry.stat().st_size for entry in tmp_path.iterdir()) <= 3 * 2000
    compressed(tmp_path)
    kept = numbers(path)
    assert kept == list(range(kept[0], 600))
    assert len(kept) > 2 * 6000 // len(line(600))
    log.close()


def test_a_crash_leaves_each_line_once(tmp_path: Path) -> None:
    """With the complete copy beside its file, with an unfinished one, and with files of an earlier version."""
    path = tmp_path / "phm.jsonl"
    old = b"".join(line(number) + b"\n" for number in range(3))
    (tmp_path / "phm.jsonl.2").write_bytes(old)
    (tmp_path / "phm.jsonl.2.gz").write_bytes(gzip.compress(old))
    (tmp_path / "phm.jsonl.1").write_bytes(line(3) + b"\n")
    (tmp_path / "phm.jsonl.gz.1.tmp").write_bytes(b"half")
    assert numbers(path) == [0, 1, 2, 3]
    log = make(path)
    log.write(line(4))
    compressed(tmp_path)
    assert numbers(path) == [0, 1, 2, 3, 4]
    log.close()


def test_a_damaged_copy_hides_only_its_own_rest(tmp_path: Path) -> None:
    """A power cut on a card that lies about what it has written."""
    packed = gzip.compress(b"".join(line(number) + b"\n" for number in range(2000)))
    (tmp_path / "phm.jsonl.2.gz").write_bytes(packed[: len(packed) // 2])
    (tmp_path / "phm.jsonl.1.gz").write_bytes(b"no gzip at all")
    (tmp_path / "phm.jsonl").write_bytes(line(9000) + b"\n")
    kept = numbers(tmp_path / "phm.jsonl")
    assert kept[-1] == 9000
    assert kept[:-1] == list(range(len(kept) - 1))
    assert len(kept) > 100


def test_the_writer_never_waits_for_the_compression(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that is rotated further meanwhile is found again by its identity; closing discards the unfinished copy."""
    held, begun = threading.Event(), threading.Event()
    copy = rotated_files.CompressedFiles._copy

    def slow(self: rotated_files.CompressedFiles, *files: object) -> bool:
        begun.set()
        held.wait(60)
        return copy(self, *files)  # type: ignore[arg-type]

    monkeypatch.setattr(rotated_files.CompressedFiles, "_copy", slow)
    path = tmp_path / "phm.jsonl"
    log = make(path, max_size=1000)
    for number in range(20):
        log.write(line(number))
    until(begun.is_set, "the first copy")
    before = len(plain(tmp_path))
    for number in range(20, 40):
        log.write(line(number))
    assert len(plain(tmp_path)) >= before
    held.set()
    compressed(tmp_path)
    kept = numbers(path)
    assert kept == list(range(kept[0], 40))
    log.close()


def test_other_entries_of_the_log_folder_are_left_alone(tmp_path: Path) -> None:
    """A directory or a link with such a name is passed over; dates are names of operators."""
    (tmp_path / "phm.jsonl.1.gz").mkdir()
    (tmp_path / "phm.jsonl.2").symlink_to(tmp_path / "nowhere")
    (tmp_path / "phm.jsonl.20261121.gz").write_bytes(b"theirs")
    log = make(tmp_path / "phm.jsonl", max_size=1000)
    for number in range(30):
        log.write(line(number))
    until(lambda: any(entry.name == "phm.jsonl.3.gz" for entry in tmp_path.iterdir()), "the compression")
    assert log.problem() == ""
    assert (tmp_path / "phm.jsonl.1.gz").is_dir()
    assert (tmp_path / "phm.jsonl.2").is_symlink()
    assert (tmp_path / "phm.jsonl.20261121.gz").read_bytes() == b"theirs"
    log.close()


def test_a_full_disk_does_not_stop_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file remains as it was, and is compressed after the next rotation."""
    fails = threading.Event()
    fails.set()
    real = os.fsync

    def fsync(fd: int) -> None:
        if fails.is_set():
            raise OSError(28, "No space left on device")
        real(fd)

    monkeypatch.setattr(os, "fsync", fsync)
    log = make(tmp_path / "phm.jsonl", max_size=1000)
    for number in range(12):
        log.write(line(number))
    assert log.problem() == ""
    fails.clear()
    for number in range(12, 30):
        log.write(line(number))
    compressed(tmp_path)
    log.close()
