"""The reference values of a campaign: the paper's Table 2, and PHM's own targets. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sitl.campaign.metrics import Figures

Value = float | int | None


@dataclass(frozen=True)
class Aim:
    """One row of the table. `met` tests a value; `shown` formats it."""

    name: str
    paper: str
    aim: str
    value: Callable[[Figures], Value]
    met: Callable[[float], bool]
    shown: Callable[[float], str]


@dataclass(frozen=True)
class Row:
    """An evaluated target. `met` is None when nothing was measured."""

    name: str
    paper: str
    aim: str
    value: Value
    shown: str
    met: bool | None


def _seconds(value: float) -> str:
    return f"{value:.2f} s"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def _fine(value: float) -> str:
    return f"{100 * value:.3f} %"


def _whole(value: float) -> str:
    return f"{value:.0f}"


AIMS = (
    Aim("Average fault detection", "5.2 s", "<= 0.7 s", lambda f: f.detection.mean, lambda v: v <= 0.7, _seconds),
    Aim("Fault detection, p95", "-", "<= 3 s", lambda f: f.detection.p95, lambda v: v <= 3.0, _seconds),
    Aim("Average PHM response", "14.82 s", "<= 1.0 s", lambda f: f.response.mean, lambda v: v <= 1.0, _seconds),
    Aim("Self-resolved, of the healable", "-", "100 %", lambda f: f.resolved_healable, lambda v: v >= 1.0, _percent),
    Aim("Self-resolved, of all", "16.6 %", ">= 75 %", lambda f: f.resolved, lambda v: v >= 0.75, _percent),
    Aim("PHM uptime", "96.77 %", ">= 99.9 %", lambda f: f.uptime, lambda v: v >= 0.999, _fine),
    Aim(
        "Alarms per fault",
        "chains",
        "1.00",
        lambda f: f.alarms_per_fault,
        lambda v: round(v, 2) == 1.0,
        "{:.2f}".format,
    ),
    Aim("Missed", "-", "0", lambda f: f.missed, lambda v: v == 0, _whole),
    Aim("False alarms", "-", "0", lambda f: f.false, lambda v: v == 0, _whole),
    Aim("Cause reported correctly", "-", ">= 98 %", lambda f: f.right, lambda v: v >= 0.98, _percent),
    Aim("Sidecar, CPU of one core", "-", "<= 3 %", lambda f: f.cpu_nominal, lambda v: v <= 3.0, "{:.2f} %".format),
    Aim("Changed with recovery off", "-", "0", lambda f: f.off_changes, lambda v: v == 0, _whole),
)


def judged(found: Figures) -> list[Row]:
    """Every target with its measured value."""
    rows = []
    for aim in AIMS:
        value = aim.value(found)
        measured = value is not None and (found.injected > 0 or aim.name in _WITHOUT)
        rows.append(
            Row(
                aim.name,
                aim.paper,
                aim.aim,
                value if measured else None,
                aim.shown(value) if measured and value is not None else "not measured",
                aim.met(value) if measured and value is not None else None,
            )
        )
    return rows


_WITHOUT = {"PHM uptime", "False alarms", "Sidecar, CPU of one core", "Changed with recovery off"}
"""Measured also where nothing was injected."""


def short(found: Figures) -> list[str]:
    """The missed targets as text; empty when every measured target is met."""
    return [f"{row.name}: {row.shown}, aim {row.aim}" for row in judged(found) if row.met is False]
