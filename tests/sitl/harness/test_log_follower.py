"""Following a record while it grows, and the names of a stack."""

from __future__ import annotations

import json
import threading
from pathlib import Path

from sitl.harness.compose_stack import Stack
from sitl.harness.log_follower import Record


def line(number: int) -> str:
    return json.dumps({"event": "report", "number": number}) + "\n"


def test_a_missing_record_is_empty(tmp_path: Path) -> None:
    """Before PHM has written anything there are no events, and no error."""
    record = Record(tmp_path / "phm.jsonl")
    record.update()
    assert record.events == []


def test_an_unfinished_line_waits_for_its_end(tmp_path: Path) -> None:
    """An incomplete line is read when its rest is written, once."""
    file = tmp_path / "phm.jsonl"
    record = Record(file)
    both = line(1) + line(2)
    file.write_text(both[:-5])
    record.update()
    assert [event["number"] for event in record.events] == [1]
    file.write_text(both)
    record.update()
    record.update()
    assert [event["number"] for event in record.events] == [1, 2]


def test_a_truncated_line_is_skipped(tmp_path: Path) -> None:
    """A line left incomplete by a killed daemon does not prevent reading the next ones."""
    file = tmp_path / "phm.jsonl"
    file.write_text(line(1) + '{"event": "rep\n' + line(2))
    record = Record(file)
    record.update()
    assert [event["number"] for event in record.events] == [1, 2]


def test_a_rotated_record_is_read_on(tmp_path: Path) -> None:
    """Unread lines from before the rotation come first, then the new file from its beginning."""
    file = tmp_path / "phm.jsonl"
    record = Record(file)
    file.write_text(line(1))
    record.update()
    with file.open("a") as stream:
        stream.write(line(2))
    file.rename(tmp_path / "phm.jsonl.1")
    record.update()  # nothing was written since
    file.write_text(line(3))
    record.update()
    record.update()
    assert [event["number"] for event in record.events] == [1, 2, 3]


def test_a_record_that_was_rotated_and_compressed_meanwhile_loses_nothing(tmp_path: Path) -> None:
    """PHM compresses a rotated file within a second, and removes the original. A fault's end was lost so."""
    file = tmp_path / "phm.jsonl"
    file.write_text(line(1))
    record = Record(file)
    record.update()
    for number in (2, 4):
        with file.open("a") as stream:
            stream.write(line(number))
        file.unlink()
        file.write_text(line(number + 1))
        record.update()
    assert [event["number"] for event in record.events] == [1, 2, 3, 4, 5]


def test_waiting_considers_only_later_events(tmp_path: Path) -> None:
    """An event from before the mark does not count; one that is written while waiting does."""
    file = tmp_path / "phm.jsonl"
    file.write_text(line(1))
    record = Record(file)
    record.update()
    assert record.wait(lambda event: event["number"] == 1, 0.0, since=1) is None
    writer = threading.Thread(target=lambda: file.write_text(line(1) + line(7)), daemon=True)
    writer.start()
    found = record.wait(lambda event: event["number"] == 7, 60.0, since=1)
    writer.join()
    assert found is not None


def test_two_stacks_share_nothing(tmp_path: Path) -> None:
    """Container, network and device names contain the project's name, so that two agents on one machine do not collide."""
    one, two = (Stack(project=name, logs=tmp_path) for name in ("phm-one", "phm-two"))
    assert one.device != two.device
    ours, theirs = (stack.environment() for stack in (one, two))
    assert all(ours[name] != theirs[name] for name in ("PHM_APP", "PHM_NETWORK", "PHM_DEVICE"))
    assert one.record == tmp_path / "phm.jsonl"
