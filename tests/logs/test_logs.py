"""`phm logs`: what the log reporter writes is shown, explained, filtered, and followed across rotation."""

from __future__ import annotations

import gzip
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from phm.cli import group, terminal
from phm.core.clock import SystemClock
from phm.core.model import ActionEvent, Event, Level, Note, Outcome, Phase, Report, Slot
from phm.core.settings import Settings
from phm.logs.line_filter import utc_s
from phm.logs.reader import LogReader
from phm.reporters.base import ReporterContext
from phm.reporters.log import LogReporter
from phm.runtime.sections import reporter_settings
from phm.wire.report import unit_json
from tests.fakes.records import at, closed, context, opened, transition, unit
from tests.fakes.until import until

DEAD = unit(
    "nodes/n1",
    Slot.NODES,
    Level.ERROR,
    "Node n1 is not running: restart it.",
    condition="node_missing",
    target="app",
    values={"listed": 0},
    fault="ab12-1",
)

BLOCKED = unit("topics/t1", Slot.TOPICS, Level.STALE, "topic t1 lacks its publisher", blocked_by=DEAD.unit)
STORY: list[Event] = [
    opened(DEAD),
    transition(DEAD),
    transition(BLOCKED, seconds=0.1),
    ActionEvent(at(1.0), "ab12-1", DEAD.unit, "restart", "app", Phase.ADVISED, "restart app"),
    closed(DEAD, Outcome.RESOLVED, "restart", 4.5),
]


def log_of(folder: Path, name: str = "agent_1", **more: Any) -> LogReporter:
    made = {"agent": {"name": name}, "log": {"directory": str(folder), **more}, "state_dir": str(folder / "state")}
    return LogReporter.build(context(Settings.model_validate(made)))


def flying(folder: Path, armed: list[bool], boot: str = "boot12345678") -> LogReporter:
    """armed: one value, whether the autopilot is armed."""
    made = {"log": {"directory": str(folder)}, "state_dir": str(folder / "state")}
    return LogReporter(
        ReporterContext(
            reporter_settings(Settings.model_validate(made)),
            SystemClock(),
            boot,
            tuple,
            lambda: True,
            dict,
            reported_armed=lambda: armed[0],
        )
    )


def record(folder: Path, *events: Event, name: str = "agent_1") -> None:
    log = log_of(folder, name)
    for event in events:
        log.handle(event)
    log.close()


def note(text: str, seconds: float = 0.0) -> Note:
    return Note(at(seconds), "NOTE", text)


def logs(*words: object) -> Result:
    return CliRunner().invoke(group, ["logs", *map(str, words)], env={"COLUMNS": "200"})


def events(*words: object) -> list[dict[str, Any]]:
    result = logs(*words, "--json")
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_a_fault_is_explained_with_cause_values_consequence_and_remedy(tmp_path: Path) -> None:
    """The summary is said once, and the lines below say what is behind it and what to do."""
    record(tmp_path, *STORY)
    shown = logs(tmp_path).output
    for words in (
        "2026-03-01 12:00:00.123 FAILURE (6) nodes/n1: Node n1 is not running: restart it.",
        "cause: node missing in app",
        "values: listed: 0",
        "see: phm faults ab12-1",
        "STALE (7) topics/t1: topic t1 lacks its publisher",
        "cause: blocked by nodes/n1",
        "remedy: phm approve ab12-1",
        "RESOLVED (6) nodes/n1: resolved by restart after 4.5 s",
    ):
        assert words in shown
    assert shown.count("Node n1 is not running") == 1
    assert "cause:" not in logs(tmp_path, "--brief").output


