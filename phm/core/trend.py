"""The trend of a measurement, and when it reaches a limit: a robust line with a stated confidence. Pure.

The slope is the median of the slopes of all pairs of points (Theil 1950, Sen 1968), which up to 29 % of outliers do not
move. Its confidence interval is Sen's, from the variance of Kendall's tau with ties; measurements that follow each other
are not independent, so that variance is multiplied by (1 + r) / (1 - r), with r the correlation of successive residuals
(Hamed and Rao 1998, for lag 1).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist, median

POINTS = 48
"""Most points that are kept: their 1128 slopes take about a millisecond on a small board."""
LEAST_POINTS = 8
PARTS = (1, 2, 4)
"""All points are looked at, else their newer half, else the newest quarter: a trend that began late shows there first."""
EXTRAPOLATED = 2.0
"""A limit is forecast at most this many times as far ahead as the trend has been observed."""
KEPT_SLOPE = 0.9
"""A trend goes on while the newer half of its points has at least this share of its slope."""
MOST_CORRELATED = 0.95
ROUNDING = 1e-9
"""Deviations from a line of at most this share of the largest value are rounding errors."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """When a measurement reaches its limit, in seconds from the newest measurement."""

    likely_s: float
    latest_s: float
    """With the lowest slope of the confidence interval."""
    earliest_s: float
    slope: float
    """Change per second."""
    span_s: float
    """How long the trend was observed."""


class Trend:
    """The newest points of one measurement, over at most `window_s` seconds."""

    def __init__(self, window_s: float, *, least_s: float, confidence: float = 0.95) -> None:
        """least_s: observed at least for this long before anything is forecast. confidence: 0.5 to 0.999, of `latest_s`."""
        self._window_s, self._least_s = window_s, least_s
        self._z = NormalDist().inv_cdf(confidence)
        self._spacing_s = least_s / LEAST_POINTS / 2
        self._points: list[tuple[float, float]] = []
        self._newest_s = float("-inf")

    def add(self, at_s: float, value: float) -> None:
        """Take a measurement. One that follows the last point too soon, or is not a number, is not kept."""
        points = self._points
        if not math.isfinite(value):
            return
        self._newest_s = at_s
        if points and at_s - points[-1][0] < self._spacing_s:
            return
        points.append((at_s, value))
        while points and at_s - points[0][0] > self._window_s:
            del points[0]
        if len(points) > POINTS:
            del points[1::2]
            self._spacing_s *= 2

    def forget(self) -> None:
        """Start again: the subject is another one, e.g. a container that was restarted."""
        self._points.clear()
        self._spacing_s = self._least_s / LEAST_POINTS / 2

    def reaches(self, limit: float) -> Forecast | None:
        """When the trend reaches `limit`; None if it does not, or if that is not known with confidence."""
        for part in PARTS:
            found = self._forecast(self._points[-len(self._points) // part :], limit)
            if found is not None:
                return found
        return None

    def _forecast(self, points: Sequence[tuple[float, float]], limit: float) -> Forecast | None:
        if len(points) < LEAST_POINTS or points[-1][0] - points[0][0] < self._least_s:
            return None
        slope = _slope(points)
        # Where the line is now: the newest point itself may be an outlier.
        left = limit - median(value + slope * (self._newest_s - at_s) for at_s, value in points)
        sign = 1.0 if left > 0.0 else -1.0
        series = [(at_s, sign * value) for at_s, value in points]
        bounds = _bounds(series, sign * slope, self._z)
        if bounds is None or bounds[0] <= 0.0 or _slope(series[len(series) // 2 :]) < KEPT_SLOPE * sign * slope:
            return None
        left, span_s = abs(left), points[-1][0] - points[0][0]
        if left / bounds[0] > EXTRAPOLATED * span_s:
            return None
        return Forecast(left / abs(slope), left / bounds[0], left / bounds[1], slope, span_s)


@dataclass(frozen=True, slots=True)
class Line:
    """The slope of some points, in units per second, with the limits of its confidence interval."""

    slope: float
    low: float
    high: float


def line(points: Sequence[tuple[float, float]], *, confidence: float = 0.95) -> Line | None:
    """The slope of points at different times, with a two-sided confidence interval. None when they are too few for it.

    It compares all pairs: 100 points take some milliseconds.
    """
    if len(points) < LEAST_POINTS:
        return None
    slope = _slope(points)
    bounds = _bounds(points, slope, NormalDist().inv_cdf((1 + confidence) / 2))
    return None if bounds is None else Line(slope, *bounds)


def _slopes(points: Sequence[tuple[float, float]]) -> list[float]:
    return sorted(
        (later[1] - earlier[1]) / (later[0] - earlier[0])
        for number, earlier in enumerate(points)
        for later in points[number + 1 :]
    )


def _slope(points: Sequence[tuple[float, float]]) -> float:
    return median(_slopes(points))


def _bounds(points: Sequence[tuple[float, float]], slope: float, z: float) -> tuple[float, float] | None:
    """The lowest and the highest slope; None if there are too few points for that confidence."""
    slopes = _slopes(points)
    width = z * math.sqrt(_variance(points) * _inflation(points, slope))
    low, high = math.floor((len(slopes) - width) / 2), math.ceil((len(slopes) + width) / 2)
    return None if low < 0 or high >= len(slopes) else (slopes[low], slopes[high])


def _variance(points: Sequence[tuple[float, float]]) -> float:
    """Of Kendall's sum, with ties of the values."""

    def part(count: int) -> int:
        return count * (count - 1) * (2 * count + 5)

    ties = Counter(value for _, value in points).values()
    return (part(len(points)) - sum(part(count) for count in ties if count > 1)) / 18


def _inflation(points: Sequence[tuple[float, float]], slope: float) -> float:
    residuals = [value - slope * at_s for at_s, value in points]
    middle = math.fsum(residuals) / len(residuals)
    offsets = [residual - middle for residual in residuals]
    # Rounding errors of a straight line are correlated, and mean nothing.
    if max(map(abs, offsets)) <= ROUNDING * max(abs(value) for _, value in points):
        return 1.0
    total = math.fsum(offset * offset for offset in offsets)
    correlation = math.fsum(one * other for one, other in pairwise(offsets)) / total
    correlation = min(max(correlation, 0.0), MOST_CORRELATED)
    return (1 + correlation) / (1 - correlation)
