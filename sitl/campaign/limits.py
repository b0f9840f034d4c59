"""The evidence limits of a record's faults as the faults state them now: a limit is a definition, and a record has that of its commit.
Pure.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from sitl.campaign.trial import Injection, Trial
from sitl.faults import all_faults
from sitl.faults.base import Fault

_FAULTS = cache(all_faults)
_SECONDS = re.compile(r"(\d+)s")


def stated(trial: Trial) -> Trial:
    """The trial with them. A fault that no longer exists keeps those of its record."""
    interval_s = healthcheck_s(trial.setting)
    return replace(trial, injections=[_stated(each, interval_s) for each in trial.injections])


def healthcheck_s(setting: Mapping[str, Any]) -> float | None:
    """The interval of the application's HEALTHCHECK, as the engine has it; None: that of its image, or it is not recorded."""
    for each in setting.get("differences", ()):
        if (each["of"], each["key"]) == ("application", "healthcheck.interval"):
            found = _SECONDS.fullmatch(str(each["here"]))
            return float(found[1]) if found else None
    return None


def _stated(injection: Injection, interval_s: float | None) -> Injection:
    fault: Fault | None = _FAULTS().get(injection.fault)
    if fault is None or fault.evidence_s is None:
        return injection
    limit_s, period_s = fault.evidence_s, fault.evidence_period_s
    if fault.by_healthcheck and interval_s is not None:
        limit_s, period_s = limit_s - period_s + interval_s, interval_s
    return replace(injection, evidence=fault.evidence, evidence_s=limit_s, evidence_period_s=period_s)
