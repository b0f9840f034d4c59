"""Lines reach the disk, whatever happens to it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from phm.reporters import rotating_file
from phm.reporters.rotating_file import FIRST_RETRY_S, LAST_RETRY_S, RING_LINES, RotatingFile
from phm.testing import FakeClock

CAP_SYS_ADMIN = 1 << 21


def make(path: Path, clock: FakeClock | None = None, *, max_size: int = 10_000, files: int = 3) -> RotatingFile:
    def lost(count: int, reason: str, last: bytes) -> bytes:
        return b"lost %d up to %s: %s" % (count, last, reason.encode())

    return RotatingFile(str(path), max_size=max_size, files=files, clock=clock or FakeClock(), lost_line=lost)


def test_lines_are_written_immediately(tmp_path: Path) -> None:
    """Nothing is buffered in user space: another reader sees each line immediately, without close."""
    lines = make(tmp_path / "log")
    for number in range(3):
        lines.write(b"line %d" % number)
        assert (tmp_path / "log").read_bytes().splitlines()[-1] == b"line %d" % number


def test_rotation_keeps_the_newest_files(tmp_path: Path) -> None:
    """The file is renamed before it exceeds the size; the oldest of the kept ones is removed."""
    lines = make(tmp_path / "log", max_size=100, files=2)
    for number in range(100):
        lines.write(b"%019d" % number)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["log", "log.1", "log.2"]
    kept = [int(line) for name in ("log.2", "log.1", "log") for line in (tmp_path / name).read_text().split()]
    assert kept == list(range(85, 100))


def test_a_rotated_file_is_on_the_disk_before_the_next_one_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Later syncs are of the next file, so a power cut could take the end of this one."""
    synced: list[int] = []
    monkeypatch.setattr(rotating_file, "_sync", lambda fd: synced.append(os.fstat(fd).st_ino))
    lines = make(tmp_path / "log", max_size=100)
    for number in range(10):
        lines.write(b"%019d" % number)
    assert (tmp_path / "log.1").stat().st_ino in synced


@given(
    lengths=st.lists(st.integers(0, 99), max_size=80),
    files=st.integers(1, 4),
    reopen=st.lists(st.booleans(), min_size=80),
)
def test_all_files_together_never_exceed_the_cap(
    tmp_path_factory: pytest.TempPathFactory, lengths: list[int], files: int, reopen: list[bool]
) -> None:
    """At most (files + 1) * max_size bytes, whatever the lines and however often PHM restarts; the kept lines are in
    order.
    """
    where = tmp_path_factory.mktemp("rotate")
    lines = make(where / "log", max_size=100, files=files)
    for index, length in enumerate(lengths):
        if reopen[index]:
            lines.close()
            lines = make(where / "log", max_size=100, files=files)
        lines.write(bytes([33 + index % 90]) * length)
        sizes = [entry.stat().st_size for entry in where.iterdir()]
        assert max(sizes) <= 100
        assert len(sizes) <= files + 1
    lines.close()
    names = [f"log.{n}" for n in range(files, 0, -1)] + ["log"]
    text = b"".join((where / name).read_bytes() for name in names if (where / name).exists())
    expected = b"".join(bytes([33 + index % 90]) * length + b"\n" for index, length in enumerate(lengths))
    assert expected.endswith(text)


def test_files_beyond_a_smaller_number_are_removed(tmp_path: Path) -> None:
    """A configuration that keeps fewer files removes those that an earlier one kept, and touches nothing else."""
    for name in ("log.1", "log.7", "log.old", "other.9"):
        (tmp_path / name).write_text("x\n")
    make(tmp_path / "log", files=2).write(b"line")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["log", "log.1", "log.old", "other.9"]


def test_an_operators_copy_is_never_removed(tmp_path: Path) -> None:
    """Only names that rotation creates are removed: .1 to .100, without a leading zero; a date is not one of them."""
    theirs = ["log.007", "log.101", "log.20261121", "log.3.gz", "log.\u0663"]
    for name in theirs:
        (tmp_path / name).write_text("theirs\n")
    (tmp_path / "log.99").write_text("of an earlier configuration\n")
    make(tmp_path / "log", files=2).write(b"line")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == sorted(["log", *theirs])


def test_a_file_that_cannot_be_removed_does_not_stop_the_log(tmp_path: Path) -> None:
    """A directory or a link with the name of a rotated file stays in place, and lines are written beside it."""
    (tmp_path / "log.7").mkdir()
    (tmp_path / "log.8").symlink_to(tmp_path / "nowhere")
    lines = make(tmp_path / "log", files=2)
    lines.write(b"line")
    assert (tmp_path / "log").read_bytes() == b"line\n"
    assert lines.problem() == ""
    assert (tmp_path / "log.7").is_dir() and (tmp_path / "log.8").is_symlink()


