"""Records for tests of reporters and of the command line, short to write."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from phm.core.clock import Clock
from phm.core.model import (
    Fault,
    FaultClosed,
    FaultOpened,
    Layer,
    Level,
    Outcome,
    Result,
    Slot,
    Stamp,
    Transition,
    UnitState,
)
from phm.core.settings import Settings
from phm.reporters import log, own_cost
from phm.reporters.base import ReporterContext
from phm.runtime.sections import reporter_settings
from phm.testing import FakeClock

T0 = 1_772_366_400.123
"""2026-03-01 12:00:00.123 UTC."""


def at(seconds: float = 0.0) -> Stamp:
    return Stamp(utc=T0 + seconds, mono=100.0 + seconds)


def unit(name: str, slot: Slot, level: Level = Level.OK, summary: str = "", **fields: Any) -> UnitState:
    """A published unit; `brief`, `condition`, `values`, `target`, `bypass`, `evidence` go into its result."""
    keys = ("brief", "condition", "values", "target", "bypass", "evidence")
    result = Result(level, summary or f"{name} says so", **{key: fields.pop(key) for key in keys if key in fields})
    base = UnitState(name, name.partition("/")[0], slot, Layer.ROS, level, result, at())
    return replace(base, **fields)


def transition(state: UnitState, old: Level = Level.OK, seconds: float = 0.0) -> Transition:
    return Transition(at(seconds), old, state)


def fault(state: UnitState, name: str = "ab12-1") -> Fault:
    return Fault(name, state.unit, state.slot, state.layer, state.result, at())


def opened(state: UnitState, name: str = "ab12-1") -> FaultOpened:
    return FaultOpened(at(), fault(state, name))


def closed(state: UnitState, outcome: Outcome, by: str, seconds: float, name: str = "ab12-1") -> FaultClosed:
    stamp = at(seconds)
    return FaultClosed(stamp, replace(fault(state, name), closed=stamp, outcome=outcome, by=by))


@pytest.fixture(autouse=True)
def fixed_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM's own cost is read once, not from the kernel at each of thousands of reports. Import it into a conftest.py."""
    cost = own_cost.own_cost({})
    monkeypatch.setattr(log, "own_cost", lambda health: cost)


def context(
    settings: Settings,
    *,
    clock: Clock | None = None,
    states: Callable[[], tuple[UnitState, ...]] = tuple,
    alive: Callable[[], bool] = lambda: True,
    health: Callable[[], dict[str, Any]] = dict,
) -> ReporterContext:
    return ReporterContext(reporter_settings(settings), clock or FakeClock(), "boot12345678", states, alive, health)
