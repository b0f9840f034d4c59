"""Which kinds of starvation explain a health check that reports a failure itself, without delay."""

from __future__ import annotations

import pytest

from phm.api import Result, error
from phm.core.model import Evidence
from tests.fakes.tracker_bench import OK, Bench, unit

BUSY = error("CPU at 99 %", brief="CPU 99", condition="cpu_high")
THROTTLED = error("throttled", brief="throttled", condition="cpu_throttled")
LIMITED = error("20 processes", brief="app pids", condition="pids_limit")


@pytest.mark.parametrize(
    ("pressure_unit", "pressure", "opened"),
    [
        ("host/cpu", BUSY, ["host/cpu", "health/app"]),
        ("pressure/app", THROTTLED, ["pressure/app"]),
        ("pressure/app", LIMITED, ["pressure/app"]),
    ],
    ids=["machine", "container", "processes"],
)
def test_a_health_check_that_fails_in_time_is_not_explained_by_a_busy_machine(
    pressure_unit: str, pressure: Result, opened: list[str]
) -> None:
    """It ran without delay. The application may be delayed if its own container is: the probe may ask how old its data are, or need
    a process that the limit does not allow."""
    unhealthy = error("unhealthy", brief="unhealthy", condition="unhealthy")
    made = Bench(
        [
            unit("host/cpu"),
            unit("container/app"),
            unit("pressure/app", "container/app"),
            unit("health/app", "container/app", starved_by=("pressure/app", "host/cpu")),
        ]
    )
    made.all_healthy()
    made.see(pressure_unit, pressure)
    made.later(0.1)
    made.see("health/app", unhealthy)
    assert made.blocked_by("health/app") == pressure_unit
    made.later(3.0)
    for _ in range(2):
        made.see("health/app", unhealthy.with_evidence(Evidence(in_time=True)))
        made.see("container/app", OK)
        for name in ("host/cpu", "pressure/app"):
            made.see(name, pressure if name == pressure_unit else OK)
    assert made.opened == opened
