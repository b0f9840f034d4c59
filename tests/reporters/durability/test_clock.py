"""The wall clock is set by hours while the log is written: its order, its sizes and its report do not depend on it."""

from __future__ import annotations

import contextlib
import os
import random
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Note
from phm.core.settings import LogSettings, Settings
from phm.logs.reader import LogReader
from phm.reporters.log import LogReporter
from phm.testing import FakeClock
from phm.wire import json_log
from sitl.faults import _wall_clock
from tests.fakes.records import context
from tests.fakes.until import until
from tests.review.records import report

MIDNIGHT = 1_772_409_600.0
"""2026-03-02 00:00 UTC."""
HOUR_S = 3600.0
STEPS: dict[str, Callable[[random.Random, int], float]] = {
    "forward": lambda draw, number: 3 * HOUR_S if number == 300 else 0.0,
    "back": lambda draw, number: -5 * HOUR_S if number == 300 else 0.0,
    "there and back": lambda draw, number: HOUR_S * (1 if number % 2 else -1) if number % 50 in (0, 1) else 0.0,
    "at random": lambda draw, number: draw.uniform(-9, 9) * HOUR_S if draw.random() < 0.02 else 0.0,
    "to 1970": lambda draw, number: -MIDNIGHT + 100 if number == 300 else 0.0,
    "to 2099": lambda draw, number: 73 * 365.25 * 24 * HOUR_S if number == 300 else 0.0,
    "over midnight": lambda draw, number: 4.0 if number == 300 else -6.0 if number == 301 else 0.0,
}
EVENTS = 600


class Log:
    """The real log, of an agent that is armed or not, on a clock that can be set."""

    def __init__(self, folder: Path, armed: bool, *, max_size: int = 20_000, files: int = 100) -> None:
        # Half of the events are written before midnight.
        self.folder, self.clock, self.number = folder, FakeClock(utc=MIDNIGHT - EVENTS / 20), 0
        settings = Settings(
            log=LogSettings(directory=str(folder), max_size=max_size, files=files), state_dir=str(folder / "state")
        )
        self._context = replace(
            context(settings, clock=self.clock), reported_armed=lambda: armed, machine_boot="machine1"
        )
        self.log = LogReporter.build(self._context)

    def restart(self, boot: str, machine_boot: str) -> None:
        """Another run of PHM, as after a restart or a reload."""
        self.clock.advance(2.0)
        self.log.close()
        self.log = LogReporter.build(replace(self._context, boot_id=boot, machine_boot=machine_boot))

    def write(self) -> None:
        self.number += 1
        self.clock.advance(0.1)
        self.log.handle(Note(self.clock.stamp(), "TEST", f"event {self.number} {'x' * (self.number % 300)}"))
        if not self.number % 5:
            self.log.tick()

    def files(self) -> list[Path]:
        return [path for path in self.folder.glob("phm.*") if path.is_file()]


@pytest.fixture
def logs(tmp_path: Path) -> Iterator[Callable[..., Log]]:
    made: list[Log] = []

    def build(armed: bool, **sizes: int) -> Log:
        made.append(Log(tmp_path / "log", armed, **sizes))
        return made[-1]

    yield build
    for each in made:
        each.log.close()


def check(folder: Path) -> None:
    """Every event once, numbers without a gap, the monotonic time in order, in the file that a person reads as well."""
    lines = list(json_log.read(folder))
    assert [line["seq"] for line in lines] == list(range(1, len(lines) + 1))
    monos = [line["mono"] for line in lines]
    assert monos == sorted(monos)
    numbers = [int(line["text"].split()[1]) for line in lines if line["event"] == "note"]
    assert numbers == list(range(1, len(numbers) + 1)) != []
    reader = LogReader(folder)
    assert [event["seq"] for event in reader.events(last=True)] == [line["seq"] for line in lines]
    reader.close()
    text = "".join(path.read_text() for path in json_log.files(folder / "phm.log"))
    assert [int(number) for number in re.findall(r"^.* event ([0-9]+) x*$", text, re.MULTILINE)] == numbers


@pytest.mark.parametrize("armed", [True, False])
@pytest.mark.parametrize("steps", STEPS)
def test_a_clock_step_loses_and_disorders_nothing(logs: Callable[..., Log], steps: str, armed: bool) -> None:
    """Ahead and back, while armed and not, through many rotations; the report is of one continuous run."""
    log, draw = logs(armed), random.Random(7)
    for number in range(EVENTS):
        if moved_s := STEPS[steps](draw, number):
            log.clock.jump_utc(moved_s)
        log.write()
    log.log.close()
    assert len(list(log.folder.glob("phm.jsonl.*"))) > 5
    check(log.folder)
    made = report(log.folder)
    (agent,) = made["agents"]
    assert made["window"]["duration_s"] == pytest.approx(EVENTS * 0.1, abs=0.2)
    assert agent["missing_lines"] == 0 and agent["uptime"] == pytest.approx(1.0)
    assert made["files"]["problems"] == []
    assert [flight["duration_s"] for flight in made["flights"]] == (
        [pytest.approx(EVENTS * 0.1, abs=1.0)] if armed else []
    )


@pytest.mark.parametrize("moved_s", [3 * HOUR_S, -3 * HOUR_S])
def test_a_clock_step_at_a_rotation_loses_nothing(logs: Callable[..., Log], moved_s: float) -> None:
    """Just before it, and just after it, again and again."""
    log = logs(True)

    def inode() -> int:
        return os.stat(log.folder / "phm.jsonl").st_ino

    log.write()
    for _ in range(20):
        before = inode()
        while inode() == before:
            log.clock.jump_utc(moved_s)
            log.write()
            log.clock.jump_utc(-moved_s)
        log.clock.jump_utc(-moved_s)
        log.write()
        log.clock.jump_utc(moved_s)
    log.log.close()
    check(log.folder)