def test_the_command_that_is_named_shows_the_fault_of_the_log_that_was_given(tmp_path: Path) -> None:
    """Wherever the log is: of several agents, as a copy with another name, or by a configuration."""
    record(tmp_path / "two logs" / "agent 1", *STORY)
    record(tmp_path / "two logs" / "agent 2", *STORY, name="agent_2")
    copy = tmp_path / "a7.jsonl"
    copy.write_bytes((tmp_path / "two logs" / "agent 2" / "phm.jsonl").read_bytes())
    configuration = tmp_path / "phm.yaml"
    configuration.write_text(f"log: {{directory: '{tmp_path / 'two logs' / 'agent 1'}'}}\n")
    for given in ([tmp_path / "two logs"], [copy], ["-c", configuration]):
        named = re.findall("see: phm (faults .*)", logs(*given).output)
        assert named
        for words in named:
            found = CliRunner().invoke(group, [*shlex.split(words), "--run-dir", str(tmp_path)])
            assert found.exit_code == 0 and "nodes/n1" in found.output, (words, found.output)
    assert "remedy: phm approve ab12-1 (on agent_2)" in logs(copy).output
    default = CliRunner().invoke(group, ["logs"], env={"PHM_CONFIG": str(configuration)}).output
    assert "see: phm faults ab12-1\n" in default and "remedy: phm approve ab12-1\n" in default


def test_a_command_to_copy_contains_no_command_of_the_log(tmp_path: Path) -> None:
    """A log may be of anyone."""
    record(tmp_path, *STORY)
    (file,) = tmp_path.glob("*.jsonl")
    text = file.read_text().replace("ab12-1", "ab12-1; touch x #")
    file.write_text(text.replace('"agent":"agent_1"', '"agent":"a1; touch y"'))
    shown = logs(file).output
    assert "see: phm faults 'ab12-1; touch x #' --log-dir" in shown
    assert "remedy: phm approve 'ab12-1; touch x #' (on 'a1; touch y')" in shown


