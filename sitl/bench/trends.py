"""Back-test of the forecasts: how long before its limit a failing measurement is reported, and how often a harmless one is.

``python -m sitl.bench.trends [--series N] [--seed S] [--json]`` draws series of measurements, a family at a time, with all
parameters at random, and lets the code of the checks forecast each. One to two minutes for 100 series of each family.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import random
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from statistics import median, quantiles

from phm.core.settings import TrendSettings
from phm_checks._limit_forecast import LimitForecast

LIMIT = 95.0
"""Percent; `host.disk.error` and `host.memory.error`."""
HOURS = 1.0
EVERY_S = 5.0
Series = Iterator[float]


@dataclass(frozen=True, slots=True)
class Family:
    """One kind of series, in percent. fails: whether it goes on until it reaches the limit."""

    name: str
    fails: bool
    draw: Callable[[random.Random], Series]


def _times() -> Iterator[float]:
    return itertools.count(0.0, EVERY_S)


def _noise(draw: random.Random, size: float, correlated: float = 0.0) -> Series:
    value = 0.0
    while True:
        value = correlated * value + math.sqrt(1 - correlated**2) * draw.gauss(0.0, size)
        yield value


def _leak(draw: random.Random) -> Series:
    """Constant growth, which reaches the limit after 5 to 50 minutes, with correlated noise."""
    start, reached_s = draw.uniform(20, 70), draw.uniform(300, 3000)
    noise = _noise(draw, draw.uniform(0, 1), draw.uniform(0, 0.95))
    return (start + (LIMIT - start) * at_s / reached_s + next(noise) for at_s in _times())


def _late_leak(draw: random.Random) -> Series:
    """Steady at first; the leak begins after 5 to 30 minutes."""
    begins_s, takes_s, start = draw.uniform(300, 1800), draw.uniform(300, 1500), draw.uniform(20, 70)
    noise = _noise(draw, draw.uniform(0, 1), draw.uniform(0, 0.95))
    return (start + (LIMIT - start) * max(0.0, at_s - begins_s) / takes_s + next(noise) for at_s in _times())


def _stairs_leak(draw: random.Random) -> Series:
    """Growth in 10 to 60 equal steps, e.g. one for each recorded file."""
    start, reached_s, steps = draw.uniform(20, 70), draw.uniform(600, 3000), draw.randint(10, 60)
    return (start + (LIMIT - start) * math.floor(at_s / reached_s * steps) / steps for at_s in _times())


def _accelerating(draw: random.Random) -> Series:
    """Growth with the square of the time."""
    start, reached_s = draw.uniform(20, 70), draw.uniform(600, 3000)
    noise = _noise(draw, draw.uniform(0, 1), draw.uniform(0, 0.95))
    return (start + (LIMIT - start) * (at_s / reached_s) ** 2 + next(noise) for at_s in _times())


def _steady(draw: random.Random) -> Series:
    """Noise around a level of 20 to 84 %."""
    level, noise = draw.uniform(20, 84), _noise(draw, draw.uniform(0, 2), draw.uniform(0, 0.99))
    return (level + next(noise) for _ in _times())


def _walk(draw: random.Random) -> Series:
    """A random walk that stays between 10 and 84 %."""
    value, size = draw.uniform(20, 70), draw.uniform(0.05, 0.5)
    while True:
        value = min(84.0, max(10.0, value + draw.gauss(0.0, size)))
        yield value


def _sawtooth(draw: random.Random) -> Series:
    """Logs or garbage that are removed every 1 to 20 minutes."""
    period_s, height = draw.uniform(60, 1200), draw.uniform(2, 30)
    level = draw.uniform(20, 84 - height)
    return (level + height * (at_s % period_s) / period_s for at_s in _times())


def _start(draw: random.Random) -> Series:
    """Growth to a level within 10 s to 5 minutes, as of a program that loads its maps."""
    level, takes_s, start = draw.uniform(40, 84), draw.uniform(10, 300), draw.uniform(5, 40)
    noise = _noise(draw, draw.uniform(0, 1))
    return (start + (level - start) * (1 - math.exp(-3 * at_s / takes_s)) + next(noise) for at_s in _times())


def _plateau(draw: random.Random) -> Series:
    """Constant growth that ends by itself, after 5 to 30 minutes, below the limits."""
    start, level, takes_s = draw.uniform(20, 60), draw.uniform(62, 84), draw.uniform(300, 1800)
    noise = _noise(draw, draw.uniform(0, 1))
    return (start + (level - start) * min(1.0, at_s / takes_s) + next(noise) for at_s in _times())


def _steps(draw: random.Random) -> Series:
    """A level that changes at random times, e.g. with the mission's mode."""
    value, again = draw.uniform(20, 80), draw.uniform(0.001, 0.02)
    while True:
        if draw.random() < again:
            value = draw.uniform(20, 80)
        yield value


