"""The JSON log is the record: every event, complete, one line each, however the process ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from phm.core.model import ActionEvent, Event, Level, Note, Outcome, Phase, Report, ReportStarted, Slot
from phm.core.settings import LogSettings, Settings
from phm.reporters.log import LogReporter
from phm.reporters.rotating_file import FIRST_RETRY_S, RING_LINES, RotatingFile
from phm.reporters.text_log_format import MAX_BYTES
from phm.testing import FakeClock
from phm.wire import json_log
from tests.fakes.records import at, closed, context, opened, transition, unit

DEAD = unit(
    "nodes/agent_1/node_1",
    Slot.NODES,
    Level.ERROR,
    "Node /agent_1/node_1 is not running, expected 1, seen 0: look at its log",
    brief="node_1 dead",
    condition="gone",
    target="ros_app",
    values={"seen": 0, "rate_hz": float("nan")},
    fault="ab12-1",
    duration_s=0.0123,
)
HEAD = {"v", "agent", "agent_id", "boot_id", "seq", "mono", "utc", "utc_s", "event", "kind"}


def make(
    directory: Path, clock: FakeClock | None = None, *, armed: Callable[[], bool | None] = lambda: None, **log: object
) -> LogReporter:
    """armed: whether the autopilot is."""
    settings = Settings(
        log=LogSettings(directory=str(directory), **log),  # type: ignore[arg-type]
        state_dir=str(directory / "state"),
    )
    return LogReporter.build(replace(context(settings, clock=clock), reported_armed=armed))


def written(directory: Path, *events: Event) -> list[dict[str, object]]:
    """The lines of the events, without the first line (`start`)."""
    log = make(directory)
    for event in events:
        log.handle(event)
    log.close()
    return list(json_log.read(directory))[1:]


def test_a_disk_that_hangs_does_not_keep_phm_from_starting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The log's own thread writes the first line, before all others, also if PHM ends immediately."""
    with monkeypatch.context() as patched:
        patched.setattr(RotatingFile, "retry", lambda *_, **__: pytest.fail("it waits for the disk"))
        log = make(tmp_path)
    log.close()
    assert [line["event"] for line in json_log.read(tmp_path)] == ["start"]
    assert [line["event"] for line in written(tmp_path, Note(at(1), "NOTE", "hello"))] == ["start", "note"]


def test_every_line_has_agent_boot_number_and_time(tmp_path: Path) -> None:
    """Agent, boot, number and both clocks are in each line, and numbers have no gap."""
    started = ReportStarted(at(), 1)
    report = Report(at(2), 1, at(), (DEAD, unit("host", Slot.HOST)))
    log = make(tmp_path)
    for event in (started, transition(DEAD), opened(DEAD), report, Note(at(), "NOTE", "kill")):
        log.handle(event)
    lines = list(json_log.read(tmp_path))
    assert [line["event"] for line in lines] == [
        "start",
        "report_started",
        "transition",
        "fault_opened",
        "unit",
        "unit",
        "report",
        "cost",
        "note",
    ]
    assert [line["seq"] for line in lines] == list(range(1, 10))
    assert all(set(line) >= HEAD for line in lines)
    first = lines[1]
    assert (first["v"], first["agent"], first["agent_id"], first["boot_id"]) == (2, "agent_1", 1, "boot12345678")
    assert (first["utc"], first["utc_s"], first["mono"]) == ("2026-03-01T12:00:00.123Z", 1772366400.123, 100.0)


def test_a_transition_has_all_keys(tmp_path: Path) -> None:
    """The keys of `docs/reference/logs.md`, with their values."""
    (line,) = written(tmp_path, transition(DEAD))
    assert {key: line[key] for key in set(line) - HEAD} == {
        "unit": "nodes/agent_1/node_1",
        "check": "nodes",
        "slot": 6,
        "layer": "ros",
        "level": "ERROR",
        "old": "OK",
        "changed_text": False,
        "summary": DEAD.result.summary,
        "brief": "node_1 dead",
        "condition": "gone",
        "target": "ros_app",
        "values": {"seen": 0, "rate_hz": None},
        "bypass": False,
        "blocked_by": "",
        "fault": "ab12-1",
        "since": "2026-03-01T12:00:00.123Z",
        "duration_ms": 12.3,
    }
    assert line["kind"] == "FAILURE"


def test_a_fault_is_recorded_from_opening_to_outcome(tmp_path: Path) -> None:
    """Opened, acted upon and closed lines share the fault's id; the closing line has outcome, by and duration."""
    act = ActionEvent(at(1), "ab12-1", DEAD.unit, "restart", "ros_app", Phase.STARTED, "", 1)
    lines = written(tmp_path, transition(DEAD), opened(DEAD), act, closed(DEAD, Outcome.RESOLVED, "restart", 4.5))
    assert [line["event"] for line in lines] == ["transition", "fault_opened", "action", "fault_closed"]
    assert {line["fault"] for line in lines} == {"ab12-1"}
    assert (lines[1]["outcome"], lines[1]["closed"], lines[1]["duration_s"]) == ("open", None, None)
    assert (lines[2]["phase"], lines[2]["slot"], lines[2]["attempt"]) == ("started", 6, 1)
    end = lines[3]
    assert (end["outcome"], end["by"], end["duration_s"], end["kind"]) == ("resolved", "restart", 4.5, "RESOLVED")


