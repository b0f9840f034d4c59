"""Plots of a campaign, as charts of `phm.review.charts`. Pure."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from phm.review.charts import Chart, ChartSeries

LOW_S, HIGH_S = 0.01, 100.0
Marks = Sequence[tuple[str, float]]
Named = Sequence[tuple[str, Sequence[float]]]


def on_axis(seconds: float) -> float:
    """A time on the logarithmic axis; values off the axis are drawn at its ends."""
    return min(max(seconds, LOW_S), HIGH_S)


def strips(title: str, rows: Named, marks: Marks = ()) -> Chart:
    """One row of dots for each class, one dot per fault; `marks`: named times across all rows."""
    dots = sorted((on_axis(value), float(place)) for place, (_, values) in enumerate(rows) for value in values)
    series = ChartSeries("fault", [x for x, _ in dots], [y for _, y in dots])
    names = [name for name, _ in rows]
    return Chart(title, "", "seconds", [series], "dots", rows=names, log=(LOW_S, HIGH_S), marks=marks)


def steps(title: str, curves: Named, marks: Marks = ()) -> Chart:
    """Share of the faults (0 to 100 %) done within a time, one curve for each name."""
    times = sorted({LOW_S, HIGH_S, *(on_axis(value) for _, values in curves for value in values)})
    series = [
        ChartSeries(f"{name} ({len(values)})", times, _shares(values, times)) for name, values in curves if values
    ]
    return Chart(title, "%", "seconds", series, "steps", log=(LOW_S, HIGH_S), marks=marks)


def _shares(values: Sequence[float], times: Sequence[float]) -> list[float]:
    """Percent of the values that are not above each time."""
    ordered = sorted(on_axis(value) for value in values)
    return [round(100 * bisect_right(ordered, at) / len(ordered), 3) for at in times]
