"""A page of tables and plots, made of the same parts as the page of a flight. For the figures of campaigns and soaks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal

from phm.review import html_file


@dataclass(frozen=True)
class ChartSeries:
    """A line of a chart: points in ascending order of x; y None: a gap."""

    name: str
    x: Sequence[float]
    y: Sequence[float | None]


@dataclass(frozen=True)
class Chart:
    """x: words below the axis. rows: of ``dots``, the names of y 0, 1, 2...; they have one series. log: from and to of a logarithmic x axis.
    marks: named vertical lines."""

    title: str
    unit: str
    x: str
    series: Sequence[ChartSeries]
    kind: Literal["line", "steps", "dots"] = "line"
    rows: Sequence[str] = ()
    log: tuple[float, float] | None = None
    marks: Sequence[tuple[str, float]] = ()


@dataclass(frozen=True)
class ChartSection:
    """A table, or sentences, with a title and an introduction."""

    title: str
    words: str = ""
    head: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = field(default_factory=list)
    sentences: Sequence[str] = ()


def render(title: str, said: Sequence[str], sections: Sequence[object], charts: Sequence[Chart]) -> str:
    """The page. said: its first sentences. sections: with the attributes of `ChartSection`. Needs jinja2."""
    drawn = [asdict(chart) for chart in charts if any(series.x for series in chart.series)]
    return html_file.render("charts.html", "charts.js", drawn, title=title, said=said, sections=sections, drawn=drawn)
