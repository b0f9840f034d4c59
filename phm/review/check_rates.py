"""How often each check reported a fault, and how long faults lasted: MTBF and MTTR. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from phm.core.model import NO_ACTION, NOT_OBSERVED, Phase
from phm.review.statistics import rate_limits

Json = dict[str, Any]
CONSEQUENCE = "reattributed"
"""Outcome of a fault that turned out to follow from another one: it is not counted."""

ROUNDED_S = 0.001
"""Times in rows are rounded to this."""


def counted(faults: Sequence[Json]) -> list[Json]:
    """The faults that are not consequences of others."""
    return [fault for fault in faults if fault["outcome"] != CONSEQUENCE]


def opened(faults: Sequence[Json], begin: float) -> list[Json]:
    """Those that opened in the window: one that was open before belongs to the time before."""
    return [fault for fault in counted(faults) if fault["opened"] >= begin - ROUNDED_S]


def rows(faults: Sequence[Json], observed_s: Mapping[str, float]) -> list[Json]:
    """One row for each check. observed_s: for how many agent seconds each check was run.

    mtbf_s is null without a fault; its limits are the exact 95 % confidence interval, mtbf_high_s null when there is none.
    """
    by_check: dict[str, list[Json]] = {check: [] for check in observed_s}
    for fault in counted(faults):
        by_check.setdefault(fault["check"], []).append(fault)
    found = [_row(check, each, observed_s.get(check, 0.0)) for check, each in by_check.items()]
    return sorted(found, key=lambda row: (-row["faults"], row["check"]))


def _row(check: str, faults: Sequence[Json], observed_s: float) -> Json:
    times = repair_times(fault for fault in faults if fault["closed"] is not None)
    low, high = rate_limits(len(faults), observed_s)
    return {
        "check": check,
        "faults": len(faults),
        "resolved": sum(fault["closed"] is not None and fault["outcome"] == "resolved" for fault in faults),
        "by_action": sum(by_action(fault) for fault in faults),
        "observed_s": round(observed_s, 3),
        "mtbf_s": round(observed_s / len(faults), 3) if faults else None,
        "mtbf_low_s": round(1 / high, 3) if high else None,
        "mtbf_high_s": round(1 / low, 3) if low else None,
        "mttr_s": round(sum(times) / len(times), 3) if times else None,
        "longest_s": round(max(times), 3) if times else None,
    }


def by_action(fault: Json) -> bool:
    """Whether an action of PHM has ended it, by PHM's record."""
    begun = {step["action"] for step in fault["steps"] if step["phase"] == Phase.STARTED.value}
    return fault["outcome"] == "resolved" and fault["by"] not in NO_ACTION and fault["by"] in begun


def repair_times(faults: Iterable[Json]) -> list[float]:
    """How long the resolved ones lasted, as far as their end was observed."""
    return [each["lasted_s"] for each in faults if each["outcome"] == "resolved" and each["by"] not in NOT_OBSERVED]
