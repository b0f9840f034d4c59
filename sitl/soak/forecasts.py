"""Back-test of the forecasts that PHM reported in recorded runs: what came true, how long before, and how often wrong.

``python -m sitl.soak.forecasts RECORD... [--json]`` reads records of campaigns and soaks (``.jsonl``, ``.jsonl.gz``).

A forecast came true if its unit became ERROR later in the same run, or if the leak that was injected on that agent ended in the kernel's
kill. It is wrong if neither happened before the run ended. `restarts_rising` states no limit, so it is counted alone.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from phm.review.statistics import rate_limits
from sitl.campaign.trial import RaisedWarning, Trial
from sitl.soak.runner import load

LIMITED = ("disk_filling", "memory_filling", "radio_fading", "jitter_rising")
UNLIMITED = ("restarts_rising",)
LEAK, LEAKING = "memory_leak", "memory_filling"


@dataclass(frozen=True, slots=True)
class Row:
    """One condition. leads_s: from each report that came true to its end. low, high: 95 % limits of the wrong ones per agent hour."""

    condition: str
    reports: int
    came_true: int | None
    leads_s: tuple[float, ...]
    wrong: int | None
    agent_hours: float
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Found:
    """rows: of all conditions. leaks: injected ones that ended in a kill; forecast: those that were reported before."""

    rows: tuple[Row, ...]
    leaks: int
    forecast: int


def backtest(trials: Sequence[Trial]) -> Found:
    """Of all runs, also of aborted ones: a report in these is wrong unless it came true before the end."""
    hours = sum(max(0.0, trial.seconds) * trial.agents for trial in trials) / 3600
    leaks = [(trial, each.agent, each.moment) for trial in trials for each in trial.injections if each.fault == LEAK]
    ended = [(trial, agent, moment) for trial, agent, moment in leaks if moment is not None]
    before = sum(
        any(each.agent == agent and each.mono < moment for each in _reports(trial, LEAKING))
        for trial, agent, moment in ended
    )
    return Found(tuple(_row(trials, condition, hours) for condition in (*LIMITED, *UNLIMITED)), len(ended), before)


def _reports(trial: Trial, condition: str) -> Iterator[RaisedWarning]:
    """A unit that was WARN already for another reason has no time for this one, and is left out."""
    return (each for each in trial.warned if each.conditions[:1] == [condition])


def _row(trials: Sequence[Trial], condition: str, hours: float) -> Row:
    found = [(trial, each) for trial in trials for each in _reports(trial, condition)]
    if condition in UNLIMITED:
        return Row(condition, len(found), None, (), None, hours, None, None)
    ends = [(each.mono, _end(trial, each)) for trial, each in found]
    leads = tuple(sorted(round(end - mono, 1) for mono, end in ends if end is not None))
    wrong = len(found) - len(leads)
    return Row(condition, len(found), len(leads), leads, wrong, hours, *rate_limits(wrong, hours))


def _end(trial: Trial, report: RaisedWarning) -> float | None:
    """When that which was forecast happened; None: not in this run."""
    errors = [each.mono for each in trial.alarms if (each.agent, each.unit) == (report.agent, report.unit)]
    if LEAKING in report.conditions:
        errors += [each.moment for each in trial.injections if _leaked(each.fault, each.agent, report) and each.moment]
    return min((each for each in errors if each >= report.mono), default=None)


def _leaked(fault: str, agent: int, report: RaisedWarning) -> bool:
    return (fault, agent) == (LEAK, report.agent)


def words(found: Found) -> Iterator[str]:
    """A line for each condition, and one for the leaks."""
    for row in found.rows:
        if row.came_true is None:
            yield f"{row.condition}: {row.reports} reports in {row.agent_hours:.1f} agent hours"
            continue
        lead = (
            ""
            if not row.leads_s
            else f", {min(row.leads_s):.0f} to {max(row.leads_s):.0f} s before (median {median(row.leads_s):.0f} s)"
        )
        yield (
            f"{row.condition}: {row.reports} reports in {row.agent_hours:.1f} agent hours; {row.came_true} came true"
            f"{lead}; {row.wrong} wrong (95 % limits {row.low:.2f} to {row.high:.2f} in an agent hour)"
        )
    yield f"{found.forecast} of {found.leaks} injected leaks were forecast before the kernel's kill"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m sitl.soak.forecasts", description=__doc__)
    parser.add_argument("records", nargs="+", type=Path, metavar="RECORD", help="of a campaign or a soak")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    asked = parser.parse_args(arguments)
    trials = [trial for path in asked.records for trial in load(path)]
    if not trials:
        parser.error(
            f"no runs in {', '.join(map(str, asked.records))}: name the runs.jsonl of a soak or a campaign's record"
        )
    found = backtest(trials)
    sys.stdout.write(json.dumps(asdict(found), indent=1) + "\n" if asked.json else "\n".join(words(found)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
