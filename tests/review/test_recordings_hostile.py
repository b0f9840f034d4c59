"""Recordings from anyone: damage, bombs and lies are counted and named; memory and time stay bounded, and nothing raises."""

from __future__ import annotations

import io
import sqlite3
import struct
import tempfile
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from phm.review import mcap_stream, source_rosbag2
from phm.review.cdr_read import line, statuses
from phm.review.lines import FileSegment, Problems
from phm.review.recording import MOST_TOPICS, Recording
from phm.review.sources import source_of
from phm.review.topic_times import MOST_GAPS, SAMPLES, TopicTimes
from tests.review import bags
from tests.review.little_memory import problems_in_little_memory, read_mcap
from tests.review.records import T0, report
from tests.review.test_recordings import problems


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def chunk(compression: bytes, data: bytes, claims: int, crc: int = 0) -> bytes:
    head = struct.pack("<QQQI", 0, 0, claims, crc) + struct.pack("<I", len(compression)) + compression
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(data)) + data)


def test_a_recording_that_was_not_ended_is_read_to_its_end(tmp_path: Path) -> None:
    """A recorder that lost power writes no index; each cut costs at most what is behind it, and is named."""
    whole = bags.mcap(tmp_path / "x.mcap", bags.flight(), CompressionType.NONE).read_bytes()
    every = len(read_mcap(whole)[0])
    before = 0
    for part in (0.1, 0.35, 0.6, 0.8):
        events, found = read_mcap(whole[: int(len(whole) * part)])
        assert len(events) >= before and any("ends within a record" in what for what in found)
        before = len(events)
    assert 0 < before <= every
    cut = whole[: whole.index(record(Opcode.DATA_END, b"")[:1] + struct.pack("<Q", 4))]
    events, found = read_mcap(cut)
    assert len(events) == every and any("the recorder was not stopped" in what for what in found)


def test_a_torn_database_is_named(tmp_path: Path) -> None:
    """What SQLite can read of it is read."""
    file = bags.rosbag2(tmp_path / "bag", bags.flight())
    data = file.read_bytes()
    for part in (0.3, 0.7):
        file.write_bytes(data[: int(len(data) * part)])
        found = Problems()
        list(source_rosbag2.read(FileSegment(str(file)), found))
        assert any("damaged or unreadable" in what for what, _ in found.found)


def test_a_damaged_chunk_costs_itself_alone(tmp_path: Path) -> None:
    """Its checksum or its compression says so; the chunks after it are read."""
    for kind in CompressionType:
        content = bytearray(bags.mcap(tmp_path / f"{kind.name}.mcap", bags.flight(), kind).read_bytes())
        first = content.index(bytes([Opcode.CHUNK]) + struct.pack("<Q", 0)[3:])
        place = content.index(
            b"zstd" if kind is CompressionType.ZSTD else b"lz4" if kind is CompressionType.LZ4 else b"cdr", first
        )
        content[place + 100 : place + 110] = b"\xff" * 10
        events, found = read_mcap(bytes(content))
        assert any("damaged chunks" in what or "chunks that end" in what for what in found), (kind, found)
        assert any("port is gone" in event.text for event in events)


