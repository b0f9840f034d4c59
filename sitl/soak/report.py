"""What a soak has found: a document for programs, a table for the terminal, and a page. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from phm.review import charts
from sitl.campaign.trial import Trial
from sitl.soak.alarms import count
from sitl.soak.sample import Sample
from sitl.soak.slopes import MEASUREMENTS, Growth, averaged, points, restarts, rows

Json = dict[str, Any]
HEAD = ("measurement", "mean", "slope per hour", "95 % interval", "verdict", "largest slope of one agent")
DRAWN = 240
"""Points of each line of a plot."""


def document(samples: Sequence[Sample], trials: Sequence[Trial], setting: Json) -> Json:
    """All figures, as JSON can hold them. setting: what was asked for, and where it ran."""
    alarms = count(trials)
    return {
        "setting": setting,
        "agents": sorted({sample.agent for sample in samples}),
        "observed_s": round(sum(trial.seconds for trial in trials), 1),
        "samples": len(samples),
        "restarts": restarts(samples),
        "slopes": [
            {
                "measurement": row.measurement.name,
                "unit": row.measurement.unit,
                "all": _growth(row.all),
                "worst": row.worst,
                "agents": {agent: _growth(growth) for agent, growth in row.of.items()},
            }
            for row in rows(samples)
        ],
        "alarms": {
            **asdict(alarms),
            "high": _finite(alarms.high),
            "per_agent_hour": alarms.per_agent_hour,
            "listed": list(alarms.listed),
            "not_seen": list(alarms.not_seen),
        },
    }


def _growth(growth: Growth) -> Json:
    return {
        "mean": growth.mean,
        "slope": growth.slope,
        "low": growth.low,
        "high": growth.high,
        "verdict": growth.verdict,
    }


def _finite(value: float) -> float | None:
    return value if value < float("inf") else None


def table(found: Json) -> list[tuple[str, ...]]:
    """The rows below `HEAD`."""
    made: list[tuple[str, ...]] = []
    for row in found["slopes"]:
        every, unit, worst = row["all"], f" {row['unit']}".rstrip(), row["worst"]
        made.append(
            (
                row["measurement"],
                f"{every['mean']:.4g}{unit}",
                "-" if every["slope"] is None else f"{every['slope']:+.3g}{unit}",
                "-" if every["slope"] is None else f"{every['low']:+.3g} to {every['high']:+.3g}",
                every["verdict"],
                "-" if worst is None else f"A{worst:02d} {row['agents'][worst]['slope']:+.3g}",
            )
        )
    return made


def complete(found: Json) -> bool:
    """Whether all the time that was asked for was observed."""
    return bool(found["observed_s"] >= 0.99 * found["setting"]["seconds"])


def sentences(found: Json) -> list[str]:
    """What there is beside the table."""
    alarms, setting = found["alarms"], found["setting"]
    rate = "-" if alarms["per_agent_hour"] is None else f"{alarms['per_agent_hour']:.3g}"
    limits = "" if alarms["high"] is None else f" (95 % limits {alarms['low']:.3g} to {alarms['high']:.3g})"
    missed = f" ({', '.join(alarms['not_seen'])})" if alarms["not_seen"] else ""
    return [
        f"{len(found['agents'])} agents, {found['observed_s'] / 3600:.2f} of {setting['seconds'] / 3600:.2f} h observed"
        f"{'' if complete(found) else ': NOT COMPLETE'}; {setting['machine']}, commit {setting['commit']}.",
        f"{alarms['false']} false alarms in {alarms['agent_hours']:.2f} agent hours: {rate} per agent hour{limits}.",
        f"{alarms['injected']} faults injected, {alarms['missed']} missed{missed}, {alarms['by_action']} ended by an action of PHM.",
        f"PHM was started again {found['restarts']} times; slopes are of the longest run of each agent.",
    ]


def page(found: Json, samples: Sequence[Sample], trials: Sequence[Trial]) -> str:
    """One HTML file. Needs jinja2."""
    sections = [
        charts.ChartSection("Slopes", "Per hour, over all agents together.", HEAD, table(found)),
        charts.ChartSection("False alarms", sentences=found["alarms"]["listed"] or ["none"]),
    ]
    return charts.render("PHM soak", sentences(found), sections, _plots(samples, trials))


def _plots(samples: Sequence[Sample], trials: Sequence[Trial]) -> list[charts.Chart]:
    begin = min((sample.mono for sample in samples), default=0.0)
    marks = [
        ("", (each.moment - begin) / 3600) for trial in trials for each in trial.injections if each.moment is not None
    ]
    made = []
    for measurement in MEASUREMENTS:
        series = []
        for agent in sorted({sample.agent for sample in samples}):
            mine = [sample for sample in samples if sample.agent == agent]
            drawn = averaged([points(mine, measurement)], DRAWN)
            series.append(
                charts.ChartSeries(
                    f"A{agent:02d}",
                    [round((at - begin) / 3600, 5) for at, _ in drawn],
                    [round(value, 4) for _, value in drawn],
                )
            )
        made.append(charts.Chart(measurement.name, measurement.unit, "hours; lines: a fault", series, marks=marks))
    return made
