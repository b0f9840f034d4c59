"""Torn and hostile files: what is wrong is counted and named, the rest is read, and memory stays bounded."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from phm.review import document, lines as lines_module, record, record_reader
from phm.review.events import parse
from phm.review.lines import MAX_LINE, FileSegment, Problems, lines
from phm.review.part import Part
from tests.review.records import report
from tests.review.test_document import one_flight

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=8,
)
KEYS = st.sampled_from(
    [
        "event",
        "boot_id",
        "run",
        "agent",
        "agent_id",
        "seq",
        "mono",
        "utc_s",
        "unit",
        "level",
        "old",
        "values",
        "fault",
        "slots",
        "blocks",
        "duration_s",
        "slot",
        "began",
    ]
)
EVENTS = st.sampled_from(
    [
        "transition",
        "unit",
        "fault_opened",
        "fault_closed",
        "action",
        "flight",
        "report",
        "slots",
        "presence",
        "text",
        "autopilot",
        "snapshot",
        "lost",
    ]
)
LINE = st.fixed_dictionaries(
    {"event": EVENTS | JSON, "mono": st.floats(0, 1e6) | JSON, "utc_s": st.floats(1, 2e9) | JSON},
    optional={
        "boot_id": st.sampled_from(["a", "b"]) | JSON,
        "run": st.sampled_from(["r"]) | JSON,
        "agent": st.sampled_from(["x", 1]) | JSON,
    },
).flatmap(lambda known: st.dictionaries(KEYS, JSON, max_size=6).map(lambda more: {**more, **known}))


def test_wrong_lines_are_counted_and_named_and_the_others_are_read(tmp_path: Path) -> None:
    """Torn, empty, binary, endless, deeply nested, of wrong types: each with its file and line."""
    log = one_flight(tmp_path).close()
    good = log.read_bytes()
    wrong = [
        b'{"v":2,"agent":"agent_1","boot_id":"bo',
        b"\0" * 4096,
        b"\xff\xfe not text",
        b"[" * 100_000,
        b'{"event":"note","boot_id":"x","mono":1,"utc_s":' + b"1" * 400 + b"}",
        b"x" * (MAX_LINE + 10),
        b'{"event":"unit","boot_id":"boot0001","agent":"agent_1","agent_id":1,"mono":60,"utc_s":1772366410,"unit":5,"seq":100000}',
        b"[1,2]",
    ]
    expected = report(tmp_path)
    log.write_bytes(good + b"\n".join(wrong) + b"\n" + b'{"torn":')
    made = report(tmp_path)
    assert made["faults"] == expected["faults"]
    problems = {problem["what"]: problem["count"] for problem in made["files"]["problems"]}
    assert problems[f"line longer than {MAX_LINE} bytes"] == 1
    assert problems["a key of the wrong type, which was left out"] == 1
    assert sum(problems.values()) == 8  # of nine, the zeros of a power cut are no problem
    assert all(problem["file"] == str(log) for problem in made["files"]["problems"])


def test_a_damaged_compressed_file_is_read_up_to_the_damage(tmp_path: Path) -> None:
    """The rest of the record is read, and the file is named."""
    log = one_flight(tmp_path).close()
    packed = gzip.compress(log.read_bytes())
    log.unlink()
    (tmp_path / "phm.jsonl.1.gz").write_bytes(packed[: len(packed) // 2])
    made = report(tmp_path)
    assert made["files"]["lines"] > 0
    assert any("damaged" in problem["what"] for problem in made["files"]["problems"])


def test_long_texts_of_faults_are_cut(tmp_path: Path) -> None:
    """A small compressed file may contain thousands of texts of a megabyte."""
    long = "x" * 140_000
    keys = {"event": "fault_opened", "boot_id": "b", "agent": "a", "agent_id": 1, "utc_s": 1.8e9, "by": [long]}
    texts = dict.fromkeys(("unit", "layer", "condition", "summary", "brief", "target", "version", "detail"), long)
    with gzip.open(tmp_path / "phm.jsonl.1.gz", "wt", compresslevel=1) as file:
        for number in range(3):
            lists = {"blocks": [long], "suspects": [long]}
            event = {**keys, **texts, **lists, "seq": number, "mono": 1.0 + number, "fault": f"{number}{long[:5000]}"}
            file.write(json.dumps(event) + "\n")
            file.write(json.dumps({**event, "event": "transition", "level": "ERROR", "values": {long: 1}}) + "\n")
    part = record_reader.read(record_reader.find([str(tmp_path)]), processes=1)
    (run,) = part.runs.values()
    kept = len(repr(run.faults)) + len(repr(run.changes))
    assert len(run.faults) == 3 and kept < 100_000


def test_a_compressed_log_is_read_up_to_a_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And the file is named."""
    monkeypatch.setattr(lines_module, "FREE_BYTES", 10_000)
    (tmp_path / "phm.jsonl.1.gz").write_bytes(gzip.compress(b"\n" * 3_000_000))
    problems = Problems()
    read = sum(len(line) for line in lines(FileSegment(str(tmp_path / "phm.jsonl.1.gz")), problems))
    ((what, _path),) = problems.found
    assert read < 1_000_000 and "unpacks to more than 100 times its size" in what


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(LINE, max_size=12))
def test_no_content_of_a_record_stops_the_report(events: list[dict[str, object]]) -> None:
    """Whatever the lines say, there is a document, and it is JSON."""
    part = Part()
    for event in events:
        found, _ = parse(json.dumps(event).encode())
        if found is not None:
            part.take(found, "file")
    json.dumps(document.build(record.build(part)), allow_nan=False)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.binary(max_size=30).map(lambda line: line.replace(b"\n", b"")), max_size=40), st.integers(1, 200))
def test_each_line_is_in_exactly_one_piece(tmp_path_factory: object, content: list[bytes], size: int) -> None:
    """However a file is divided, its lines are read once and in order."""
    path = tmp_path_factory.mktemp("pieces") / "record"  # type: ignore[attr-defined]
    path.write_bytes(b"\n".join(content))
    total = path.stat().st_size
    read: list[bytes] = []
    for begin in range(0, total, size):
        read += lines(FileSegment(str(path), begin, min(begin + size, total)), Problems())
    assert b"".join(read) == path.read_bytes()


def test_processes_give_the_same_as_one(tmp_path: Path) -> None:
    """A record that is read in pieces by several processes gives the same document."""
    one_flight(tmp_path / "a", 1).close()
    one_flight(tmp_path / "b", 2).close()
    found = record_reader.find([str(tmp_path)])
    alone, several = (document.build(record.build(record_reader.read(found, processes=count))) for count in (1, 2))
    assert alone == several