@pytest.mark.parametrize("year_s", [4_102_444_800.0, 0.0])
def test_rotation_and_size_do_not_depend_on_the_times_of_files(logs: Callable[..., Log], year_s: float) -> None:
    """All files are from 2100, or from 1970: the oldest are removed, the newest are kept, and the size stays below its limit."""
    log = logs(True, max_size=10_000, files=3)
    for number in range(3 * EVENTS):
        if not number % 20:
            for path in log.files():
                with contextlib.suppress(FileNotFoundError):  # it was just compressed
                    os.utime(path, (year_s, year_s))
        log.write()
        assert sum(path.stat().st_size for path in log.folder.glob("phm.log*")) <= 4 * 10_000
    until(lambda: not [p for p in log.folder.glob("phm.jsonl.*") if p.suffix != ".gz"], "the compression")
    log.log.close()
    assert sum(path.stat().st_size for path in log.folder.glob("phm.jsonl*")) <= 4 * 10_000
    numbers = [line["seq"] for line in json_log.read(log.folder)]
    assert numbers == list(range(numbers[0], numbers[-1] + 1)) and numbers[0] > 1
    made = Log(log.folder, True, max_size=10_000, files=3)  # a restart goes on with these files
    for _ in range(100):
        made.write()
    made.log.close()
    texts = [str(line["text"]) for line in json_log.read(log.folder) if line["event"] == "note"]
    assert [int(text.split()[1]) for text in texts[-30:]] == list(range(71, 101))


@pytest.mark.parametrize("moved_s", [3 * HOUR_S, -3 * HOUR_S, -MIDNIGHT + HOUR_S])
def test_a_clock_step_between_two_runs_does_not_move_them_apart(logs: Callable[..., Log], moved_s: float) -> None:
    """Runs of one start of the machine have one monotonic clock; the report shows one continuous record, and lists the step."""
    log = logs(False)
    for number in range(3):
        log.restart(f"boot{number}", "machine1")
        for _ in range(200):
            log.write()
        if number == 0:
            log.clock.jump_utc(moved_s)
    log.log.close()
    made = report(log.folder)
    (agent,) = made["agents"]
    assert made["window"]["duration_s"] == pytest.approx(66, abs=1)
    assert agent["uptime"] == pytest.approx(60 / 66, abs=0.01)
    assert [step for run in made["clocks"]["runs"] for _, step in run["steps"]] == [pytest.approx(moved_s, abs=0.01)]


def test_runs_of_two_starts_of_the_machine_are_placed_by_their_own_clocks(logs: Callable[..., Log]) -> None:
    """So the test above can fail: nothing else joins runs."""
    log = logs(False)
    for number in range(2):
        log.restart(f"boot{number}", f"other{number}")
        for _ in range(200):
            log.write()
        log.clock.jump_utc(3 * HOUR_S)
    log.log.close()
    assert report(log.folder)["window"]["duration_s"] == pytest.approx(3 * HOUR_S + 44, abs=1)


WRITER = """
import sys
from pathlib import Path
from phm.core.clock import SystemClock
from phm.core.model import Note
from tests.reporters.durability._writer import reporter
clock, log = SystemClock(), reporter(Path(sys.argv[1]), 1, 20_000, 100)
for number, _ in enumerate(sys.stdin, 1):
    log.handle(Note(clock.stamp(), "TEST", f"event {number} {'x' * (number % 300)}"))
    log.tick()
"""
"""Writes one event for each line that it gets."""


def test_the_clock_of_a_process_that_writes_is_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a real process, by hours ahead and back, while it writes and rotates; the clocks of the machine stay unchanged."""
    monkeypatch.setattr(_wall_clock, "LIMIT_S", 60.0)  # a process that waits for a CPU is not asleep
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdin=subprocess.PIPE)
    assert writer.stdin is not None

    def newest() -> dict[str, Any]:
        """Empty while it rotates."""
        try:
            data = (tmp_path / "phm.jsonl").read_bytes()
        except FileNotFoundError:
            return {}
        lines = data.splitlines()
        return json_log.parse(lines[-1]) or {} if lines else {}

    def offset_s() -> float:
        line = newest()
        return float(line["utc_s"]) - float(line["mono"]) if line else 0.0

    def write() -> None:
        """60 more events are asked for, and the writer begins."""
        seq = newest().get("seq", 0)
        writer.stdin.write(b"\n" * 60)  # type: ignore[union-attr]
        writer.stdin.flush()  # type: ignore[union-attr]
        until(lambda: newest().get("seq", 0) > seq, "a new line")

    try:
        write()
        real_s = until(offset_s, "the first line")
        for moved_s in (7200, -10_800, 3600, 0):
            write()
            _wall_clock.shift(writer.pid, moved_s)
            write()
            until(lambda moved_s=moved_s: abs(offset_s() - real_s - moved_s) < 60, f"lines {moved_s} s ahead")  # type: ignore[misc]
        writer.stdin.close()
        writer.wait(60)  # killed between the record of an event and its line of text, it would leave only one of them
    finally:
        writer.stdin.close()
        writer.kill()
        writer.wait()
    check(tmp_path)
    made = report(tmp_path)
    assert made["window"]["duration_s"] < 600
    assert [round(step / HOUR_S) for _, step in made["clocks"]["runs"][0]["steps"]] == [2, -5, 4, -1]
    assert made["agents"][0]["missing_lines"] == 0