def test_a_rate_has_its_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In the text log it has none, as in the paper."""
    state = unit("rates/t1", Slot.RATES, Level.OK, "t1: 10.000")
    log = log_of(tmp_path)
    log.handle(Report(at(0.0), 1, at(0.0), (state,)))
    log.close()
    assert "rates/t1: t1: 10.000 Hz\n" in logs(tmp_path, "--reports").output
    assert "t1: 10.000\n" in (tmp_path / "phm.log").read_text()
    terminal.report({"checks": [unit_json(state)], "status_array": []})
    assert "t1: 10.000 Hz" in capsys.readouterr().out


@pytest.mark.parametrize("number", [b"1" + b"0" * 400, b"1e999"], ids=["integer", "infinity"])
def test_no_number_in_a_line_ends_the_program(number: bytes, tmp_path: Path) -> None:
    """Copied logs may come from a hostile agent, and Python reads integers that are too large for a float."""
    record(tmp_path, *STORY)
    file = tmp_path / "phm.jsonl"
    written = file.read_bytes()
    assert b'"duration_s":4.5' in written
    file.write_bytes(written.replace(b'"duration_s":4.5', b'"duration_s":' + number))
    shown = logs(tmp_path)
    assert shown.exit_code == 0 and "nodes/n1: resolved by restart" in shown.output


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--unit", "topics/*"], {"topics/t1"}),
        (["--unit", "n*"], {"nodes/n1"}),
        (["--level", "stale"], {"topics/t1"}),
        (["--kind", "action"], {"nodes/n1"}),
        (["--since", "2026-03-01T12:00:01Z"], {"nodes/n1"}),
        (["--since", "1min"], set()),
        (["--agent", "agent_2"], set()),
        (["--agent", "A01", "--kind", "STALE"], {"topics/t1"}),
    ],
)
def test_lines_are_filtered(words: list[str], expected: set[str], tmp_path: Path) -> None:
    """By unit, level, kind, time and agent."""
    record(tmp_path, *STORY)
    assert {event["unit"] for event in events(tmp_path, *words) if "unit" in event} == expected


def test_take_off_is_the_beginning_of_the_last_flight(tmp_path: Path) -> None:
    """Also when PHM was restarted during the flight, and when the clock stepped back."""
    armed: list[bool] = [False]
    log = flying(tmp_path, armed)
    for number, state in enumerate((True, False, True)):
        log.handle(note(f"before {number}"))
        armed[0] = state
        log.tick()
    log.handle(note("in flight", -1000.0))
    log.close()
    found = events(tmp_path, "--since", "take-off")
    assert [event.get("text") for event in found][1:] == ["in flight"]
    assert found[0]["event"] == "flight" and found[0]["number"] == 2


def test_take_off_is_not_that_of_an_earlier_flight_with_the_same_number(tmp_path: Path) -> None:
    """`state_dir` was lost, so the numbers began again."""
    for text in ("first", "second"):
        log = flying(tmp_path, [True], boot=text)
        log.tick()
        log.handle(note(text))
        log.close()
        (tmp_path / "state" / "flight.json").unlink()
    assert [event.get("text") for event in events(tmp_path, "--since", "take-off")][1:] == ["second"]


def test_without_a_flight_take_off_is_an_error(tmp_path: Path) -> None:
    """With what to do."""
    record(tmp_path, note("x"))
    result = logs(tmp_path, "--since", "take-off")
    assert result.exit_code == 1 and "leave out --since take-off" in result.output


def test_a_wrong_time_is_an_error(tmp_path: Path) -> None:
    """It names what is allowed."""
    result = logs(tmp_path, "--since", "yesterday")
    assert result.exit_code == 2 and "take-off" in result.output and "2026-03-01T12:00:05" in result.output


def test_without_a_log_it_says_where_it_looked(tmp_path: Path) -> None:
    """A missing directory, and one without a log."""
    for place in (tmp_path, tmp_path / "none"):
        result = logs(place)
        assert result.exit_code == 1 and str(place) in result.output


def test_logs_of_several_agents_are_in_the_order_of_time(tmp_path: Path) -> None:
    """A folder with subfolders; each line names its agent."""
    for name, times in (("agent_1", (1, 4)), ("agent_2", (2, 3))):
        record(tmp_path / name, *(note(f"{name} {second}", second) for second in times), name=name)
    found = [event["text"] for event in events(tmp_path, "--kind", "NOTE")]
    assert found == ["agent_1 1", "agent_2 2", "agent_2 3", "agent_1 4"]
    assert "agent_2 NOTE agent_2 3" in logs(tmp_path).output


def test_rotated_and_compressed_files_are_read_in_order(tmp_path: Path) -> None:
    """Damage ends one file, not the log, and is said."""
    record(tmp_path, *(note(f"n{number}", number) for number in range(9)))
    lines = (tmp_path / "phm.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "phm.jsonl.2.gz").write_bytes(gzip.compress(b"".join(lines[:4])) + b"damaged")
    (tmp_path / "phm.jsonl.1").write_bytes(b"".join(lines[4:7]) + b'{"torn":')
    (tmp_path / "phm.jsonl").write_bytes(b"\0\0\n[1]\n" + b"".join(lines[7:]))
    result = logs(tmp_path, "--json")
    assert [json.loads(line)["seq"] for line in result.stdout.splitlines()] == list(range(1, 11))
    assert "phm.jsonl.2.gz: damaged" in result.stderr and "2 lines are incomplete" in result.stderr


@pytest.mark.parametrize(("name", "content"), [("phm.jsonl.1.gz", b"damaged"), ("phm.jsonl", b'{"torn":')])
def test_a_log_of_which_nothing_can_be_read_is_an_error(tmp_path: Path, name: str, content: bytes) -> None:
    """A script must not take it for a log without events. What is in the other logs is shown."""
    record(tmp_path / "good", note("of the other"))
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / name).write_bytes(content)
    result = logs(tmp_path)
    assert result.exit_code == 1
    assert "of the other" in result.stdout and name in result.stderr
    alone = logs(tmp_path / "bad")
    assert alone.exit_code == 1 and "no line matches" not in alone.stderr


def test_missing_lines_are_shown(tmp_path: Path) -> None:
    """By the numbers of the lines."""
    record(tmp_path, *(note(f"n{number}") for number in range(9)))
    lines = (tmp_path / "phm.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "phm.jsonl").write_bytes(b"".join(lines[:3] + lines[6:]))
    assert "3 lines are missing here" in logs(tmp_path).output


def test_missing_lines_of_other_times_and_agents_are_not_shown(tmp_path: Path) -> None:
    """Two agents with one name, whose lines alternate; lines 4 to 6 of both are missing, and lines 11 and 12 of the second."""
    for agent, boot, lost in ((1, "boot1", (4, 5, 6)), (2, "boot2", (4, 5, 6, 11, 12))):
        line = {"v": 2, "agent": "scout", "agent_id": agent, "boot_id": boot, "event": "note", "kind": "NOTE"}
        lines = [
            {**line, "seq": at, "utc_s": 1000.0 + at + agent / 10, "mono": at, "text": f"n{at}"} for at in range(16)
        ]
        (tmp_path / boot).mkdir()
        text = "".join(f"{json.dumps(each)}\n" for each in lines if each["seq"] not in lost)
        (tmp_path / boot / "phm.jsonl").write_text(text)

    def gaps(*words: str) -> list[str]:
        return [line[:7] for line in logs(tmp_path, *words).output.splitlines() if "missing here" in line]

    assert gaps() == ["3 lines", "3 lines", "2 lines"]
    assert gaps("--agent", "2") == ["3 lines", "2 lines"]
    assert gaps("--since", "1970-01-01T00:16:48") == ["2 lines"]
    assert gaps("--agent", "1", "--since", "1970-01-01T00:16:48") == []


def test_text_from_outside_is_safe_and_bounded(tmp_path: Path) -> None:
    """No escape reaches the terminal, whatever types the keys have."""
    hostile = {
        **dict.fromkeys(("unit", "summary", "kind", "agent", "utc", "fault", "condition"), "\x1b[2J\n" * 5000),
        "event": "transition",
        "level": ["x"],
        "values": {"\x1b": "\x1b" * 9000},
        "slot": {},
        "seq": "1",
    }
    kinds = ("transition", "fault_opened", "fault_closed", "action", "start", "report", "lost", "?", 7, None)
    lines = [json.dumps({**hostile, "event": kind, "duration_s": "x", "suspects": 3}) for kind in kinds]
    (tmp_path / "phm.jsonl").write_text("\n".join(lines))
    result = logs(tmp_path, "--reports")
    assert result.exit_code == 0 and "\x1b" not in result.output
    assert max(map(len, result.output.splitlines())) < 100_000


def test_names_of_folders_from_outside_are_safe(tmp_path: Path) -> None:
    """A card's folder can have any name; what is said of its files has no escape."""
    folder = tmp_path / "\x1b]0;owned\x07\x1b[2J"
    folder.mkdir()
    (folder / "phm.jsonl").write_text('{"torn":')
    (folder / "phm.jsonl.1.gz").write_bytes(b"damaged")
    result = logs(tmp_path)
    assert "\x1b" not in result.stderr and "\x07" not in result.stderr
    assert "1 lines are incomplete" in result.stderr and "phm.jsonl.1.gz: damaged" in result.stderr


