"""PHM's lines in the log that an ArduPilot writes itself (`MSG`), from a recorded one."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
from pymavlink import DFReader

from phm.gcs import statustext_parser
from phm.gcs.statustext_parser import LineKind
from phm.wire.status_line import MAX_CHARS
from tests.fakes.recorded_flight import FOLDER

MSG_CHARS = 64
"""Length of the field `MSG.Message`."""
OURS = "SRC=1/193:"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    file = tmp_path / "00000001.BIN"
    file.write_bytes(gzip.decompress((FOLDER / "dataflash.bin.gz").read_bytes()))
    return file


def texts(file: Path) -> list[tuple[float, str]]:
    """Seconds since boot and text of each MSG, read as ground tools do."""
    reader, found = DFReader.DFReader_binary(str(file)), []
    while (entry := reader.recv_match(type="MSG")) is not None:
        found.append((entry.TimeUS / 1e6, entry.Message))
    reader.data_map.close()
    reader.filehandle.close()
    return found


def test_each_line_names_its_sender_and_is_complete(log: Path) -> None:
    """The prefix with PHM's ids distinguishes them from the autopilot's own texts; the rest is a line as sent."""
    everything = texts(log)
    lines = [(at, text.removeprefix(OURS)) for at, text in everything if text.startswith(OURS)]
    assert 0 < len(lines) < len(everything)
    assert all(statustext_parser.parse(line) is not None for _, line in lines)
    changes = [(round(at, 1), line) for at, line in lines if _kind(line) is LineKind.CHANGE]
    assert changes == [(61.3, "A01 WARN 9 CPU 100 %"), (67.3, "A01 OK 9 cleared: CPU 100 %")]


def _kind(line: str) -> LineKind | None:
    parsed = statustext_parser.parse(line)
    return None if parsed is None else parsed.kind


def test_the_texts_of_the_autopilot_are_not_taken_for_lines_of_phm(log: Path) -> None:
    """In a recorded log of ArduPilot."""
    assert not [text for _, text in texts(log) if not text.startswith("SRC=") and statustext_parser.parse(text)]


def test_the_longest_line_fits_with_its_prefix() -> None:
    """ArduPilot puts the sender before each received text in its own log."""
    assert len("SRC=250/250:") + MAX_CHARS <= MSG_CHARS
