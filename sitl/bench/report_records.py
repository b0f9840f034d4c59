"""Records of any size for the bench of the report: what the real log reporter writes in one flight day, with the heads of other runs.

Each agent has a folder as `phm logs collect` leaves it: `phm.jsonl`, with its rotated files, compressed or not.
"""

from __future__ import annotations

import gzip
import random
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from phm.core.model import (
    ActionEvent,
    Fault,
    FaultClosed,
    FaultOpened,
    Layer,
    Level,
    Note,
    Outcome,
    Phase,
    Report,
    ReportStarted,
    Result,
    Slot,
    Transition,
    UnitState,
)
from phm.core.settings import AgentSettings, LogSettings, Settings
from phm.reporters.base import ReporterContext
from phm.reporters.log import LogReporter
from phm.runtime.sections import reporter_settings
from phm.testing import FakeClock
from phm.wire import json_log
from phm.wire.report import iso

RUN_S = 4 * 3600.0
"""A run: PHM is on for this long, and then for PAUSE_S off."""
PAUSE_S = 3600.0
EVERY_S = 20.0
FAULT_EVERY = 30
"""Reports from one fault to the next."""
FILE_BYTES, LEAST_FILES = 25_000_000, 4
"""Of one file: `log.max_size` with which 10 GB of eight agents stay below 100 files each. Small records have smaller files."""
BEGIN_S = 1_772_366_400.0
_AGENT, _BOOT, _FAULT = "agent_one", "b00tb00tb00t", "fa01-"
_UNITS = (
    *(("host/cpu", Slot.COMPANION, {"cpu_percent": 31.0}), ("host/memory", Slot.COMPANION, {"memory_percent": 44.0})),
    *(("host/disk", Slot.COMPANION, {"disk_percent": 61.0}), ("link/ground", Slot.COMPANION, {"tx_bytes_s": 700.0})),
    *((f"container/ros_{name}", Slot.CONTAINER, {}) for name in "abc"),
    *((f"nodes/node_{number}", Slot.NODES, {"listed": 1.0}) for number in range(1, 9)),
    *((f"topics/topic_{number}", Slot.TOPICS, {"publishers": 1.0}) for number in range(1, 9)),
    *((f"rates/topic_{number}", Slot.RATES, {"hz": 10.0}) for number in range(1, 9)),
)


@dataclass(frozen=True)
class Line:
    """A line of the pattern: its number and times, and what follows them."""

    seq: int
    mono: float
    rest: bytes


def pattern(seconds: float = RUN_S, seed: int = 17) -> list[Line]:
    """One run of one agent, by the real reporter."""
    with tempfile.TemporaryDirectory() as folder:
        _write(Path(folder), seconds, random.Random(seed))
        return [_line(line) for path in json_log.files(folder) for line in path.read_bytes().splitlines()]


def _write(folder: Path, seconds: float, draw: random.Random) -> None:
    clock, armed = FakeClock(100.0, BEGIN_S), [False]
    settings = Settings(
        agent=AgentSettings(id=1, name=_AGENT),
        log=LogSettings(directory=str(folder), max_size=1e9),
        state_dir=str(folder / "state"),
    )
    context = ReporterContext(
        reporter_settings(settings), clock, _BOOT, tuple, lambda: True, dict, reported_armed=lambda: armed[0]
    )
    log = LogReporter.build(context)
    states = [_state(name, slot, values, draw) for name, slot, values in _UNITS]
    for number in range(1, int(seconds / EVERY_S) + 1):
        clock.advance(EVERY_S)
        armed[0] = number % 90 > 10  # a flight takes up to half an hour
        log.tick()
        if not number % FAULT_EVERY:
            _fault(log, clock, draw.choice(states), f"{_FAULT}{number}", draw)
        states = [_state(name, slot, values, draw) for name, slot, values in _UNITS]
        log.handle(ReportStarted(clock.stamp(), number))
        log.handle(Report(clock.stamp(), number, clock.stamp(), tuple(states)))
        if not number % 10:
            log.handle(Note(clock.stamp(), "PHM", f"note {number}"))
    log.close()


