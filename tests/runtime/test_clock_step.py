"""`phm run` while its wall clock is set by hours: the record stays one."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import pytest

from phm.wire import json_log
from sitl.faults import _wall_clock
from tests.fakes.until import until
from tests.review.records import report
from tests.runtime.test_reloader import Agent, agent as agent


def lines(folder: Path) -> list[dict[str, Any]]:
    return list(json_log.read(folder))


def ahead_s(line: dict[str, Any]) -> float:
    """Of the wall clock of a line, ahead of its monotonic one."""
    return float(line["utc_s"]) - float(line["mono"])


def _reported(log: Path, expected_s: float) -> bool:
    """Whether there is a report with a clock that is so far ahead."""
    reports = [line for line in lines(log) if line["event"] == "report"]
    return bool(reports) and abs(ahead_s(reports[-1]) - expected_s) < 60


def test_reports_go_on_when_the_clock_is_set(agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ahead and back; numbers and monotonic times stay in order, no fault ends, and the report shows one run without a pause."""
    log = agent.folder / "log"
    monkeypatch.setattr(_wall_clock, "LIMIT_S", 60.0)  # on a busy machine PHM waits for a CPU instead of sleeping
    until(lambda: any(line["event"] == "report" for line in lines(log)), "a report")
    real_s = ahead_s(lines(log)[0])
    for moved_s in (7200, -10_800, 0):
        _wall_clock.shift(agent.process.pid, moved_s)
        until(partial(_reported, log, real_s + moved_s), f"a report {moved_s} s ahead")
    until(lambda: agent.faults() == 1, "the fault in the status")
    found = lines(log)
    assert [line["seq"] for line in found] == list(range(1, len(found) + 1))
    assert [line["mono"] for line in found if line["event"] == "report"] == sorted(
        line["mono"] for line in found if line["event"] == "report"
    )
    assert not [line for line in found if line["event"] == "fault_closed" and line["unit"] == "host/disk"]
    made = report(log)
    least_s, most_s = (last["mono"] - found[0]["mono"] for last in (found[-1], lines(log)[-1]))
    assert least_s - 5 <= made["window"]["duration_s"] <= most_s + 5
    assert made["agents"][0]["uptime"] == pytest.approx(1.0) and made["agents"][0]["missing_lines"] == 0
    assert [round(step / 3600) for _, step in made["clocks"]["runs"][0]["steps"]] == [2, -5, 3]
