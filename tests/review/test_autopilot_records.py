"""Records of a real ArduPilot in the report: its DataFlash log and telemetry logs, on the time axis of PHM."""

from __future__ import annotations

import gzip
import struct
import tempfile
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given, settings, strategies as st
from pymavlink import DFReader

from phm.cli import group
from phm.review import page, record_reader, source_dataflash, source_tlog
from phm.review.events import Event
from phm.review.external_entry import ExternalEntry
from phm.review.lines import FileSegment, Problems
from tests.fakes.recorded_flight import FOLDER
from tests.review.records import T0, Flown, report

DATAFLASH, TLOG = FOLDER / "dataflash_flight.bin.gz", FOLDER / "hang_reboot_ground.tlog.gz"
COMPANION = FOLDER / "hang_reboot_companion.tlog.gz"


def entries(path: Path, *kinds: str) -> list[tuple[str, str]]:
    """What and text of the entries of these kinds."""
    rows = report(path)["other"]["rows"]
    return [(row["what"], row["text"]) for row in rows if row["what"] in kinds]


def test_a_dataflash_log_has_modes_arming_errors_and_the_lines_of_phm() -> None:
    """Times are those of the GPS; the system is the vehicle's; PHM's lines have their sender and level."""
    made = report(DATAFLASH)
    rows = made["other"]["rows"]
    assert [(row["what"], row["text"]) for row in rows if row["what"] != "statustext"] == [
        ("mode", "STABILIZE"),
        ("error", "COMPASS resolved"),
        ("mode", "GUIDED"),
        ("arming", "armed"),
        ("mode", "LAND"),
        ("arming", "disarmed"),
    ]
    ours = [row for row in rows if row["by"] == "1/193"]
    assert [(row["text"], row["level"]) for row in ours if row["level"]] == [
        ("A01 WARN 9 CPU 100 %", "WARN"),
        ("A01 WARN 1------- 9 CPU 100 %", "WARN"),
    ]
    assert {row["system"] for row in rows} == {1} and {row["agent"] for row in rows} == {"vehicle 1"}
    assert [round(flight["duration_s"]) for flight in made["flights"]] == [47]


def test_times_and_texts_of_a_dataflash_log_are_those_of_pymavlink(tmp_path: Path) -> None:
    """pymavlink's own reader, which shares no code, reads the same texts; its clock differs by the first GPS message alone."""
    file = tmp_path / "1.bin"
    file.write_bytes(gzip.decompress(DATAFLASH.read_bytes()))
    reader, theirs = DFReader.DFReader_binary(str(file)), []
    while (entry := reader.recv_match(type="MSG")) is not None:
        theirs.append((entry._timestamp, entry.Message))
    reader.close()
    mine = [(event.utc_s, event.text) for event in read_dataflash(file)[0] if event.event == "statustext"]
    assert [text.removeprefix("SRC=1/193:") for _, text in theirs] == [text for _, text in mine]
    assert max(abs(t - utc_s) for (t, _), (utc_s, _) in zip(theirs, mine, strict=True)) < 0.5


def test_a_telemetry_log_has_modes_arming_and_texts_of_both_directions() -> None:
    """The companion's log has PHM's own frames; the state of the reboot is in it too."""
    assert entries(COMPANION, "mode", "arming") == [
        ("mode", "STABILIZE"),
        ("mode", "GUIDED"),
        ("arming", "armed"),
        ("mode", "LAND"),
        ("arming", "disarmed"),
        ("mode", "STABILIZE"),
    ]
    rows = report(COMPANION)["other"]["rows"]
    assert {row["by"] for row in rows if row["what"] == "statustext"} == {"1/1", "1/193"}
    assert entries(TLOG, "arming") == [("arming", "armed"), ("arming", "disarmed")]


def test_entries_belong_to_the_agent_with_this_system_and_to_its_time(tmp_path: Path) -> None:
    """An agent's log decides the time of the report; entries outside of it are counted, not shown."""
    made = Flown(tmp_path / "log")
    made.until(60)
    made.close()
    frames = [(T0 + 10.0, "in flight"), (T0 + 4000.0, "later")]
    (tmp_path / "x.tlog").write_bytes(b"".join(stamped(t, status_text(text)) for t, text in frames))
    found = report(tmp_path)
    assert [(row["agent"], row["text"]) for row in found["other"]["rows"]] == [("agent_1", "in flight")]
    assert (found["other"]["outside"], len(found["agents"])) == (1, 1)
    assert "in flight" in page.render(found)


def test_the_terminal_and_markdown_show_them() -> None:
    """A separate table, and texts without a level only where there is room."""
    shown = CliRunner().invoke(group, ["report", str(DATAFLASH)], env={"COLUMNS": "200"})
    assert shown.exit_code == 0 and "Records of others" in shown.output
    assert "1/193: A01 WARN 9 CPU 100 %" in shown.output and "GUIDED" in shown.output
    assert "disarmed" in CliRunner().invoke(group, ["report", str(DATAFLASH), "--markdown"]).output


def test_failsafes_and_errors_are_distinguished(tmp_path: Path) -> None:
    """By the subsystem; a code of 0 ends it."""
    plain = gzip.decompress(DATAFLASH.read_bytes())
    (err,) = (
        place for place in range(len(plain)) if plain[place : place + 2] == b"\xa3\x95" and name(plain, place) == "ERR"
    )
    kind = plain[err : err + 3]
    added = [kind + struct.pack("<QBB", 60_000_000, 8, 1), kind + struct.pack("<QBB", 70_000_000, 8, 0)]
    file = tmp_path / "1.BIN"
    file.write_bytes(plain + b"".join(added))
    found = [(event.event, event.text, event.level) for event in read_dataflash(file)[0] if event.event == "failsafe"]
    assert found == [("failsafe", "FAILSAFE_GCS code 1", "ERROR"), ("failsafe", "FAILSAFE_GCS resolved", "")]


