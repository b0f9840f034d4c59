"""Records of others get PHM's time by the lines of PHM in them, with an error that is stated."""

from __future__ import annotations

import gzip
import random
import shutil
import struct
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.core.model import Level, Slot
from phm.transport.dialect import mavlink
from phm.wire import status_line
from tests.fakes.recorded_flight import FOLDER
from tests.review.records import T0, Flown, report
from tests.review.test_autopilot_records import DATAFLASH, stamped

PHM_LOG = FOLDER / "streams_phm.jsonl.gz"
OTHER_SESSION = FOLDER / "hang_reboot_ground.tlog.gz"
"""Recorded five minutes before it, with one failure that says the same."""
UNITS = {"nodes/node_1": 6, "container/ros_app": 2, "rates/topic_1": 8}


def clock_of(made: dict[str, Any], file: Path) -> dict[str, Any]:
    return next(row for row in made["clocks"]["others"] if row["file"] == file.name)


def received(at: float, text: str, agent: int = 1) -> bytes:
    """A line of PHM as a telemetry log has it, received at this many seconds since T0 by the recorder's clock."""
    link = mavlink.MAVLink(None, srcSystem=agent, srcComponent=193)
    return stamped(T0 + at, bytes(mavlink.MAVLink_statustext_message(4, text.encode()).pack(link)))


def flown(folder: Path, number: int = 1, *, times: dict[float, str], start: float = 0.0) -> list[tuple[float, str]]:
    """An agent of which these units fail at these times; the lines that PHM sent, by true seconds since T0."""
    made, lines = Flown(folder, number, start=start), list[tuple[float, str]]()
    for at, unit in times.items():
        made.until(at)
        slot = Slot(UNITS[unit])
        lines.append((at, status_line.failing(number, Level.ERROR, slot, f"{unit} gone")))
        made.fail(unit, lasts=4.0)
        lines.append((at + 4.0, status_line.recovered(number, slot, f"{unit} gone", "restart")))
    made.until(max(times) + 60)
    made.close()
    return lines


THREE = {100.0: "nodes/node_1", 173.0: "container/ros_app", 311.0: "rates/topic_1"}


def test_a_recorded_dataflash_log_gets_the_time_of_the_phm_beside_it(tmp_path: Path) -> None:
    """Recorded: the GPS time of ArduPilot's simulation was 2.2 s behind the computer's clock; its lines say so."""
    log = tmp_path / "phm.jsonl.gz"
    shutil.copy(PHM_LOG, log)
    shutil.copy(DATAFLASH, tmp_path / DATAFLASH.name)
    made = report(tmp_path)
    clock = clock_of(made, DATAFLASH)
    assert (clock["applied"], clock["lines"]) == (True, 13)
    assert clock["offset_s"] == pytest.approx(2.16, abs=0.05) and 1.0 < clock["error_s"] < 1.5
    (change,) = [row for row in made["other"]["rows"] if row["text"] == "A01 WARN 9 CPU 100 %"]
    # PHM's own log has this line at 1795306586.266.
    assert change["t"] == pytest.approx(1_795_306_586.266, abs=0.1)
    shown = CliRunner().invoke(group, ["report", str(tmp_path)], env={"COLUMNS": "200"}).output
    assert "+2.16 s" in shown and "13 lines or diagnostics of PHM that are also in its log" in shown


@pytest.mark.parametrize("wrong_s", [-86_400.0, -7.5, 0.0, 3600.0])
def test_the_offset_is_right_within_its_error(tmp_path: Path, wrong_s: float) -> None:
    """The recorder's clock is wrong, and each line came with its own delay; entries without a line move, too."""
    lines = flown(tmp_path / "log", times=THREE)
    delays = (0.1, 0.9, 0.2, 0.4, 0.3, 0.2)
    frames = [received(at + delay + wrong_s, text) for (at, text), delay in zip(lines, delays, strict=True)]
    file = tmp_path / "ground.tlog"
    file.write_bytes(b"".join([*frames, received(350.0 + wrong_s, "Mission: 1 Takeoff")]))
    made = report(tmp_path)
    clock = clock_of(made, file)
    assert (clock["applied"], clock["lines"]) == (True, 6)
    assert abs(clock["offset_s"] + wrong_s) <= clock["error_s"] < 2.5
    assert clock["offset_s"] <= -wrong_s, "a line is never received before it was written"
    (other,) = [row for row in made["other"]["rows"] if row["text"] == "Mission: 1 Takeoff"]
    assert other["t"] == pytest.approx(T0 + 350.0, abs=clock["error_s"])


def messages(log: bytes, lines: list[tuple[float, str]]) -> bytes:
    """Messages MSG as ArduPilot writes them for lines that it received, by seconds since its boot."""
    head = b"\xa3\x95\x80"
    starts = (place for place in range(len(log)) if log[place : place + 3] == head)
    kind = next(log[place + 3 : place + 4] for place in starts if log[place + 5 : place + 9] == b"MSG\0")
    said = ((at, f"SRC=1/193:{text}".encode()) for at, text in lines)
    return b"".join(b"\xa3\x95" + kind + struct.pack("<Q64s", int(at * 1e6), text) for at, text in said)