def test_rotation_skips_a_directory_in_its_way(tmp_path: Path) -> None:
    """A directory named like a rotated file is neither moved nor replaced; the other names are used."""
    (tmp_path / "log.1").mkdir()
    (tmp_path / "log.1" / "kept").write_text("theirs\n")
    lines = make(tmp_path / "log", max_size=100, files=3)
    for number in range(100):
        lines.write(b"%019d" % number)
    assert lines.problem() == ""
    assert (tmp_path / "log.1" / "kept").read_text() == "theirs\n"
    kept = [int(line) for name in ("log.3", "log.2", "log") for line in (tmp_path / name).read_text().split()]
    assert kept == list(range(85, 100))


def test_the_newest_lines_are_kept_without_a_name_to_rotate_to(tmp_path: Path) -> None:
    """Where every rotated name is a directory, the file is truncated: it neither exceeds its size nor stops."""
    (tmp_path / "log.1").mkdir()
    lines = make(tmp_path / "log", max_size=100, files=1)
    for number in range(12):
        lines.write(b"%019d" % number)
    assert lines.problem() == ""
    assert [int(line) for line in (tmp_path / "log").read_text().split()] == [10, 11]


def test_a_truncated_last_line_stays_separate(tmp_path: Path) -> None:
    """After a power cut the next line starts on a new line, and the truncated one is kept."""
    (tmp_path / "log").write_bytes(b"whole\ntor")
    lines = make(tmp_path / "log")
    lines.write(b"next")
    lines.write(b"more")
    assert (tmp_path / "log").read_bytes() == b"whole\ntor\nnext\nmore\n"


def test_a_log_moved_away_is_created_again(tmp_path: Path) -> None:
    """After rotation or deletion by another program, lines go into a file with the right name."""
    lines = make(tmp_path / "log")
    lines.write(b"one")
    (tmp_path / "log").rename(tmp_path / "taken")
    lines.write(b"two")
    (tmp_path / "log").unlink()
    lines.write(b"three")
    assert (tmp_path / "taken").read_bytes() == b"one\n"
    assert (tmp_path / "log").read_bytes() == b"three\n"


def test_a_deleted_directory_is_created_again(tmp_path: Path) -> None:
    """Deleting the log directory under the running daemon loses no later line."""
    lines = make(tmp_path / "logs" / "log")
    lines.write(b"one")
    shutil.rmtree(tmp_path / "logs")
    lines.write(b"two")
    assert (tmp_path / "logs" / "log").read_bytes() == b"two\n"
    assert lines.problem() == ""


def test_unwritable_lines_are_queued_and_written_later(tmp_path: Path) -> None:
    """Lines are kept while the directory cannot be created, `problem` reports it, and none is lost or reordered."""
    clock = FakeClock()
    (tmp_path / "logs").write_text("a file in the way")
    lines = make(tmp_path / "logs" / "log", clock)
    lines.write(b"one")
    lines.write(b"two")
    assert "2 lines are kept in memory, 0 lost" in lines.problem()
    (tmp_path / "logs").unlink()
    lines.write(b"three")  # the back-off has not expired
    assert not (tmp_path / "logs").exists()
    clock.advance(FIRST_RETRY_S)
    lines.retry()
    assert (tmp_path / "logs" / "log").read_bytes() == b"one\ntwo\nthree\n"
    assert lines.problem() == ""


