"""Records for tests of the report, written by the real log reporter and the real recorder of the ground."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

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
    Slot,
    Stamp,
    Transition,
    UnitState,
)
from phm.core.settings import AgentSettings, LogSettings, Settings
from phm.gcs.events import GcsEvent, encode
from phm.reporters.base import MavlinkSender
from phm.reporters.log import LogReporter
from phm.review import document, record, record_reader
from phm.testing import FakeClock
from tests.fakes.records import context, unit

T0 = 1_772_366_400.0
SLOTS = {
    "container": (Slot.CONTAINER, Layer.DOCKER),
    "nodes": (Slot.NODES, Layer.ROS),
    "rates": (Slot.RATES, Layer.ROS),
}
UNITS = ("container/ros_app", "nodes/node_1", "rates/topic_1")


class Flown:
    """One run of PHM on one agent. wrong_s: how far its UTC is ahead of the true one. Times are true seconds since T0."""

    def __init__(
        self,
        folder: Path,
        number: int = 1,
        *,
        boot: str = "boot0001",
        wrong_s: float = 0.0,
        start: float = 0.0,
        mono: float = 50.0,
        machine_boot: str = "",
    ) -> None:
        self.folder, self.number, self.wrong_s, self.armed = folder, number, wrong_s, False
        self.clock = FakeClock(mono + start, T0 + start + wrong_s)
        self.now = start
        self.states = {name: self._state(name, Level.OK) for name in UNITS}
        self.reports, self.faults = 0, 0
        self.booted: float | None = None
        settings = Settings(
            agent=AgentSettings(id=number, name=f"agent_{number}"),
            log=LogSettings(directory=str(folder)),
            state_dir=str(folder / "state"),
        )
        self._listeners: list[Callable[[Any, str], None]] = []
        made = replace(
            context(settings, clock=self.clock),
            reported_armed=lambda: self.armed,
            boot_id=boot,
            machine_boot=machine_boot,
            mavlink=cast(MavlinkSender, SimpleNamespace(listen=lambda callback, ids: self._listeners.append(callback))),
        )
        self.prefix = f"{boot[-4:]}-"
        self.log = LogReporter.build(made)
        for state in self.states.values():
            self.log.handle(Transition(self.at, Level.STALE, state))

    @property
    def at(self) -> Stamp:
        return self.clock.stamp()

    def until(self, seconds: float, every: float = 20.0) -> None:
        """Advance to so many true seconds since T0, with a report every so often."""
        while self.now + every <= seconds + 1e-9:
            self._advance(every)
            self.report()
        self._advance(seconds - self.now)

    def arm(self, armed: bool) -> None:
        self.armed = armed
        self.log.tick()

    def receive(self, system: int, component: int, number: int) -> None:
        """A heartbeat that arrives now."""
        frame = SimpleNamespace(
            get_srcSystem=lambda: system, get_srcComponent=lambda: component, get_seq=lambda: number
        )
        for listener in self._listeners:
            listener(frame, "ground")

    def note(self, text: str) -> None:
        self.log.handle(Note(self.at, "NOTE", text))

    def report(self) -> None:
        self.reports += 1
        self.log.handle(ReportStarted(self.at, self.reports))
        states = list(self.states.values())
        if self.booted is not None:
            values = {"boot_s": round(self.now - self.booted, 1), "reboots": 0}
            states.append(unit("autopilot", Slot.AUTOPILOT, layer=Layer.LINK, values=values))
        self.log.handle(Report(self.at, self.reports, self.at, tuple(states)))

    def autopilot(self, booted: float) -> None:
        """From now on reports have an autopilot that booted this many true seconds after T0, to the tenth of a second."""
        self.booted = booted

    def fail(self, name: str, *, lasts: float | None = 4.0, by: str = "restart", brief: str = "") -> str:
        """A fault that opens now and, unless it stays open, ends after `lasts` seconds. Returns its id."""
        self.faults += 1
        state = self._state(
            name,
            Level.ERROR,
            f"{name} is gone, expected running: restart it and check its log",
            brief or f"{name} gone",
        )
        opened = Fault(
            f"{self.prefix}{self.faults}", name, state.slot, state.layer, state.result, self.at, consequences=("rates",)
        )
        self.states[name] = replace(state, fault=opened.id)
        self.log.handle(FaultOpened(self.at, opened))
        self.log.handle(Transition(self.at, Level.OK, self.states[name]))
        if lasts is None:
            return opened.id
        if by != "itself":
            self.log.handle(ActionEvent(self.at, opened.id, name, by, "ros_app", Phase.STARTED, f"{by} ros_app"))
        self._advance(lasts)
        if by != "itself":
            self.log.handle(ActionEvent(self.at, opened.id, name, by, "ros_app", Phase.VERIFIED, f"{name} is OK again"))
        self.states[name] = self._state(name, Level.OK)
        self.log.handle(Transition(self.at, Level.ERROR, self.states[name]))
        self.log.handle(FaultClosed(self.at, replace(opened, closed=self.at, outcome=Outcome.RESOLVED, by=by)))
        return opened.id

    def close(self) -> Path:
        self.log.close()
        return self.folder / "phm.jsonl"

    def _advance(self, seconds: float) -> None:
        self.now += seconds
        self.clock.advance(seconds)

    def _state(self, name: str, level: Level, summary: str = "", brief: str = "") -> UnitState:
        slot, layer = SLOTS[name.partition("/")[0]]
        gone = "gone" if level is Level.ERROR else ""
        values = {"hz": 9.5} if name.startswith("rates") else {}
        return unit(
            name,
            slot,
            level,
            summary,
            layer=layer,
            brief=brief,
            condition=gone,
            target="ros_app",
            values=values,
            duration_s=0.004,
        )


class Ground:
    """A record of the ground, with its true clock."""

    def __init__(self, path: Path, run: str = "ground01") -> None:
        self.path, self.run, self.lines, self.number = path, run, list[bytes](), 0

    def event(self, seconds: float, kind: str, /, **body: Any) -> None:
        at = Stamp(T0 + seconds, 9000.0 + seconds)
        self.number += kind not in ("snapshot", "received", "samples")  # these have the number of the event before
        self.lines.append(encode(GcsEvent(at, kind, body), self.run, self.number))

    def text(self, seconds: float, agent: int, slot: int, brief: str, word: str = "FAIL") -> None:
        keys = {"system": agent, "component": 193, "link": "gcs", "severity": 2, "severity_name": "CRITICAL"}
        text = f"A{agent:02d} {word} {slot} {brief}"
        self.event(
            seconds,
            "text",
            **keys,
            text=text,
            phm=True,
            repeat=False,
            agent=agent,
            kind="change",
            word=word,
            slot=slot,
            brief=brief,
        )

    def received(self, frames: Sequence[tuple[float, int, int, int]]) -> None:
        """Heartbeats as (seconds, system, component, frame number), in lines of at most 64."""
        for first in range(0, len(frames), 64):
            some = frames[first : first + 64]
            self.event(some[-1][0], "received", frames=[(*sender, round(9000.0 + at, 3)) for at, *sender in some])

    def close(self) -> Path:
        self.path.write_bytes(b"".join(line + b"\n" for line in self.lines))
        return self.path


def report(*paths: Path, flight: int | None = None) -> dict[str, Any]:
    """The document of these files and folders."""
    part = record_reader.read(record_reader.find([str(path) for path in paths]))
    return document.build(record.build(part), flight)


@contextmanager
def flown(folder: Path, **options: Any) -> Iterator[Flown]:
    made = Flown(folder, **options)
    try:
        yield made
    finally:
        made.close()
