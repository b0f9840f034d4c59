"""Which kinds of starvation explain a health check that reports a failure itself, without delay."""

from __future__ import annotations

import pytest

from phm.api import Result, error
from phm.core.model import Evidence
from tests.fakes.tracker_bench import OK, Bench, unit

THROTTLED = error("throttled", brief="throttled", condition="cpu_throttled")
LIMITED = error("20 processes", brief="app pids", condition="pids_limit")


@pytest.mark.parametrize(
    ("pressure", "opened"),
    [(THROTTLED, ["pressure/app", "health/app"]), (LIMITED, ["pressure/app"])],
    ids=["cpu", "processes"],
)
def test_a_health_check_that_fails_in_time_is_not_explained_by_a_lack_of_cpu(
    pressure: Result, opened: list[str]
) -> None:
    """It ran without delay and reported the failure itself; at a limit of processes its program may not be able to start another."""
    unhealthy = error("unhealthy", brief="unhealthy", condition="unhealthy")
    made = Bench(
        [
            unit("container/app"),
            unit("pressure/app", "container/app"),
            unit("health/app", "container/app", starved_by=("pressure/app",)),
        ]
    )
    made.all_healthy()
    made.see("pressure/app", pressure)
    made.later(0.1)
    made.see("health/app", unhealthy)
    assert made.blocked_by("health/app") == "pressure/app"
    made.later(3.0)
    for _ in range(2):
        made.see("health/app", unhealthy.with_evidence(Evidence(in_time=True)))
        made.see("container/app", OK)
        made.see("pressure/app", pressure)
    assert made.opened == opened