def test_a_log_is_read_once_whatever_the_rotation_does_meanwhile(tmp_path: Path) -> None:
    """Events come in order, without a gap and without a repetition, while files are renamed, compressed and emptied."""
    log = log_of(tmp_path, max_size="100kB", files=50)
    reader, seen = LogReader(tmp_path), 0
    for number in range(2000):
        log.handle(note(f"{number} " + "x" * 400, number))
        if number % 97 == 0:
            for event in reader.events():
                seen += 1
                assert event["seq"] == seen
    log.close()
    rest = [event["seq"] for event in reader.events(last=True)]
    assert rest == list(range(seen + 1, 2002)) and not reader.damaged
    assert len(list(tmp_path.glob("phm.jsonl.*"))) > 5
    reader.close()


def test_a_log_that_was_emptied_is_followed_on(tmp_path: Path) -> None:
    """As by logrotate's copytruncate."""
    path = tmp_path / "phm.jsonl"
    path.write_text('{"seq":1}\n{"seq":2}\n{"to')
    reader = LogReader(path)
    assert [event["seq"] for event in reader.events()] == [1, 2]
    path.write_text('{"seq":3}\n')
    list(reader.events())
    assert [event["seq"] for event in reader.events()] == [3]
    reader.close()


def test_a_line_is_bounded(tmp_path: Path) -> None:
    """A compressed file can hold an endless line; what is after it is read."""
    path = tmp_path / "phm.jsonl.gz"
    path.write_bytes(gzip.compress(b"x" * 9_000_000 + b'\n{"seq":1,"utc_s":5}\n'))
    reader = LogReader(path, alone=True)
    assert [utc_s(event) for event in reader.events()] == [5.0] and reader.skipped == 1


