"""Rates of faults with what chance allows. The formulas are in docs/reference/report.md. Pure, standard library only."""

from __future__ import annotations

import math

CONFIDENCE = 0.95


def rate_limits(count: int, exposure: float) -> tuple[float, float]:
    """The exact 95 % confidence interval (Garwood) of the rate of a Poisson process with `count` events in `exposure`."""
    if exposure <= 0:
        return 0.0, math.inf
    tail = (1 - CONFIDENCE) / 2
    low = (
        0.0
        if count == 0
        else _mean_where(lambda mean: 1 - _cumulative(count - 1, mean), tail, rising=True, count=count)
    )
    high = _mean_where(lambda mean: _cumulative(count, mean), tail, rising=False, count=count)
    return low / exposure, high / exposure


def same_rate(count_a: int, exposure_a: float, count_b: int, exposure_b: float) -> float | None:
    """The probability of a difference at least as unlikely as this one if both rates are equal; None without exposure.

    The exact conditional test: given the sum of the counts, the first is binomial with the share of its exposure.
    """
    if exposure_a <= 0 or exposure_b <= 0:
        return None
    total = count_a + count_b
    if total == 0:
        return 1.0
    share = exposure_a / (exposure_a + exposure_b)
    seen = _binomial(count_a, total, share)
    if total > 20_000:
        return _normal(count_a, total, share)
    unlikely = math.fsum(p for p in (_binomial(k, total, share) for k in range(total + 1)) if p <= seen * (1 + 1e-9))
    return min(1.0, unlikely)


def _binomial(k: int, n: int, p: float) -> float:
    log = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1) + k * math.log(p) + (n - k) * math.log1p(-p)
    return math.exp(log)


def _normal(k: int, n: int, p: float) -> float:
    return math.erfc(abs(k - n * p) / math.sqrt(2 * n * p * (1 - p)))


def _cumulative(count: int, mean: float) -> float:
    """P(X <= count) of a Poisson variable."""
    if mean <= 0:
        return 1.0
    return min(1.0, math.fsum(math.exp(k * math.log(mean) - mean - math.lgamma(k + 1)) for k in range(count + 1)))


def _mean_where(function: object, value: float, *, rising: bool, count: int) -> float:
    """The mean for which the function has the value, by bisection."""
    assert callable(function)
    low, high = 0.0, count + 10 * math.sqrt(count + 1) + 10
    for _ in range(80):
        middle = (low + high) / 2
        if (function(middle) < value) is rising:
            low = middle
        else:
            high = middle
    return (low + high) / 2