def bomb(name: str) -> bytes:
    """A chunk or a file that would unpack to a gigabyte or more."""
    begin, end, zeros = mcap_stream.MAGIC, record(Opcode.DATA_END, bytes(4)), bytes(1 << 20)
    if name.startswith("zstd"):
        packer = zstandard.ZstdCompressor(level=1).compressobj()
        packed = b"".join(packer.compress(zeros) for _ in range(1024)) + packer.flush()
        return begin + chunk(b"zstd", packed, 1024 << 20 if "honest" in name else 1000) + end
    if name.startswith("lz4"):
        context = import_module("lz4.frame").LZ4FrameCompressor()
        packed = context.begin() + b"".join(context.compress(zeros) for _ in range(1024)) + context.flush()
        return begin + chunk(b"lz4", packed, 1000) + end
    if name == "many chunks":
        small = zstandard.compress(bytes(mcap_stream.MOST_CHUNK), 1)
        return begin + chunk(b"zstd", small, mcap_stream.MOST_CHUNK) * 100 + end
    if name == "long record":
        return begin + struct.pack("<BQ", Opcode.CHUNK, 1 << 62) + bytes(1000)
    if name == "long data":
        return begin + record(Opcode.CHUNK, struct.pack("<QQQII", 0, 0, 100, 0, 0) + struct.pack("<Q", 1 << 62))
    return zstandard.compress(begin + record(Opcode.ATTACHMENT, bytes(600 << 20)) + end, 1)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("zstd honest", "chunks that unpack to more than they say"),
        ("zstd lies", "chunks that unpack to more than they say"),
        ("lz4 lies", "chunks that unpack to more than they say"),
        ("many chunks", "chunks that unpack to more than 100 times their size"),
        ("long record", "records of more than 67108864 bytes"),
        ("long data", "damaged chunks"),
        ("whole file", "damaged or unreadable from here on: it unpacks to more than 100 times its size"),
    ],
)
def test_a_recording_that_unpacks_to_more_than_allowed_is_left_out_and_named(name: str, said: str) -> None:
    """In a process without enough memory for it."""
    spawned = get_context("spawn")
    mine, theirs = spawned.Pipe(duplex=False)
    worker = spawned.Process(target=problems_in_little_memory, args=(bomb(name), theirs))
    worker.start()
    theirs.close()
    try:
        assert mine.poll(120), "no answer"
        assert any(what.startswith(said) for what in mine.recv())
    finally:
        worker.kill()
        worker.join()


def database(folder: Path, *statements: str) -> Path:
    """A bag in which these statements were executed afterwards."""
    file = bags.rosbag2(folder, bags.flight())
    changed = sqlite3.connect(file)
    for statement in statements:
        changed.execute(statement)
    changed.commit()
    changed.close()
    return file


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x FROM n) SELECT x, 1, x FROM n"


@pytest.mark.parametrize(
    "statements",
    [
        ("DROP TABLE messages", f"CREATE VIEW messages(topic_id, timestamp, data) AS {ENDLESS}"),
        ("ALTER TABLE messages ADD COLUMN more AS (zeroblob(900000000))",),
        ("DROP TABLE messages", "CREATE TABLE messages(topic_id, timestamp, data AS (zeroblob(900000000)))"),
        ("DROP TABLE messages", "CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)"),
        ("DROP TABLE topics", "CREATE TABLE topics(id)"),
    ],
)
def test_a_database_that_would_compute_is_not_read(tmp_path: Path, statements: tuple[str, ...]) -> None:
    """Views, virtual tables and computed columns may never end, or give more than fits into memory."""
    file = database(tmp_path / "bag", *statements)
    assert problems(report_of(file)) == {"not the tables of rosbag2": 1}


def report_of(file: Path) -> dict[str, Any]:
    """What `report` says of a file that may have nothing."""
    found = Problems()
    events = list(source_rosbag2.read(FileSegment(str(file)), found))
    assert not events
    return {"files": {"problems": [{"what": what, "count": count} for (what, _), (count, _) in found.found.items()]}}


def test_rows_of_wrong_types_are_left_out_and_counted(tmp_path: Path) -> None:
    """SQLite takes any type in any column."""
    file = database(
        tmp_path / "bag",
        "CREATE TABLE loose(id, topic_id, timestamp, data)",
        "INSERT INTO loose SELECT * FROM messages",
        "INSERT INTO loose VALUES (1, 'x', 'y', 'z'), (2, 1, NULL, NULL), (3, 99, 5, x'00'), (4, 1, 1e300, x'00')",
        "DROP TABLE messages",
        "ALTER TABLE loose RENAME TO messages",
        "UPDATE topics SET name = x'ff00', type = 7 WHERE name = '/scan'",
    )
    found = problems(report(file))
    assert found["messages without a topic or a time, left out"] == 3
    assert found["messages of a topic that is not described, left out"] == 1


def test_another_database_is_not_a_recording(tmp_path: Path) -> None:
    """Recognized by its tables."""
    made = sqlite3.connect(tmp_path / "x.db3")
    made.execute("CREATE TABLE topics(id)")
    made.commit()
    made.close()
    assert source_of(tmp_path / "x.db3") is None


def test_names_of_a_recording_are_text(tmp_path: Path) -> None:
    """Escape sequences and additional lines neither reach the terminal nor make entries longer than others."""
    evil = "\x1b[2J\nERROR\u202e" + "x" * 500
    messages = [bags.scan(1.0, topic="/" + evil), bags.diagnostics(2.0, evil, 2, evil), bags.log(3.0, evil, 40, evil)]
    rows = report(bags.mcap(tmp_path / "x.mcap", messages))["other"]["rows"]
    assert len(rows) == 8
    assert all(row["text"].isprintable() and len(row["text"]) < 300 for row in rows)


