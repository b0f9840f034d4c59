"""A tracker with a manual clock, and small graphs of units for it."""

from __future__ import annotations

from dataclasses import dataclass, field

from phm.api import Layer, Level, Result, Slot, Unit, error, ok
from phm.core.model import Event, FaultClosed, FaultOpened, Outcome, Stamp
from phm.tracker import Effects, TrackedUnit, Tracker, graph_of

OK = ok("healthy")
BAD = error("broken", brief="broken", condition="broken")


@dataclass
class Bench:
    """A tracker with a manual clock that collects events."""

    tracked: list[TrackedUnit]
    now: float = 100.0
    events: list[Event] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.tracker = Tracker(self.tracked, graph_of(self.tracked), self.stamp())

    def stamp(self) -> Stamp:
        return Stamp(1e9 + self.now, self.now)

    def take(self, step: Effects) -> set[str]:
        self.events += step.events
        return step.rerun

    def see(self, unit: str, result: Result, *, started: float | None = None) -> set[str]:
        return self.take(self.tracker.observe(unit, result, self.now if started is None else started, self.stamp()))

    def all_healthy(self) -> None:
        for entry in self.tracked:
            self.see(entry.unit.id, OK)
        self.events.clear()

    def later(self, seconds: float) -> set[str]:
        self.now += seconds
        return self.take(self.tracker.tick(self.stamp()))

    def level(self, unit: str) -> Level:
        return self.tracker.state(unit).level

    def blocked_by(self, unit: str) -> str:
        return self.tracker.state(unit).blocked_by

    @property
    def opened(self) -> list[str]:
        return [event.fault.unit for event in self.events if isinstance(event, FaultOpened)]

    @property
    def closed(self) -> list[tuple[str, Outcome, str]]:
        faults = [event.fault for event in self.events if isinstance(event, FaultClosed)]
        return [(fault.unit, fault.outcome, fault.by) for fault in faults]


def unit(
    name: str, *needs: str, failures: int = 1, starved_by: tuple[str, ...] = (), **more: float | str
) -> TrackedUnit:
    about = Unit(name, needs, **more)  # type: ignore[arg-type]
    return TrackedUnit(about, name, Slot.CONTAINER, Layer.DOCKER, failures, needs, starved_by)


def chain(**more: float | str) -> Bench:
    return Bench([unit("container"), unit("nodes", "container", **more), unit("topics", "nodes", **more)])
