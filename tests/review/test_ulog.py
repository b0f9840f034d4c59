"""Logs of PX4 in the report. Their files are written by the documented format (`crafted_ulog`)."""

from __future__ import annotations

import gzip
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from phm.review import source_ulog, tables
from phm.review.events import Event
from phm.review.external_entry import ExternalEntry, text_event
from phm.review.lines import FileSegment, Problems
from tests.review import crafted_ulog
from tests.review.records import T0, report
from tests.review.test_external_clocks import THREE, flown


def read(file: Path) -> tuple[list[Any], Problems]:
    problems = Problems()
    return list(source_ulog.read(FileSegment(str(file)), problems)), problems


def test_modes_arming_failsafes_and_texts_have_the_time_of_the_gps(tmp_path: Path) -> None:
    """On the row of the vehicle with the system of MAV_SYS_ID; compressed too."""
    (tmp_path / "1.ulg.gz").write_bytes(gzip.compress(crafted_ulog.log(T0 + 50)))
    made = report(tmp_path)
    rows = [(round(row["t"] - T0, 1), row["what"], row["text"], row["level"]) for row in made["other"]["rows"]]
    assert rows == [
        (10.0, "mode", "AUTO.LOITER", ""),
        (60.0, "arming", "armed", ""),
        (61.0, "statustext", "Takeoff detected", ""),
        (80.0, "mode", "OFFBOARD", ""),
        (82.0, "statustext", "Ready for takeoff!", ""),
        (90.0, "failsafe", "failsafe active", "ERROR"),
        (90.0, "mode", "AUTO.RTL", ""),
        (90.5, "statustext", "Failsafe activated", "WARN"),
        (95.0, "failsafe", "failsafe ended", ""),
        (120.0, "arming", "disarmed", ""),
    ]
    assert {row["agent"] for row in made["other"]["rows"]} == {"vehicle 7"}
    assert [round(flight["duration_s"]) for flight in made["flights"]] == [60]


def test_a_log_without_a_fix_is_left_out_and_named(tmp_path: Path) -> None:
    """Its times are not known, alone and beside a log of PHM of which it has no line."""
    file = tmp_path / "1.ulg"
    file.write_bytes(crafted_ulog.log(T0, fix=False))
    for alone in (True, False):
        if not alone:
            flown(tmp_path / "log", times=THREE)
        made = report(tmp_path)
        assert made["other"] == {"outside": 0, "left_out": 0, "rows": []} and made["clocks"]["others"] == []
        assert [agent["agent"] for agent in made["agents"]] == ([] if alone else ["agent_1"])
        (problem,) = made["files"]["problems"]
        assert problem["file"] == str(file) and "no time of a GPS" in problem["what"]


def test_lines_of_phm_place_a_log_without_a_fix(tmp_path: Path) -> None:
    """An autopilot that flies indoors: boot was 7 s after T0, and each line arrived 0.2 s after it was written."""
    lines = flown(tmp_path / "log", 7, times=THREE)
    texts = [crafted_ulog.text(at + 0.2 - 7.0, 4, text) for at, text in lines]
    file = tmp_path / "1.ulg"
    file.write_bytes(crafted_ulog.log(T0, fix=False) + b"".join(texts))
    made = report(tmp_path)
    (clock,) = made["clocks"]["others"]
    assert (clock["applied"], clock["lines"], clock["offset_s"]) == (True, 6, None)
    times = {row["text"]: row["t"] - T0 for row in made["other"]["rows"] if row["what"] == "statustext"}
    assert times["Failsafe activated"] == pytest.approx(90.5 + 7.0 - 0.2, abs=0.05)
    assert clock["error_s"] >= 1.0 and not made["files"]["problems"]
    assert "had no time" in tables.markdown(made)


def test_one_failure_does_not_place_a_log_without_a_fix(tmp_path: Path) -> None:
    """A node that dies says the same each day: lines in three moments are needed."""
    lines = flown(tmp_path / "log", 7, times=THREE)
    texts = [crafted_ulog.text(at, 4, text) for at, text in lines[:4]]
    (tmp_path / "1.ulg").write_bytes(crafted_ulog.log(T0, fix=False) + b"".join(texts))
    made = report(tmp_path)
    assert made["other"]["rows"] == [] and len(made["files"]["problems"]) == 1