def test_topics_gaps_and_samples_of_a_recording_are_limited() -> None:
    """Topics, gaps and samples, whatever a file has."""
    found = Problems()
    made = Recording("x", found)
    for number in range(MOST_TOPICS + 10):
        made.topic(number, f"/{number}", "", "cdr")
        made.take(number, T0, None)
    assert len(made.topics) == MOST_TOPICS
    assert found.found[f"more than {MOST_TOPICS} topics; the others are left out", "x"][0] == 10
    times = TopicTimes()
    for number in range(100_000):
        times.add(number * 0.1 + number // 500 * 5.0)
    assert len(times.gaps()) == MOST_GAPS and len(times._periods) <= SAMPLES
    assert times.period() == pytest.approx(0.1) and times.count == 100_000


def test_gaps_are_measured_by_the_usual_period_of_the_topic() -> None:
    """Five median periods and half a second; not of a topic that is irregular, and not by outliers."""
    regular, irregular, fast = TopicTimes(), TopicTimes(), TopicTimes()
    for number in range(200):
        regular.add(number + (3.0 if number >= 100 else 0.0) + (0.3 if number % 3 else 0.0))
        irregular.add(float(number**3))
        fast.add(number / 1000 + (0.4 if number > 50 else 0.0))
    assert regular.gaps() == [] and regular.limit() == pytest.approx(5.0, rel=0.35)
    assert irregular.limit() is None and irregular.gaps() == []
    assert fast.limit() == 0.5 and fast.gaps() == []
    regular.add(regular.last + 9.0)
    assert [round(long, 3) for _, long in regular.gaps()] == [9.0]


def test_our_reader_of_two_messages_agrees_with_an_independent_serializer() -> None:
    """Texts of all alignments, big-endian too; and every cut is a ValueError."""
    for length in range(5):
        data = bags.array(("n" * length, 2, "Übel", {"k" * length + "k": "v", "": ""}), ("m", 0, "", {}))
        assert [(one.level, one.name, one.message, one.values) for one in statuses(data)] == [
            (2, "n" * length, "Übel", (("k" * length + "k", "v"), ("", ""))),
            (0, "m", "", ()),
        ]
        written = bags.log(0.0, "n" * length, 50, "m" * length)[3]
        assert line(written) == (50, "n" * length, "m" * length)
        big = bytes(
            bags.JAZZY.serialize_cdr(bags.JAZZY.deserialize_cdr(written, bags.LOG), bags.LOG, little_endian=False)
        )
        assert line(big) == line(written)
        for cut in range(4, len(data) - 1):
            with pytest.raises(ValueError):
                statuses(data[:cut])


def test_a_long_recording_is_read_in_little_memory(tmp_path: Path) -> None:
    """300,000 messages, of which little is kept."""
    stream = io.BytesIO()
    writer: Any = Writer(stream, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="test")
    kind = writer.register_schema(bags.SCAN, "ros2msg", b"string data")
    channel = writer.register_channel("/scan", "cdr", kind)
    for number in range(300_000):
        writer.add_message(channel, bags.stamp(number / 1000), b"\0\1\0\0" + bytes(60), 0, number)
    writer.finish()
    events, found = read_mcap(stream.getvalue())
    assert [event.text for event in events] == [
        "/scan: first message (std_msgs/msg/String)",
        "/scan: last of 300000 messages, median period 0.001 s",
    ]
    assert not found


def said_of(file: Path) -> list[str]:
    return [row["what"] for row in report_of(file)["files"]["problems"]]


def test_a_torn_compressed_database_is_named_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also one that needs more space than there is; the unpacked file is removed each time."""
    options = (CompressionMode.FILE, CompressionFormat.ZSTD)
    database = bags.rosbag2(tmp_path / "b", bags.flight(), StoragePlugin.SQLITE3, options)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(source_rosbag2, "FREE_SHARE", 0.0)
    assert any("more than a quarter of the free space" in text for text in said_of(database))
    monkeypatch.undo()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    database.write_bytes(database.read_bytes()[:-20])
    assert "the end of the file is missing" in said_of(database)
    assert list((tmp_path / "temporary").iterdir()) == []
