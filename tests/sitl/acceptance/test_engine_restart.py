"""The verdict on a restart of the Docker Engine: alarms, actions, PHM's own restarts, and what the world shows."""

from __future__ import annotations

from typing import Any

import pytest

from sitl.acceptance.engine_restart import CASES, Case, judged

SURVIVED, ENDED = CASES[0], CASES[2]


def event(name: str, mono: float = 101.0, **more: Any) -> dict[str, Any]:
    return {"event": name, "mono": mono, **more}


def alarm(unit: str, mono: float = 101.0) -> dict[str, Any]:
    return event("fault_opened", mono, unit=unit)


START = event("action", action="start", phase="started")
GOOD = {
    SURVIVED: [alarm("engine"), event("fault_closed", unit="engine")],
    ENDED: [event("start"), alarm("container/ros_app"), START, event("action", action="start", phase="verified")],
}


def problems(case: Case, events: list[dict[str, Any]], *, same_run: bool, restored: bool = True) -> list[str]:
    return judged(case, events, 100.0, same_run=same_run, restored=restored).problems


@pytest.mark.parametrize("case", [SURVIVED, ENDED])
def test_a_run_as_expected_has_no_problems(case: Case) -> None:
    """One alarm at each expected unit, the expected action, and the time of the first alarm."""
    row = judged(case, GOOD[case], 100.0, same_run=case.survives, restored=True)
    assert row.problems == []
    assert row.detected_s == 1.0


def test_another_alarm_is_a_problem() -> None:
    """A second one at the same unit as well as one elsewhere."""
    for unit in ("engine", "nodes/agent_1/node_1"):
        assert problems(SURVIVED, [*GOOD[SURVIVED], alarm(unit, 103.0)], same_run=True)
    assert problems(SURVIVED, [], same_run=True)


def test_an_action_where_all_survives_is_a_problem() -> None:
    """Nothing was broken but the engine."""
    assert problems(SURVIVED, [*GOOD[SURVIVED], START], same_run=True)


def test_the_containers_must_have_fared_as_expected() -> None:
    """With live-restore neither PHM nor the application is started again; without it, both are."""
    assert problems(SURVIVED, GOOD[SURVIVED], same_run=False) == ["the application was restarted"]
    assert problems(ENDED, GOOD[ENDED], same_run=True) == ["the application was not restarted"]
    assert problems(SURVIVED, [event("start"), *GOOD[SURVIVED]], same_run=True) == ["PHM was started 1 times"]
    assert problems(ENDED, GOOD[ENDED][1:], same_run=False) == ["PHM was started 0 times"]


def test_the_world_must_be_restored() -> None:
    """Whatever PHM says."""
    assert problems(SURVIVED, GOOD[SURVIVED], same_run=True, restored=False)