def test_a_report_has_counts_array_and_slots(tmp_path: Path) -> None:
    """The same numbers as in the text log; unknown and unused slots are null."""
    line = written(tmp_path, Report(at(2), 3, at(), (DEAD, unit("host", Slot.HOST))))[-2]
    assert (line["successes"], line["failures"], line["number"], line["took_s"]) == (0, 1, 3, 2.0)
    assert line["status_array"] == [None, None, None, None, None, 0, None, None]
    assert line["slots"] == {"6": "ERROR", "9": "OK"}


def test_both_files_contain_the_same_events(tmp_path: Path) -> None:
    """The text log is written beside the record, in its own format."""
    written(tmp_path, transition(DEAD))
    assert (tmp_path / "phm.log").read_text() == (
        "2026-03-01 12:00:00.123 ---- FAILURE: (6) "
        "Node /agent_1/node_1 is not running, expected 1, seen 0: look at its log\n"
    )


def test_text_from_outside_cannot_forge_an_event(tmp_path: Path) -> None:
    """Line breaks, separators and lone surrogates stay inside their JSON string, and are read back unchanged."""
    evil = 'x"}\n{"v":1,"event":"fault_closed"}\u2028\x00\udcff'
    (line,) = written(tmp_path, Note(at(), "DOCKER", evil))
    assert line["text"] == evil
    assert len((tmp_path / "phm.jsonl").read_bytes().splitlines()) == 2
    assert len((tmp_path / "phm.log").read_text().splitlines()) == 1


@pytest.mark.parametrize("char", ["x", "\x00", "無"])
def test_an_oversized_event_is_cut(tmp_path: Path, char: str) -> None:
    """However long a check's result is, a line fits into the smallest log, stays JSON and is marked."""
    long = char * 100_000
    huge = unit(
        "nodes/a", Slot.NODES, Level.ERROR, long, brief=long, condition=long, values={f"k{n}": n for n in range(5000)}
    )
    lines = written(tmp_path, transition(huge), opened(huge), Note(at(), "PHM", long))
    assert len(lines) == 3
    assert all(line["cut"] is True for line in lines)
    assert lines[0]["unit"] == "nodes/a"
    for name in ("phm.log", "phm.jsonl"):
        assert max(map(len, (tmp_path / name).read_bytes().splitlines())) <= MAX_BYTES


def test_lost_lines_leave_a_line_that_explains_the_gap(tmp_path: Path) -> None:
    """Numbers continue without a gap except for one `lost` event, whose `lines` is the size of the gap."""
    clock = FakeClock()
    (tmp_path / "logs").write_text("in the way")
    log = make(tmp_path / "logs", clock)
    for number in range(RING_LINES + 9):
        log.handle(Note(at(number), "DOCKER", f"event {number}"))
    assert "cannot write" in log.problem()
    (tmp_path / "logs").unlink()
    clock.advance(FIRST_RETRY_S)
    log.tick()
    assert log.problem() == ""
    lines = list(json_log.read(tmp_path / "logs"))
    assert (lines[0]["event"], lines[0]["lines"], lines[0]["seq"], lines[0]["reason"]) == (
        "lost",
        10,
        10,
        "File exists",
    )
    assert [line["seq"] for line in lines] == list(range(10, RING_LINES + 11))
    text = (tmp_path / "logs" / "phm.log").read_text().splitlines()
    assert text[0] == "2026-03-01 12:00:08.123 ---- PHM: 9 lines before this one were lost: File exists"


