"""Statistics of measured values. Pure."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

_T = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.16, 2.145, 2.131)
"""Quantiles 0.975 of Student's t for 1, 2, 3 ... degrees of freedom; with more, the last one is a little too wide."""


@dataclass(frozen=True)
class Stats:
    """Statistics of n values; all None for n = 0. p50 and p95 are by nearest rank, so they are measured values."""

    n: int
    mean: float | None = None
    p50: float | None = None
    p95: float | None = None
    max: float | None = None
    min: float | None = None


def stats(values: Iterable[float | None]) -> Stats:
    """Statistics of the values that are not None."""
    known = sorted(value for value in values if value is not None)
    if not known:
        return Stats(0)
    return Stats(len(known), math.fsum(known) / len(known), rank(known, 0.5), rank(known, 0.95), known[-1], known[0])


def rank(ordered: Sequence[float], part: float) -> float:
    """The smallest of the ordered values that is not below the share `part` (0 to 1) of them."""
    return ordered[max(0, math.ceil(part * len(ordered)) - 1)]


@dataclass(frozen=True)
class Estimate:
    """A figure over n seeds: mean, standard deviation, smallest, largest, and the 95 % confidence interval of the mean
    by Student's t; the last four None for one seed.
    """

    n: int
    mean: float
    deviation: float | None = None
    least: float | None = None
    most: float | None = None
    half: float | None = None
    """Half of the width of the confidence interval."""


def estimate(values: Iterable[float | None]) -> Estimate | None:
    """Over the seeds for which the figure was measured; None without any."""
    known = [float(value) for value in values if value is not None]
    if not known:
        return None
    mean = math.fsum(known) / len(known)
    if len(known) == 1:
        return Estimate(1, mean)
    deviation = statistics.stdev(known)
    quantile = _T[min(len(known) - 1, len(_T)) - 1]
    return Estimate(len(known), mean, deviation, min(known), max(known), quantile * deviation / math.sqrt(len(known)))
