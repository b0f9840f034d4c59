"""The back-test of the forecasts in recorded runs: which came true, how long before, and which were wrong."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from sitl.campaign.publication import RECORD
from sitl.campaign.trial import RaisedWarning, Trial, append
from sitl.harness.compose_stack import ROOT
from sitl.soak.forecasts import Row, backtest, main
from sitl.soak.runner import load
from tests.fakes.campaign_trials import T0, alarm, injection, trial

MEMORY, DISK = "pressure/ros_app", "host/disk"


def warned(
    after: float, condition: str, unit: str = MEMORY, agent: int = 3, more: tuple[str, ...] = ()
) -> RaisedWarning:
    return RaisedWarning(agent, unit, 9, T0 + after, [condition, *more], "it grows")


def row(trials: list[Trial], condition: str) -> Row:
    return next(each for each in backtest(trials).rows if each.condition == condition)


def leak(agent: int = 3) -> Trial:
    """A leak that the kernel ends 70 s after it began."""
    return trial(injections=[injection(fault="memory_leak", agent=agent, asked=T0 - 70, moment=T0)], alarms=[])


def test_a_leak_that_is_forecast_before_the_kill_came_true() -> None:
    """Its lead is the time from the forecast to the kill."""
    run = leak()
    run.warned = [warned(-21, "memory_filling")]
    found = row([run], "memory_filling")
    assert (found.reports, found.came_true, found.leads_s, found.wrong) == (1, 1, (21.0,), 0)
    assert (backtest([run]).leaks, backtest([run]).forecast) == (1, 1)


def test_a_forecast_after_the_kill_or_of_another_agent_is_wrong() -> None:
    """And the leak counts as not forecast."""
    run = leak()
    run.warned = [warned(3, "memory_filling"), warned(-21, "memory_filling", agent=4)]
    found = row([run], "memory_filling")
    assert (found.came_true, found.wrong) == (0, 2)
    assert (backtest([run]).leaks, backtest([run]).forecast) == (1, 0)


def test_an_error_of_the_unit_is_what_was_forecast() -> None:
    """Not one of another unit, and not one before."""
    run = trial(
        injections=[],
        alarms=[alarm(30, DISK), alarm(-5, DISK), alarm(9, "host/memory")],
        warned=[warned(10, "disk_filling", DISK), warned(31, "disk_filling", DISK)],
    )
    found = row([run], "disk_filling")
    assert (found.came_true, found.leads_s, found.wrong) == (1, (20.0,), 1)


def test_wrong_forecasts_are_counted_per_agent_hour_of_all_runs() -> None:
    """Two runs of eight agents, 41 s each."""
    runs = [trial(warned=[warned(5, "jitter_rising", "rates/topic")], number=number) for number in (1, 2)]
    found = row(runs, "jitter_rising")
    assert found.agent_hours == pytest.approx(2 * 8 * 41 / 3600)
    assert found.wrong == 2 and found.low is not None and found.high is not None
    assert found.low < 2 / found.agent_hours < found.high


def test_restarts_state_no_limit_so_they_are_neither_true_nor_wrong() -> None:
    """They are counted as reports only."""
    found = row([trial(warned=[warned(5, "restarts_rising", "container/ros_app")])], "restarts_rising")
    assert (found.reports, found.came_true, found.wrong) == (1, None, None)


def test_a_unit_that_was_a_warning_already_has_no_time_for_the_forecast() -> None:
    """The log does not say when the second reason began."""
    run = leak()
    run.warned = [warned(-21, "memory_pressure", more=("memory_filling",))]
    assert row([run], "memory_filling").reports == 0


def test_the_command_reads_records_and_names_what_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As text and as JSON; another file is an error."""
    run = leak()
    run.warned = [warned(-21, "memory_filling")]
    append(tmp_path / "runs.jsonl", run)
    assert main([str(tmp_path / "runs.jsonl")]) == 0
    said = capsys.readouterr().out
    assert "1 came true, 21 to 21 s before" in said and "1 of 1 injected leaks" in said
    assert main([str(tmp_path / "runs.jsonl"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["forecast"] == 1
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / "none.jsonl")])
    assert ended.value.code == 2 and "name the runs.jsonl of a soak" in capsys.readouterr().err


def test_the_page_has_the_figures_of_the_published_campaign() -> None:
    """Each row of its table, the time, and the leaks."""
    found = backtest(load(ROOT / RECORD))
    page = (ROOT / "docs/reference/trends.md").read_text("utf-8")
    part = page[page.index("Of the [published campaign]") : page.index("In the [two-hour soak]")]
    assert f" {found.rows[0].agent_hours:.1f} agent hours:" in part
    for each in found.rows:
        cells = next(line for line in part.splitlines() if line.startswith(f"| `{each.condition}` |")).split("|")
        reports, came_true, before, wrong = (cell.strip() for cell in cells[2:6])
        assert reports == str(each.reports), each.condition
        if each.came_true is None:
            assert came_true == "states no limit"
            continue
        assert (came_true, wrong) == (str(each.came_true), str(each.wrong)), each.condition
        assert re.findall(r"\d+", before) == [f"{lead:.0f}" for lead in each.leads_s], each.condition
    assert f"{found.forecast} of the {found.leaks} injected leaks" in " ".join(part.split())