def _state(name: str, slot: Slot, values: dict[str, float], draw: random.Random) -> UnitState:
    seen = {key: round(value * draw.uniform(0.9, 1.1), 3) for key, value in values.items()}
    text = f"{name} is as expected: " + ", ".join(f"{key} {value:g}" for key, value in seen.items())
    result = Result(Level.OK, text, values=seen)
    layer = Layer.COMPANION if slot is Slot.COMPANION else Layer.DOCKER if slot is Slot.CONTAINER else Layer.ROS
    stamp = FakeClock(100.0, BEGIN_S).stamp()
    return UnitState(name, name.partition("/")[0], slot, layer, Level.OK, result, stamp, duration_s=draw.random() / 100)


def _fault(log: LogReporter, clock: FakeClock, healthy: UnitState, name: str, draw: random.Random) -> None:
    """A fault that an action ends."""
    text = f"{healthy.unit} is gone: restart its container and check its log"
    bad = replace(
        healthy, level=Level.ERROR, fault=name, result=Result(Level.ERROR, text, f"{healthy.unit} gone", "gone")
    )
    opened = Fault(
        name, healthy.unit, healthy.slot, healthy.layer, bad.result, clock.stamp(), consequences=("topics", "rates")
    )
    log.handle(FaultOpened(clock.stamp(), opened))
    log.handle(Transition(clock.stamp(), Level.OK, bad))
    for phase in (Phase.STARTED, Phase.DONE, Phase.VERIFIED):
        log.handle(ActionEvent(clock.stamp(), name, healthy.unit, "restart", "ros_a", phase, f"restart: {phase.value}"))
        clock.advance(draw.uniform(0.2, 2.0))
    log.handle(Transition(clock.stamp(), Level.ERROR, healthy))
    closed = replace(opened, closed=clock.stamp(), outcome=Outcome.RESOLVED, by="restart")
    log.handle(FaultClosed(clock.stamp(), closed))


def _line(line: bytes) -> Line:
    event = json_log.parse(line)
    match = re.fullmatch(rb'\{.*?"utc_s":[0-9.]+(,"event":.*)', line)
    if event is None or match is None:
        raise RuntimeError(f"the reporter wrote a line of another form: {line[:200]!r}")
    return Line(int(event["seq"]), float(event["mono"]), match[1])


def lines(made: list[Line], agent: int, run: int) -> Iterator[bytes]:
    """The pattern as the run number `run` of an agent."""
    boot = f"{agent:04x}{run:08x}"
    head = b'{"v":%d,"agent":"agent_%d","agent_id":%d,"boot_id":"%s"' % (json_log.VERSION, agent, agent, boot.encode())
    begin_s, marker, own = BEGIN_S + run * (RUN_S + PAUSE_S), _FAULT.encode(), f"{agent:x}.{run:x}-".encode()
    for one in made:
        utc_s = begin_s + one.mono
        when = f',"seq":{one.seq},"mono":{one.mono:.6f},"utc":"{iso(utc_s)}","utc_s":{utc_s:.6f}'
        yield head + when.encode() + one.rest.replace(marker, own) + b"\n"


def write(folder: Path, size: int, agents: int, *, compressed: bool, made: list[Line]) -> None:
    """About `size` bytes of text, of all agents together."""
    for agent in range(1, agents + 1):
        place = folder / f"agent_{agent}"
        place.mkdir(parents=True)
        files = list(_files(place, size // agents, agent, made, compressed))
        for number, path in enumerate(reversed(files)):
            path.rename(place / f"phm.jsonl{f'.{number}' if number else ''}{path.suffix}")


def _files(place: Path, size: int, agent: int, made: list[Line], compressed: bool) -> Iterator[Path]:
    """The oldest first; the last one is never compressed."""
    every, left, number, most = _endless(made, agent), size, 0, min(FILE_BYTES, size // LEAST_FILES + 1)
    while left > 0:
        number += 1
        last = left <= most
        path = place / f"part-{number:05}{'.gz' if compressed and not last else ''}"
        limit = min(left, most)
        with gzip.open(path, "wb", 6) if path.suffix else path.open("wb") as stream:
            while limit > 0:
                line = next(every)
                stream.write(line)
                limit, left = limit - len(line), left - len(line)
        yield path


def _endless(made: list[Line], agent: int) -> Iterator[bytes]:
    run = 0
    while True:
        run += 1
        yield from lines(made, agent, run)
