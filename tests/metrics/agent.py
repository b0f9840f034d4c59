"""A context in which every metric of an agent has a value, and the page that is made from it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from phm.core.model import (
    ActionEvent,
    Fault,
    FaultClosed,
    FaultOpened,
    Layer,
    Level,
    Outcome,
    Phase,
    Report,
    Result,
    Slot,
    Stamp,
    UnitState,
)
from phm.facts import AutopilotFact, LinkFact, RadioFact, SenderFact
from phm.reporters.base import ReporterContext
from phm.reporters.metrics_counts import EventCounts
from phm.reporters.metrics_page import build_page
from phm.runtime.sections import reporter_settings
from phm.testing import FakeClock, FakeLinks, settings
from phm.wire.openmetrics import MetricsText

AT = Stamp(1.8e9, 10.0)
FOUND = Result(Level.ERROR, "ros_app exited with code 1", "ros_app exited 1", "exited", "ros_app")
FAULT = Fault("ab12-17", "container/ros_app", Slot.CONTAINER, Layer.DOCKER, FOUND, AT, confirmed_s=0.4)
HOST: dict[str, dict[str, Any]] = {
    "host/cpu": {"cpu_percent": 12.5, "load_per_core": 0.3},
    "host/memory": {"memory_percent": 50.0, "memory_available_bytes": 2_000_000, "memory_stalled_percent": 0.0},
    "host/io": {"io_stalled_percent": 1.0},
    "host/disk": {"disk_percent /": 96.0, "disk_free_bytes /": 4e9, "disk_total_bytes /": 1e11, "inodes_percent /": 3},
    "host/temperature": {"temperature_c": 61.5, "fan_rpm 0": 2000},
    "host/clock": {"clock_synchronized": None},
}
PRESSURE: dict[str, Any] = {
    "source": "cgroup v2",
    "cpus_used": 0.5,
    "cpu_limit": 2.0,
    "memory_bytes": 1000,
    "memory_limit_bytes": 2000,
    "pids": 7,
    "pids_limit": 100,
    "throttled_percent": 10.0,
    "cpu_waiting_percent": 20.0,
    "memory_waiting_percent": 0.0,
    "io_waiting_percent": 0.0,
}
RATE: dict[str, Any] = {"hz": 9.8, "expected_hz": 10.0, "silent_s": 0.1, "jitter_s": None}


def state(unit: str, check: str, slot: Slot, layer: Layer, level: Level = Level.OK, **values: Any) -> UnitState:
    return UnitState(unit, check, slot, layer, level, Result(level, "text", values=values), AT)


def states() -> tuple[UnitState, ...]:
    host = [state(unit, "host", Slot.HOST, Layer.COMPANION, **values) for unit, values in HOST.items()]
    return (
        *host,
        state("container/ros_app", "container", Slot.CONTAINER, Layer.DOCKER, Level.ERROR),
        state("pressure/ros_app", "pressure", Slot.CONTAINER, Layer.DOCKER, **PRESSURE),
        state("rates/agent_1/chatter", "rates", Slot.RATES, Layer.ROS, **RATE),
        state("custom/winch", "custom", Slot.USER_1, Layer.CUSTOM, load=3.5, word="text", nan=float("nan")),
    )


def links() -> FakeLinks:
    sender = SenderFact(1, 1, 0.2, 100, 2.5)
    radio = RadioFact("radio", 1.0, 2.0, rssi=180, remrssi=170, noise=40, remnoise=50, txbuf=90)
    return FakeLinks(
        1.5,
        AutopilotFact(0.4, True, link="radio"),
        (LinkFact("radio", True, rx_age_s=0.1, senders=(sender,)),),
        (radio,),
    )


HEALTH: dict[str, Any] = {
    "uptime_s": 100.0,
    "late_percent": 5.0,
    "overdue": [],
    "problems": ["a sentence"],
    "ros_restarts": 1,
    "links": [{"name": "radio", "bytes_in": 2000, "bytes_out": 1000}],
}


def context(units: tuple[UnitState, ...] | None = None, **changes: Any) -> ReporterContext:
    """changes: of the settings."""
    found = states() if units is None else units
    made = settings(agent={"id": 5, "name": "agent_5"}, **changes)
    return ReporterContext(
        reporter_settings(made),
        FakeClock(),
        "boot",
        lambda: found,
        lambda: True,
        lambda: HEALTH,
        open_faults=lambda: (FAULT,),
        links=links(),
        queues=lambda: {"log": (2, 1)},
    )


def events(clock: FakeClock) -> list[Any]:
    """A fault that is reported, recovered and closed, and a pass."""
    closed = replace(FAULT, outcome=Outcome.RESOLVED, closed=replace(AT, mono=AT.mono + 7.0))
    return [
        FaultOpened(AT, FAULT),
        ActionEvent(AT, FAULT.id, FAULT.unit, "restart", "ros_app", Phase.VERIFIED),
        FaultClosed(AT, closed),
        Report(clock.stamp(), 1, AT, ()),
    ]


def counts(about: ReporterContext) -> EventCounts:
    found = EventCounts(lambda unit: next((one.slot for one in about.states() if one.unit == unit), None))
    assert isinstance(about.clock, FakeClock)
    for event in events(about.clock):
        found.take(event)
    return found


def text_of(about: ReporterContext) -> MetricsText:
    happened = counts(about)
    return MetricsText(lambda: build_page(about, happened))