def test_lines_of_phm_place_a_dataflash_log_without_a_gps(tmp_path: Path) -> None:
    """A recorded log that never had a fix, with lines of PHM about changes added to it; boot was 50 s after T0."""
    lines = flown(tmp_path / "log", times=THREE)
    plain = gzip.decompress((FOLDER / "dataflash.bin.gz").read_bytes())
    file = tmp_path / "1.bin"
    file.write_bytes(plain + messages(plain, [(at + 0.1 - 50.0, text) for at, text in lines]))
    made = report(tmp_path)
    clock = clock_of(made, file)
    assert (clock["applied"], clock["offset_s"]) == (True, None) and clock["lines"] >= 6
    ours = [row for row in made["other"]["rows"] if row["text"] in {text for _, text in lines}]
    assert [row["t"] - T0 for row in ours] == [pytest.approx(at, abs=0.02) for at, _ in lines]
    assert len(made["other"]["rows"]) > len(ours), "what the autopilot itself logged is placed, too"


def test_a_recorded_session_of_seconds_does_not_place_a_log_without_a_gps(tmp_path: Path) -> None:
    """The session above, without the messages of its GPS: its changes are of too few moments."""
    shutil.copy(PHM_LOG, tmp_path / "phm.jsonl.gz")
    plain = gzip.decompress(DATAFLASH.read_bytes())
    place = next(place for place in range(len(plain)) if plain[place : place + 9].endswith(b"GPS\0"))
    (tmp_path / "1.bin").write_bytes(plain[: place + 5] + b"GPX\0" + plain[place + 9 :])
    made = report(tmp_path)
    assert made["other"]["rows"] == [] and "no time of a GPS" in made["files"]["problems"][0]["what"]


def test_lines_that_waited_for_the_link_do_not_move_it(tmp_path: Path) -> None:
    """A queue of old lines that arrives together is outside of the window, and does not count."""
    lines = flown(tmp_path / "log", times=THREE)
    late = {2: 40.0, 3: 36.0}
    frames = [received(at + late.get(place, 0.2) + 60.0, text) for place, (at, text) in enumerate(lines)]
    file = tmp_path / "ground.tlog"
    file.write_bytes(b"".join(frames))
    clock = clock_of(report(tmp_path), file)
    assert clock["lines"] == 4 and clock["offset_s"] == pytest.approx(-60.2, abs=0.01)


def test_a_line_that_comes_twice_counts_once(tmp_path: Path) -> None:
    """Lines are paired in order, each with one."""
    lines = flown(tmp_path / "log", times=THREE)
    file = tmp_path / "ground.tlog"
    file.write_bytes(b"".join(received(at + again, text) for at, text in lines for again in (0.1, 1.3)))
    assert clock_of(report(tmp_path), file)["lines"] == 6


def test_too_few_lines_leave_the_clock_as_it_says(tmp_path: Path) -> None:
    """Two lines could agree by chance; regular lines alone fit many offsets. The reason is in the report."""
    lines = flown(tmp_path / "log", times=THREE)
    few, regular, none = tmp_path / "few.tlog", tmp_path / "regular.tlog", tmp_path / "none.tlog"
    few.write_bytes(b"".join(received(at + 60.0, text) for at, text in lines[:2]))
    regular.write_bytes(b"".join(received(at + 5.0, "A01 OK 11111111") for at in range(20, 300, 20)))
    none.write_bytes(received(100.0, "Mission: 1 Takeoff"))
    made = report(tmp_path)
    assert not any(clock["applied"] for clock in made["clocks"]["others"])
    assert clock_of(made, few)["by"].startswith("its own clock: 2 lines about changes and 0 regular ones agree")
    assert clock_of(made, regular)["by"] == clock_of(made, none)["by"]
    (entry,) = [row for row in made["other"]["rows"] if row["text"] == "Mission: 1 Takeoff"]
    assert entry["t"] == T0 + 100.0


def test_two_offsets_with_as_many_lines_decide_nothing(tmp_path: Path) -> None:
    """The same failures 200 s apart, of which the record has only one set: it may be either."""
    again = {**THREE, **{at + 300.0: unit for at, unit in THREE.items()}}
    lines = flown(tmp_path / "log", times=dict(sorted(again.items())))
    file = tmp_path / "ground.tlog"
    file.write_bytes(b"".join(received(at + 60.0, text) for at, text in lines[:6]))
    clock = clock_of(report(tmp_path), file)
    assert (clock["applied"], clock["offset_s"]) == (False, None) and clock["by"].endswith("fit several offsets")


def test_records_with_the_same_name_have_separate_clocks(tmp_path: Path) -> None:
    """Autopilots number their logs: 00000001.BIN of two vehicles are two records."""
    for number, wrong_s in ((1, 30.0), (2, -45.0)):
        folder = tmp_path / f"agent_{number}"
        lines = flown(folder, number, times=THREE)
        (folder / "1.tlog").write_bytes(b"".join(received(at + wrong_s, text, number) for at, text in lines))
    offsets = [clock["offset_s"] for clock in report(tmp_path)["clocks"]["others"]]
    assert offsets == [pytest.approx(-30.0), pytest.approx(45.0)]