def test_the_back_off_doubles_up_to_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A broken disk is tried less and less often, but at least every 30 s."""
    clock = FakeClock()
    tries: list[float] = []

    def refuse(*_: object, **__: object) -> None:
        tries.append(clock.mono())
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "makedirs", refuse)
    lines = make(tmp_path / "logs" / "log", clock)
    lines.write(b"one")
    for _ in range(1000):
        clock.advance(0.5)
        lines.retry()
    gaps = [later - earlier for earlier, later in pairwise(tries)]
    assert gaps[:6] == [1.0, 2.0, 4.0, 8.0, 16.0, 30.0]
    assert set(gaps[6:]) == {LAST_RETRY_S}


def test_memory_is_limited_and_the_loss_is_reported(tmp_path: Path) -> None:
    """Beyond 1000 queued lines the oldest are dropped, and a line in their place has their number, the reason and the
    last one.
    """
    (tmp_path / "logs").write_text("a file in the way")
    lines = make(tmp_path / "logs" / "log", max_size=1_000_000)
    for number in range(RING_LINES + 5):
        lines.write(b"%d" % number)
    assert "1000 lines are kept in memory, 5 lost" in lines.problem()
    (tmp_path / "logs").unlink()
    lines.close()
    written = (tmp_path / "logs" / "log").read_bytes().splitlines()
    assert written[0] == b"lost 5 up to 4: File exists"
    assert written[1:] == [b"%d" % number for number in range(5, RING_LINES + 5)]


def test_a_pipe_without_a_reader_does_not_hang(tmp_path: Path) -> None:
    """A log replaced by a full pipe is reported as a problem and does not block."""
    os.mkfifo(tmp_path / "log")
    lines = make(tmp_path / "log")
    for _ in range(100):
        lines.write(b"x" * 5000)
    assert "Resource temporarily unavailable" in lines.problem()


def test_a_disk_that_hangs_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While a write hangs in the kernel, `problem` reports it to another thread."""
    clock = FakeClock()
    lines = make(tmp_path / "log", clock)
    real, reported = os.write, []

    def hang(descriptor: int, data: bytes) -> int:
        clock.advance(60.0)
        reported.append(lines.problem())
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", hang)
    lines.write(b"one")
    assert reported == [f"the disk has not answered for 60 s to a write to {tmp_path / 'log'}"]
    assert lines.problem() == ""


def test_lines_are_kept_until_a_full_device_has_space(tmp_path: Path) -> None:
    """The kernel's own ENOSPC (from /dev/full) is handled, and the lines are written when the log is a file again."""
    clock = FakeClock()
    (tmp_path / "log").symlink_to("/dev/full")
    lines = make(tmp_path / "log", clock)
    lines.write(b"one")
    assert "No space left on device; 1 lines are kept" in lines.problem()
    (tmp_path / "log").unlink()
    clock.advance(FIRST_RETRY_S)
    lines.write(b"two")
    assert (tmp_path / "log").read_bytes() == b"one\ntwo\n"


def _may_mount() -> bool:
    status = Path("/proc/self/status").read_text()
    capabilities = int(status.partition("CapEff:")[2].split()[0], 16)
    return os.geteuid() == 0 and bool(capabilities & CAP_SYS_ADMIN)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A tmpfs of 64 kB."""
    where = tmp_path / "mounted"
    where.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(where)], check=True)
    try:
        yield where
    finally:
        subprocess.run(["umount", str(where)], check=True)


if _may_mount():  # a mount needs root; the tests above and below cover the same rules without it

    def test_a_full_disk_leaves_only_complete_lines_and_loses_none(small_disk: Path) -> None:
        """On a disk that is really full, a short write is undone; with space again all lines are written in order."""
        clock = FakeClock()
        ballast = small_disk / "ballast"
        ballast.write_bytes(b"x" * 40 * 1024)
        lines = make(small_disk / "log", clock, max_size=10**9)
        for number in range(800):
            lines.write(b"%099d" % number)
        assert "No space left on device" in lines.problem()
        on_disk = (small_disk / "log").read_bytes()
        assert on_disk.endswith(b"\n")
        assert len(on_disk) % 100 == 0
        ballast.unlink()
        small = (small_disk / "log").stat().st_size
        clock.advance(LAST_RETRY_S)
        lines.retry()
        assert (small_disk / "log").stat().st_size > small
        kept = [int(line) for line in (small_disk / "log").read_bytes().split()]
        assert kept == list(range(len(kept)))


LIMITED = """
import resource, sys
from pathlib import Path
from phm.core.clock import SystemClock
from phm.reporters.rotating_file import RotatingFile
resource.setrlimit(resource.RLIMIT_FSIZE, (1050, 1050))
lines = RotatingFile(sys.argv[1], max_size=10**6, files=9, clock=SystemClock(), lost_line=lambda *_: b"lost")
for number in range(50):
    lines.write(b"%099d" % number)
print(lines.problem())
"""


def test_a_limit_on_the_size_of_files_starts_a_new_file(tmp_path: Path) -> None:
    """RLIMIT_FSIZE below `max_size` truncates a write: it is undone and goes into the next file completely."""
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(tmp_path / "log")], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == ""
    names = [f"log.{number}" for number in range(9, 0, -1)] + ["log"]
    kept = [line for name in names if (tmp_path / name).exists() for line in (tmp_path / name).read_bytes().split()]
    assert kept == [b"%099d" % number for number in range(50)]