def test_a_log_without_the_time_of_a_gps_is_left_out_and_named(tmp_path: Path) -> None:
    """Its times would be wrong by an unknown amount; the command says so and fails."""
    file = tmp_path / "1.bin"
    file.write_bytes(gzip.decompress((FOLDER / "dataflash.bin.gz").read_bytes()))
    events, _ = read_dataflash(file)
    assert events and not any(event.placed for event in events)
    result = CliRunner().invoke(group, ["report", str(file)])
    assert result.exit_code == 1 and "no time of a GPS" in result.output and str(file) in result.output


def test_long_texts_are_put_together(tmp_path: Path) -> None:
    """STATUSTEXT in two parts is one entry."""
    parts = [status_text("x" * 50, 7, 0), status_text("end", 7, 1)]
    file = tmp_path / "1.tlog"
    file.write_bytes(b"".join(stamped(T0, part) for part in parts))
    assert [event.text for event in source_tlog.read(FileSegment(str(file)), Problems())] == ["x" * 50 + "end"]


@pytest.mark.parametrize("length", [0, 1, 2, 4])
def test_an_impossible_length_does_not_hold_the_reader(tmp_path: Path, length: int) -> None:
    """A hostile FMT message with a length of 0 has no end for pymavlink's index in Python."""
    plain = bytearray(gzip.decompress(DATAFLASH.read_bytes()))
    place = next(at for at in range(0, len(plain), 89) if plain[at + 5 : at + 8] == b"MSG")
    plain[place + 4] = length
    file = tmp_path / "1.bin"
    file.write_bytes(plain)
    events, problems = read_dataflash(file)
    assert events and any("impossible length" in what for what, _ in problems.found)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_damage_never_raises_and_is_named(data: st.DataObject) -> None:
    """Bytes that were changed, removed or added in both kinds, compressed too: what is left is read."""
    path, read = data.draw(st.sampled_from([(DATAFLASH, source_dataflash.read), (TLOG, source_tlog.read)]))
    content = bytearray(path.read_bytes() if data.draw(st.booleans()) else gzip.decompress(path.read_bytes()))
    for _ in range(data.draw(st.integers(1, 6))):
        begin = data.draw(st.integers(0, len(content) - 1))
        content[begin : begin + data.draw(st.integers(0, 300))] = data.draw(st.binary(max_size=300))
        content = content or bytearray(b"x")
    with tempfile.NamedTemporaryFile() as file:
        file.write(content)
        file.flush()
        assert all(len(event.text) < 20_000 for event in read(FileSegment(file.name), Problems()))


def test_a_torn_end_costs_the_last_entry_alone(tmp_path: Path) -> None:
    """What is before it is read, and the tear is named."""
    for path, read in ((DATAFLASH, source_dataflash.read), (TLOG, source_tlog.read)):
        plain = gzip.decompress(path.read_bytes())
        whole, torn = tmp_path / "whole", tmp_path / "torn"
        whole.write_bytes(plain)
        torn.write_bytes(plain[:-5])
        problems = Problems()
        every, left = list(read(FileSegment(str(whole)), Problems())), list(read(FileSegment(str(torn)), problems))
        assert len(every) - 1 <= len(left) <= len(every) and problems.found


def test_other_files_are_not_taken_for_records(tmp_path: Path) -> None:
    """A kind is recognized by its content, and PHM's log stays one."""
    (tmp_path / "a.bin").write_bytes(b"\0" * 100)
    (tmp_path / "b.tlog").write_bytes(b"not a log, but longer than a stamp")
    (tmp_path / "c.gz").write_bytes(b"\x1f\x8b broken")
    with pytest.raises(record_reader.NoRecord):
        record_reader.find([str(tmp_path)])


def read_dataflash(file: Path) -> tuple[list[Any], Problems]:
    problems = Problems()
    return list(source_dataflash.read(FileSegment(str(file)), problems)), problems


def name(plain: bytes, place: int) -> str:
    """Name of the message at this place, by the FMT messages."""
    known = {
        plain[at + 3]: plain[at + 5 : at + 9].rstrip(b"\0").decode()
        for at in range(0, place, 89)
        if plain[at : at + 3] == b"\xa3\x95\x80"
    }
    return known.get(plain[place + 2], "")


def status_text(text: str, number: int = 0, part: int = 0) -> bytes:
    from phm.transport.dialect import mavlink

    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return bytes(mavlink.MAVLink_statustext_message(4, text.encode(), number, part).pack(link))


def stamped(t: float, frame: bytes) -> bytes:
    return int(t * 1e6).to_bytes(8, "big") + frame


def test_texts_of_an_entry_are_limited() -> None:
    """A line of JSON may claim to be one: its texts are cut, an unknown level is none."""
    made = ExternalEntry.of(
        Event("mode", system=1, utc_s=T0, text="x" * 10_000, by="y" * 10_000, level="z" * 10_000), "file"
    )
    assert made is not None and (len(made.text), len(made.by), made.level) == (200, 20, "")
    for system, utc_s in ((None, T0), (0, T0), (256, T0), (1, 5.0), (1, float("nan")), (1, float("inf"))):
        assert ExternalEntry.of(Event("mode", system=system, utc_s=utc_s), "file") is None
