"""What the log keeps when the power is cut, the disk is full, or it becomes read-only, on a real file system."""

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest

from phm.core.clock import SystemClock
from phm.core.model import Note
from phm.wire import json_log
from tests.reporters.durability._disk import Disk, mounted
from tests.reporters.durability._writer import events, numbers, reporter, writer

CUTS = 12


@pytest.fixture
def disk(tmp_path: Path) -> Disk:
    made = Disk(tmp_path)
    made.make()
    return made


def test_a_power_cut_takes_nothing_that_was_synced(tmp_path: Path, disk: Disk) -> None:
    """While armed each tick syncs, twice a second: what is older than the last one is on the disk, in order and readable."""
    draw = random.Random(5)
    for cut in range(1, CUTS + 1):
        with mounted(disk) as path, writer(path / f"log{cut}", cut) as made:
            made.until(lambda: made.kept > 0)
            time.sleep(draw.uniform(0.0, 0.2))
            made.stop()
            after = disk.snapshot(tmp_path, f"cut{cut}")
            kept, written = made.kept, made.written
            made.kill()
        with mounted(after) as path:
            found = events(path / f"log{cut}", cut)
            assert found[:kept] == list(range(1, kept + 1)), (
                f"cut {cut}: {kept} of {written} were kept, {len(found)} found"
            )
            assert numbers(path / f"log{cut}", cut) == sorted(numbers(path / f"log{cut}", cut))
            with writer(path / f"log{cut}", 1000) as next_one:
                next_one.until(lambda: next_one.kept > 0)
            assert events(path / f"log{cut}", 1000)[: next_one.kept] == list(range(1, next_one.kept + 1))
        after.image.unlink()


def test_a_power_cut_without_a_sync_does_lose_events(tmp_path: Path, disk: Disk) -> None:
    """So the test above can fail: the snapshot does not have what only the kernel's memory holds."""
    with mounted(disk) as path:
        log = reporter(path, 1, 5_000_000, 5, sync="never")
        for number in range(1, 51):
            log.handle(Note(SystemClock().stamp(), "TEST", f"event {number}"))
        log.tick()
        after = disk.snapshot(tmp_path, "cut")
        log.close()
    with mounted(after) as path:
        assert len(events(path)) < 50


def test_a_full_disk_stops_the_log_and_not_the_daemon(disk: Disk) -> None:
    """It is reported, lines wait in memory, and go on in order when there is room again."""
    with mounted(disk) as path:
        log, clock = reporter(path / "log", 1, 500_000, 5), SystemClock()
        log.handle(Note(clock.stamp(), "TEST", "event 1"))
        filler = path / "filler"
        with open(filler, "wb", buffering=0) as file:
            for size in (1 << 20, 4096, 1):
                while True:
                    try:
                        if not file.write(b"x" * size):
                            break
                    except OSError:
                        break
        number = 1
        while not log.problem():
            number += 1
            log.handle(Note(clock.stamp(), "TEST", f"event {number} {'x' * 300}"))
            assert number < 1000
        assert "No space left on device" in log.problem() and "kept in memory" in log.problem()
        filler.unlink()
        log._record.retry(now=True)
        log._plain.retry(now=True)
        assert log.problem() == ""
        log.close()
        assert events(path / "log") == list(range(1, number + 1))


def test_a_disk_that_becomes_read_only_stops_the_log_and_not_the_daemon(disk: Disk) -> None:
    """An SD card that fails does so. Lost lines are counted in the record, so `seq` has no unexplained gap."""
    with mounted(disk) as path:
        log, clock = reporter(path / "log", 1, 5_000_000, 5), SystemClock()
        log.handle(Note(clock.stamp(), "TEST", "event 1"))
        log._record._close()
        log._plain._close()
        disk.remount("ro")
        for number in range(2, 1203):
            log.handle(Note(clock.stamp(), "TEST", f"event {number}"))
            log.tick()
        assert "Read-only file system" in log.problem()
        disk.remount("rw")
        log._record.retry(now=True)
        log._plain.retry(now=True)
        log.close()
        lines = list(json_log.read(path / "log"))
        lost = [line for line in lines if line["event"] == "lost"]
        assert len(lost) == 1 and lost[0]["reason"] == "Read-only file system"
        seqs = [int(str(line["seq"])) for line in lines]
        first = int(str(lost[0]["seq"])) - int(str(lost[0]["lines"])) + 1
        assert [*seqs[: seqs.index(int(str(lost[0]["seq"])))], first] == list(range(1, first + 1))
        after = seqs[seqs.index(int(str(lost[0]["seq"]))) :]
        assert after == list(range(after[0], after[0] + len(after))) and events(path / "log")[-1] == 1202