def test_hostile_lines_neither_raise_nor_move_anything(tmp_path: Path) -> None:
    """Impossible agents and slots, and thousands of equal lines."""
    flown(tmp_path / "log", times=THREE)
    texts = ["A999 FAIL 99 x", "A01 FAIL 6", "A01 OK 99 x", "A01 WARN 0 y", "A01 FAIL 6 nodes/node_1 gone"]
    file = tmp_path / "ground.tlog"
    file.write_bytes(b"".join(received(place * 1.5, texts[place % len(texts)]) for place in range(3000)))
    assert not clock_of(report(tmp_path), file)["applied"]


def test_a_record_of_the_end_of_a_long_log_is_compared_with_that_end(tmp_path: Path) -> None:
    """A unit that fails again and again says the same each time, more often than all can be compared."""
    draw = random.Random(3)
    lines = flown(
        tmp_path / "log", times={100.0 + 50.0 * at + draw.uniform(0, 30): "nodes/node_1" for at in range(100)}
    )
    file = tmp_path / "ground.tlog"
    file.write_bytes(b"".join(received(at + 20.0, text) for at, text in lines[-20:]))
    clock = clock_of(report(tmp_path), file)
    assert (clock["applied"], clock["lines"]) == (True, 20)
    assert clock["offset_s"] == pytest.approx(-20.0, abs=0.01)


def test_a_log_of_the_end_of_a_long_record_is_compared_with_that_end(tmp_path: Path) -> None:
    """The other way round: the record is of the entire day, and the first runs of PHM were not collected."""
    draw = random.Random(5)
    times = [5000.0 + 50.0 * at + draw.uniform(0, 30) for at in range(10)]
    lines = flown(tmp_path / "log", times=dict.fromkeys(times, "nodes/node_1"), start=4900.0)
    before = [(30.0 * at + draw.uniform(0, 20), lines[at % 2][1]) for at in range(150)]
    file = tmp_path / "ground.tlog"
    file.write_bytes(b"".join(received(at + 20.0, text) for at, text in [*before, *lines]))
    clock = clock_of(report(tmp_path), file)
    assert (clock["applied"], clock["lines"]) == (True, 20)
    assert clock["offset_s"] == pytest.approx(-20.0, abs=0.01)


def test_a_recorded_log_of_another_session_stays_where_it_was(tmp_path: Path) -> None:
    """One failure of both sessions says the same: failure, recovery and a regular line. The flight before is not moved into this one."""
    for file in (PHM_LOG, OTHER_SESSION):
        shutil.copy(file, tmp_path / file.name)
    made = report(tmp_path)
    clock = clock_of(made, OTHER_SESSION)
    assert (clock["applied"], clock["offset_s"]) == (False, None)
    assert clock["by"] == (
        "its own clock: of the lines about changes that are also in PHM's log, 2 agree at +305.2 s, "
        "less than half of the 5 that both records can have"
    )
    assert not made["other"]["rows"] and made["other"]["outside"] > 20


def test_lines_of_another_day_do_not_agree_often_enough(tmp_path: Path) -> None:
    """Three failures at the same distances, but PHM's log has none of the others that the record has in this time."""
    lines = flown(tmp_path / "log", times=THREE)
    more = [status_line.failing(1, Level.ERROR, Slot.NODES, f"nodes/node_{number} gone") for number in range(2, 12)]
    file = tmp_path / "ground.tlog"
    theirs = sorted([*lines, *((110.0 + 15 * place, text) for place, text in enumerate(more))])
    file.write_bytes(b"".join(received(at + 86_400.0, text) for at, text in theirs))
    clock = clock_of(report(tmp_path), file)
    assert not clock["applied"]
    assert clock["by"].endswith("6 agree at -86400.0 s, less than half of the 16 that both records can have")


def test_repeated_lines_about_what_still_fails_are_no_evidence_against_an_offset(tmp_path: Path) -> None:
    """What fails is sent again to a ground station that comes back, with other words."""
    made, lines = Flown(tmp_path / "log"), list[tuple[float, str]]()
    for at, unit in THREE.items():
        made.until(at)
        lines.append((at, status_line.failing(1, Level.ERROR, Slot(UNITS[unit]), f"{unit} gone")))
        again = status_line.failing(1, Level.ERROR, Slot(UNITS[unit]), f"{unit} gone for long")
        lines += [(at + wait, again) for wait in (10.0, 17.0, 23.0)]
        made.fail(unit, lasts=30.0)
    made.until(400.0)
    made.close()
    file = tmp_path / "ground.tlog"
    file.write_bytes(b"".join(received(at + 3600.0, text) for at, text in lines))
    clock = clock_of(report(tmp_path), file)
    assert clock["applied"] and clock["offset_s"] == pytest.approx(-3600.0, abs=0.01)
