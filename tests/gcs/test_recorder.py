"""The record tolerates disk problems and lists its gaps."""

from __future__ import annotations

from pathlib import Path

from phm.core.clock import SystemClock
from phm.gcs import recorder
from phm.gcs.recorder import Recorder
from phm.wire import json_log
from tests.fakes.until import until
from tests.gcs.bench import Source


def made(path: Path, source: Source, **limits: int) -> Recorder:
    book = Recorder(str(path), source, SystemClock(), **limits)  # type: ignore[arg-type]
    book.start()
    return book


def numbers(path: Path) -> list[int]:
    return [event["seq"] for event in json_log.read(path) if event["event"] == "said"]


def test_the_record_is_rotated_with_a_size_limit(tmp_path: Path) -> None:
    """A week on the ground fills no disk: the oldest lines are deleted, the newest are complete."""
    source, path = Source(), tmp_path / "flight.jsonl"
    book = made(path, source, max_size=20_000, files=2)
    for number in range(1, 1001):
        source.say("x" * 50)
        if number % 100 == 0:
            until(lambda number=number: numbers(path)[-1:] == [number], "the lines")
    book.close()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["flight.jsonl", "flight.jsonl.1", "flight.jsonl.2"]
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) <= 60_000
    found = numbers(path)
    assert found == list(range(found[0], 1001))


def test_a_failing_disk_is_reported_and_lost_lines_are_counted(tmp_path: Path) -> None:
    """The newest lines wait in memory; when the disk works again, an event replaces the others."""
    source, folder = Source(), tmp_path / "sd"
    folder.write_text("no folder")
    book = made(folder / "flight.jsonl", source)
    for _ in range(1500):
        source.say()
    until(lambda: "500 lost" in book.about(), "the loss")
    assert book.about().startswith("record: cannot write ")
    folder.unlink()
    until(lambda: book.about() == "", "the disk to work again")
    book.close()
    events = list(json_log.read(folder / "flight.jsonl"))
    assert (events[0]["event"], events[0]["lines"], events[0]["seq"]) == ("lost", 500, 500)
    assert numbers(folder / "flight.jsonl") == list(range(501, 1501))


def test_a_snapshot_is_recorded_periodically(tmp_path: Path) -> None:
    """So that the state of all agents is known without the rotated lines."""
    source, path = Source(), tmp_path / "flight.jsonl"
    book = made(path, source)
    book._snapshot_at = 0.0
    until(lambda: [event for event in json_log.read(path) if event["event"] == "snapshot"], "a snapshot")
    assert recorder.SNAPSHOT_S == 60.0
    book.close()
    assert [event["event"] for event in json_log.read(path)] == ["snapshot", "snapshot"]