def test_only_faults_and_reports_are_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`log.sync` waits for the disk after important events, not after each line: SD cards wear out."""
    synced: list[int] = []
    monkeypatch.setattr(os, "fdatasync", synced.append)
    log = make(tmp_path, sync="always")
    log.handle(Note(at(), "DOCKER", "x"))
    log.handle(transition(DEAD))
    assert synced == []
    log.handle(opened(DEAD))
    assert len(synced) == 1
    log.handle(Report(at(), 1, at(), (DEAD, DEAD)))
    assert len(synced) >= 2


@pytest.mark.parametrize(
    ("sync", "armed", "expected"),
    [
        ("auto", True, True),
        ("auto", None, True),
        ("auto", False, False),
        ("always", False, True),
        ("never", True, False),
    ],
)
def test_events_are_on_the_disk_within_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sync: str, armed: bool | None, expected: bool
) -> None:
    """`auto`: unless the autopilot reports disarmed, because the power may fail in the air. Once for each change."""
    synced: list[int] = []
    monkeypatch.setattr(os, "fdatasync", synced.append)
    log = make(tmp_path, armed=lambda: armed, sync=sync)
    log.tick()
    synced.clear()
    log.handle(Note(at(), "DOCKER", "x"))
    log.tick()
    assert len(synced) == (2 if expected else 0), "the record and the text"
    log.tick()
    assert len(synced) == (2 if expected else 0), "nothing new"
    assert LogReporter.period_s <= 0.5
    log.close()


def test_a_flight_is_marked_in_both_files(tmp_path: Path) -> None:
    """With its number, from armed to disarmed."""
    state: list[bool | None] = [None]
    log = make(tmp_path, armed=lambda: state[0])
    for armed in (None, True, True, None, False, False):
        state[0] = armed
        log.tick()
    log.close()
    flights = [event for event in json_log.read(tmp_path) if event["event"] == "flight"]
    assert [(event["number"], event["began"], event["kind"]) for event in flights] == [
        (1, True, "FLIGHT"),
        (1, False, "FLIGHT"),
    ]
    text = [line for line in (tmp_path / "phm.log").read_text().splitlines() if "FLIGHT" in line]
    assert text[0].endswith(" ---- FLIGHT: flight 1 began: the autopilot is armed")


WRITER = """
import sys
from phm.core.clock import SystemClock
from phm.core.model import Note, Stamp
from phm.reporters.base import ReporterContext
from phm.runtime.sections import reporter_settings
from phm.reporters.log import LogReporter
from phm.core.settings import LogSettings, Settings
settings = Settings(log=LogSettings(directory=sys.argv[1], max_size=20000, files=100))
log = LogReporter.build(ReporterContext(reporter_settings(settings), SystemClock(), "b", tuple, lambda: True, dict))
number = 0
while True:
    number += 1
    log.handle(Note(Stamp(0.0, 0.0), "NOTE", str(number)))
    print(number, flush=True)
"""


def test_sigkill_loses_no_accepted_line(tmp_path: Path) -> None:
    """A process killed in the middle of writing leaves every line for which `handle` had returned."""
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        pipesize=8192,  # however late this test reads, its files hold all that it can write meanwhile
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if int(line) >= 500:
                process.send_signal(signal.SIGKILL)
                break
        handed_over = 500 + len(process.stdout.read().split())
    recorded = [int(line["text"]) for line in json_log.read(tmp_path) if line["event"] == "note"]
    assert recorded[:handed_over] == list(range(1, handed_over + 1))
    assert len(recorded) - handed_over in (0, 1)
    text = [
        line.rpartition(" ")[2]
        for file in json_log.files(tmp_path / "phm.log")
        for line in file.read_text().split("\n")
    ]
    assert [int(number) for number in text if number][:handed_over] == list(range(1, handed_over + 1))


def test_a_truncated_record_is_readable_and_continued(tmp_path: Path) -> None:
    """After a power cut the truncated line and zero bytes are skipped, and the next boot's lines follow."""
    written(tmp_path, Note(at(), "PHM", "first"))
    content = (tmp_path / "phm.jsonl").read_bytes()
    (tmp_path / "phm.jsonl").write_bytes(content[:-20] + bytes(100))
    lines = written(tmp_path, Note(at(), "PHM", "second"))
    assert [line["event"] for line in lines] == ["start", "note"]
    assert lines[-1]["text"] == "second"


def test_the_reader_takes_rotated_files_in_order_and_skips_other_lines(tmp_path: Path) -> None:
    """Oldest first, by number and not by name; foreign files and lines are ignored."""
    for number in (1, 2, 10):
        (tmp_path / f"phm.jsonl.{number}").write_text(json.dumps({"seq": 100 - number}) + "\n[1]\nnull\n")
    (tmp_path / "phm.jsonl").write_text('{"seq": 100}\n\n{"seq": 101}\n{"seq": 1')
    (tmp_path / "phm.jsonl.bak").write_text('{"seq": 0}\n')
    assert [line["seq"] for line in json_log.read(tmp_path)] == [90, 98, 99, 100, 101]
    assert [line["seq"] for line in json_log.read(tmp_path / "phm.jsonl")] == [90, 98, 99, 100, 101]
    assert list(json_log.read(tmp_path / "nothing.jsonl")) == []


def test_a_rotation_while_reading_neither_repeats_nor_skips(tmp_path: Path) -> None:
    """The lines that exist when reading begins are read once, though files are renamed meanwhile."""
    for name, seq in (("phm.jsonl.1", 1), ("phm.jsonl", 2)):
        (tmp_path / name).write_text(json.dumps({"seq": seq}) + "\n")
    reader = json_log.read(tmp_path)
    seen = [next(reader)["seq"]]
    (tmp_path / "phm.jsonl.1").rename(tmp_path / "phm.jsonl.2")
    (tmp_path / "phm.jsonl").rename(tmp_path / "phm.jsonl.1")
    seen += [line["seq"] for line in reader]
    assert seen == [1, 2]