FAMILIES = (
    Family("constant leak", True, _leak),
    Family("leak that begins later", True, _late_leak),
    Family("leak in steps", True, _stairs_leak),
    Family("accelerating leak", True, _accelerating),
    Family("steady, with noise", False, _steady),
    Family("random walk", False, _walk),
    Family("sawtooth", False, _sawtooth),
    Family("growth of a start", False, _start),
    Family("growth that ends by itself", False, _plateau),
    Family("changing levels", False, _steps),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """One series. lead_s: from the first report to the limit; reports: begun while it was harmless, in `hours`."""

    lead_s: float | None
    reports: int
    hours: float


def run(series: Series, settings: TrendSettings, horizon_s: float, *, fails: bool) -> Outcome:
    """Forecast one series until it reaches the limit, or for an hour."""
    forecast = LimitForecast(horizon_s, settings.confidence)
    first_s: float | None = None
    reports, was = 0, False
    for at_s, value in zip(itertools.count(0.0, EVERY_S), series, strict=False):
        if at_s > 3600 * HOURS:
            return Outcome(None, reports, at_s / 3600)
        if fails and value >= LIMIT:
            return Outcome(0.0 if first_s is None else at_s - first_s, 0, at_s / 3600)
        soon = forecast.soon(at_s, value, LIMIT) is not None
        reports += soon and not was
        first_s = at_s if soon and not was else first_s
        was = soon
    raise AssertionError("series have no end")


def row(family: Family, count: int, seed: int, horizon_s: float) -> dict[str, object]:
    """The figures of `count` series: for failing ones the lead, for harmless ones the reports."""
    found = [
        run(
            family.draw(random.Random(f"{seed} {family.name} {number}")), TrendSettings(), horizon_s, fails=family.fails
        )
        for number in range(count)
    ]
    leads = sorted(outcome.lead_s for outcome in found if outcome.lead_s is not None)
    hours = sum(outcome.hours for outcome in found)
    return {
        "family": family.name,
        "fails": family.fails,
        "series": count,
        "reached the limit": len(leads) if family.fails else None,
        "reported before": sum(lead > 0 for lead in leads) if family.fails else None,
        "lead_s median": median(leads) if leads else None,
        "lead_s 10th percentile": quantiles(leads, n=10)[0] if len(leads) > 1 else None,
        "series reported wrongly": None if family.fails else sum(outcome.reports > 0 for outcome in found),
        "wrong reports per hour": None if family.fails else round(sum(o.reports for o in found) / hours, 3),
    }


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m sitl.bench.trends", description=__doc__)
    parser.add_argument("--series", type=int, default=100, help="of each family (100)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--horizon", type=float, default=TrendSettings().memory, help="seconds (as `trends.memory`)")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    options = parser.parse_args()
    rows = []
    for family in FAMILIES:
        print(f"{family.name} ...", file=sys.stderr)
        rows.append(row(family, options.series, options.seed, options.horizon))
    if options.json:
        print(json.dumps({"settings": asdict(_Shown(options.series, options.seed, options.horizon)), "rows": rows}))
        return 0
    for found in rows:
        shown = {name: value for name, value in found.items() if value is not None and name != "fails"}
        print(
            ", ".join(
                f"{name} {value:.0f}" if isinstance(value, float) and value >= 10 else f"{name} {value}"
                for name, value in shown.items()
            )
        )
    return 0


@dataclass(frozen=True, slots=True)
class _Shown:
    series: int
    seed: int
    horizon_s: float


if __name__ == "__main__":
    sys.exit(main())
