"""Measurements at one moment, as names, labels and numbers: what a page of metrics is made from. Pure.

`phm.wire.openmetrics` turns a page into text. Values of labels come from outside (names of containers, topics, agents), so they are
made printable and cut, and a metric has at most MAX_SERIES of them: what is more is left out and counted.
"""

from __future__ import annotations

import bisect
import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

from phm.wire.text import one_line

MAX_LABEL = 100
MAX_SERIES = 500
"""Of one metric: every unit of a large configuration, as on /diagnostics."""

Labels = tuple[str, ...]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Metric:
    """One metric as documented. name: complete, with its unit and `_total`."""

    name: str
    kind: Literal["gauge", "counter", "histogram"]
    help: str
    labels: Labels = ()


class MetricCatalog:
    """The metrics of one page, in their order."""

    def __init__(self) -> None:
        self.metrics: list[Metric] = []

    def gauge(self, name: str, text: str, *labels: str) -> Metric:
        return self._add(Metric(name, "gauge", text, labels))

    def counter(self, name: str, text: str, *labels: str) -> Metric:
        return self._add(Metric(name, "counter", text, labels))

    def histogram(self, name: str, text: str, *labels: str) -> Metric:
        return self._add(Metric(name, "histogram", text, labels))

    def _add(self, metric: Metric) -> Metric:
        self.metrics.append(metric)
        return metric


LEFT_OUT = Metric(
    "phm_metrics_left_out",
    "gauge",
    "Series left out because their metric has reached its limit",
)


class HistogramCounts:
    """How many durations were at most as long as each limit, in seconds."""

    def __init__(self, limits: Sequence[float]) -> None:
        self._limits = tuple(limits)
        self._counts = [0] * (len(self._limits) + 1)
        self.total = 0.0

    def observe(self, value: float) -> None:
        self._counts[bisect.bisect_left(self._limits, value)] += 1
        self.total += value

    def buckets(self) -> list[tuple[str, float]]:
        """Pairs of limit and number, cumulative, the last one `+Inf`."""
        found, seen = [], 0
        for limit, count in zip((*self._limits, math.inf), self._counts, strict=True):
            seen += count
            found.append(("+Inf" if math.isinf(limit) else str(float(limit)), float(seen)))
        return found


class MetricsPage:
    """Filled once by one thread, then read."""

    def __init__(self, metrics: Iterable[Metric], max_series: int = MAX_SERIES) -> None:
        """metrics: those that may be added, in the order of the page. max_series: of one metric."""
        self._max_series = max_series
        self._samples: dict[Metric, dict[Labels, float]] = {metric: {} for metric in (*metrics, LEFT_OUT)}
        self._histograms: dict[Metric, dict[Labels, HistogramCounts]] = {}
        self._left_out = 0

    def add(self, metric: Metric, value: float | int | bool | None, *labels: object) -> None:
        """Add a sample. None, NaN and infinity are no measurement: nothing is added. Of two equal sets of labels the first stays."""
        found = number(value)
        if found is not None and math.isfinite(found):
            self._put(self._samples[metric], metric, found, labels)

    def add_counts(self, metric: Metric, counts: Mapping[Labels, int]) -> None:
        for labels, count in counts.items():
            self.add(metric, count, *labels)

    def add_histograms(self, metric: Metric, counts: Mapping[Labels, HistogramCounts]) -> None:
        for labels, histogram in counts.items():
            self._put(self._histograms.setdefault(metric, {}), metric, histogram, labels)

    def samples(self) -> Iterable[tuple[Metric, Mapping[Labels, float], Mapping[Labels, HistogramCounts]]]:
        """The metrics that have samples."""
        self._samples[LEFT_OUT][()] = float(self._left_out)
        for metric, values in self._samples.items():
            histograms = self._histograms.get(metric, {})
            if values or histograms:
                yield metric, values, histograms

    def _put(self, series: dict[Labels, T], metric: Metric, value: T, labels: tuple[object, ...]) -> None:
        assert len(labels) == len(metric.labels), metric.name
        words = tuple(clean_label(label) for label in labels)
        if words in series:
            return
        if len(series) >= self._max_series:
            self._left_out += 1
            return
        series[words] = value


def clean_label(value: object) -> str:
    """Printable, on one line, at most MAX_LABEL characters. One that is cut ends with a checksum, so that two that begin alike do
    not become one series."""
    whole = str(value)
    text = one_line(whole[: MAX_LABEL + 1])
    if len(text) <= MAX_LABEL:
        return text
    checksum = zlib.crc32(whole.encode("utf-8", "surrogatepass"))
    return f"{text[: MAX_LABEL - 11]}...{checksum:08x}"


def ratio(percent: object) -> float | None:
    """Percent as a ratio, 0 to 1; None for anything else."""
    value = number(percent)
    return None if value is None else value / 100


def number(value: object) -> float | None:
    """A number or a truth value as a float; None for anything else."""
    try:
        return float(value) if isinstance(value, (int, float)) else None
    except OverflowError:  # an integer of any length
        return None
