"""The recorded publications of a publisher, so that a measured rate is compared with the truth."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from phm.facts import RateFact


def true_rate(path: Path, window_s: float) -> float:
    """In Hz over the last `window_s`, on a machine under any load; nan if it has fewer than two publications, e.g. right after a
    publisher got no CPU for longer. path: lines of `COUNT SECONDS`."""
    lines = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
    sent = [(int(words[0]), float(words[1])) for words in lines[:-1]]  # the last line may be incomplete
    recent = [entry for entry in sent if sent[-1][1] - entry[1] <= window_s]
    if len(recent) < 2:
        return math.nan
    (first, since_s), (count, at_s) = recent[0], recent[-1]
    return (count - first) / (at_s - since_s)


def within_2_percent(rate: RateFact | None, path: Path) -> bool:
    """Whether a rate measured over at least 2 s is the true one."""
    if rate is None or rate.hz is None or rate.window_s < 2.0:
        return False
    return rate.hz == pytest.approx(true_rate(path, rate.window_s), rel=0.02)