@pytest.fixture
def follow(tmp_path: Path) -> Iterator[Callable[..., Path]]:
    """Start `phm logs --follow` as a program; its output is in the file."""
    started: list[subprocess.Popen[bytes]] = []

    def start(*words: object) -> Path:
        shown = tmp_path / "shown"
        with shown.open("wb") as target:
            command = [sys.executable, "-m", "phm.cli", "logs", "--follow", *map(str, words)]
            started.append(subprocess.Popen(command, stdout=target, stderr=target, env={**os.environ}))
        return shown

    yield start
    for program in started:
        program.terminate()
        program.wait(60)


def test_following_survives_a_rotation(follow: Callable[..., Path], tmp_path: Path) -> None:
    """It begins before there is a log, and shows each line once, in order, over several rotations."""
    place = tmp_path / "log"
    shown = follow(place, "--kind", "NOTE", "--json")

    def numbers() -> list[int]:
        whole, _, _ = shown.read_bytes().rpartition(b"\n")  # the last line may be only half written
        return [int(json.loads(line)["text"].split()[0]) for line in whole.splitlines()]

    log = log_of(place, max_size="100kB", files=50)
    for number in range(0, 900, 300):
        for each in range(number, number + 300):
            log.handle(note(f"{each} " + "x" * 400, each))
        until(lambda last=number + 299: numbers()[-1:] == [last], "the last line to be shown", numbers)  # type: ignore[misc]
    log.close()
    assert numbers() == list(range(900)) and len(list(place.glob("phm.jsonl.*"))) > 2


def test_following_from_take_off_waits_for_it(follow: Callable[..., Path], tmp_path: Path) -> None:
    """Before the first flight of a log nothing is shown; from its beginning on everything is."""
    place = tmp_path / "log"
    armed = [False]
    log = flying(place, armed)
    log.handle(note("before"))
    shown = follow(place, "--since", "take-off", "--json")
    until(lambda: b"waiting for take-off" in shown.read_bytes(), "it to wait for take-off", shown.read_bytes)

    def texts() -> list[str]:
        whole, _, _ = shown.read_bytes().rpartition(b"\n")
        return [str(json.loads(line).get("text")) for line in whole.splitlines() if line.startswith(b"{")]

    log.handle(note("still on the ground"))
    armed[0] = True
    log.tick()
    log.handle(note("in flight"))
    until(lambda: "in flight" in texts(), "the flight to be shown", shown.read_bytes)
    log.close()
    assert len(texts()) == 2 and "flight" in texts()[0].lower()


def test_only_following_waits_for_a_flight(follow: Callable[..., Path], tmp_path: Path) -> None:
    """Of two agents the one that has flown is shown from its take-off on, the other one from its first."""
    armed, later = [True], [False]
    first, second = flying(tmp_path / "logs" / "a", armed), flying(tmp_path / "logs" / "b", later)
    first.tick()
    first.handle(note("a in flight"))
    second.handle(note("b before"))
    shown = follow(tmp_path / "logs", "--since", "take-off", "--kind", "NOTE", "--json")
    until(lambda: b"a in flight" in shown.read_bytes(), "the first agent to be shown", shown.read_bytes)
    later[0] = True
    second.tick()
    second.handle(note("b in flight"))
    until(lambda: b"b in flight" in shown.read_bytes(), "the second agent to be shown", shown.read_bytes)
    first.close()
    second.close()
    assert b"b before" not in shown.read_bytes() and b"waiting" not in shown.read_bytes()