def test_after_damage_it_continues_at_the_next_synchronization(tmp_path: Path) -> None:
    """Bytes that are not a message cost what is before the next message SYNC, and are named."""
    plain = crafted_ulog.log(T0 + 50)
    place = plain.index(crafted_ulog.status(60, 2, 4))
    file = tmp_path / "1.ulg"
    file.write_bytes(plain[:place] + b"\xff\xff\xff" + plain[place:])
    events, problems = read(file)
    assert "OFFBOARD" in [event.text for event in events] and "Takeoff detected" not in [event.text for event in events]
    assert any("not a message of a ULog" in what for what, _ in problems.found)


def test_types_within_types_are_not_expanded(tmp_path: Path) -> None:
    """A definition of 65,000 to the power of 6 fields costs nothing, one that contains itself ends."""
    bombs = [f"t{each}:t{each + 1}[65000] x;" for each in range(6)] + ["t6:uint8_t x;", "t7:t7 x;"]
    evil = [
        crafted_ulog.message("F", each.encode()) for each in (*bombs, "vehicle_status:t0 x;t7 y;uint64_t timestamp;")
    ]
    file = tmp_path / "1.ulg"
    file.write_bytes(
        crafted_ulog.log(T0 + 50)[:16] + b"".join(evil) + crafted_ulog.message("A", b"\0\1\0vehicle_status")
    )
    events, problems = read(file)
    assert not events and any("damaged message" in what for what, _ in problems.found)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[32mReady for takeoff!\x1b[0m", "Ready for takeoff!"),
        ("\x1b[1;31;48;5;1mred\x1b[K", "red"),
        ("\x1b]0;title\x07said\x1b]8;;x\x1b\\link", "saidlink"),
        ("Takeoff detected\t", "Takeoff detected"),
        ("torn \x1b[3", "torn \\x1b[3"),
        ("torn \x1b]no end", "torn no end"),
        ("two\nlines", "two\\nlines"),
        ("\x1b[31m" * 100 + "after many", "after many"),
    ],
)
def test_texts_have_no_escape_sequences(text: str, shown: str) -> None:
    """Of PX4's logs and of nodes of ROS 2; what remains of a damaged one is shown as an escape."""
    for event in (text_event(1, T0, text), Event("rosout", system=1, utc_s=T0, text=text)):
        made = ExternalEntry.of(event, "file")
        assert made is not None and made.text == shown


def test_a_coloured_line_of_phm_has_its_level() -> None:
    """The colour does not belong to the line."""
    assert text_event(1, T0, "\x1b[31mA01 FAIL 6 node_1 dead").level == "ERROR"


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_damage_never_raises(data: st.DataObject) -> None:
    """Bytes that were changed, removed or added: what is left is read."""
    content = bytearray(crafted_ulog.log(T0 + 50))
    for _ in range(data.draw(st.integers(1, 6))):
        begin = data.draw(st.integers(0, len(content) - 1))
        content[begin : begin + data.draw(st.integers(0, 40))] = data.draw(st.binary(max_size=40))
        content = content or bytearray(b"x")
    with tempfile.NamedTemporaryFile() as file:
        file.write(content)
        file.flush()
        assert len(read(Path(file.name))[0]) < 1000


def test_types_without_fields_are_refused(tmp_path: Path) -> None:
    """Many fields of no size would be counted for hours."""
    empty = ["e:", *(f"n{each}:" + f"{'e' if each == 0 else f'n{each - 1}'} x;" * 3000 for each in range(6))]
    evil = [
        crafted_ulog.message("F", each.encode()) for each in (*empty, "vehicle_status:n5 x;e[-3] y;uint64_t timestamp;")
    ]
    file = tmp_path / "1.ulg"
    file.write_bytes(
        crafted_ulog.log(T0 + 50)[:16] + b"".join(evil) + crafted_ulog.message("A", b"\0\1\0vehicle_status")
    )
    assert not read(file)[0]
