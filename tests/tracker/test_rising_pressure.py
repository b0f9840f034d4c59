"""A pressure unit that may become an error: symptoms wait for it, and for a result that is new enough."""

from __future__ import annotations

import pytest

from phm.api import Result, error, warn
from phm.core.model import Evidence
from phm.tracker.starvation import WARN_WAIT_S
from tests.fakes.tracker_bench import OK, Bench, unit

OVERLOADED = error("CPU at 100 %", brief="CPU 100 %", condition="cpu_high")
SLOW = error("topic /x at 3 Hz, expected 10", brief="3 Hz", condition="rate_low")


def bench() -> Bench:
    """The host, and a topic."""
    made = Bench([unit("host/cpu"), unit("rates/x", starved_by=("host/cpu",))])
    made.all_healthy()
    return made


@pytest.mark.parametrize(
    "before",
    [OK.with_evidence(Evidence(rising=True)), warn("CPU at 91 %", brief="CPU 91 %", condition="cpu_high")],
    ids=["rising", "warning"],
)
def test_a_pressure_unit_that_may_become_an_error_is_asked_again_after_the_wait(before: Result) -> None:
    """Its last result is from before the end of the wait, up to a period old, and does not show the overload yet."""
    made = bench()
    made.later(0.1)
    made.see("rates/x", SLOW)
    made.see("host/cpu", before)
    made.later(WARN_WAIT_S - 0.1)
    made.see("host/cpu", before)
    made.later(0.3)
    assert made.opened == []
    made.see("host/cpu", OVERLOADED)
    assert made.opened == ["host/cpu"]
    assert made.blocked_by("rates/x") == "host/cpu"


def test_a_pressure_unit_that_may_become_an_error_and_does_not_answer_delays_for_a_limited_time() -> None:
    """As much as an unknown dependency."""
    made = bench()
    made.later(0.1)
    made.see("rates/x", SLOW)
    made.see("host/cpu", OK.with_evidence(Evidence(rising=True)))
    made.later(9.8)
    assert made.opened == []
    made.later(0.3)
    assert made.opened == ["rates/x"]
