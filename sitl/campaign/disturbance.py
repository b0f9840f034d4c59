"""What else delayed the detection of a fault on its agent. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator

from sitl.campaign.attempts import AGAIN
from sitl.campaign.trial import Trial
from sitl.campaign.verdict import BESIDE, Verdict

CPU, ENGINE = "host/cpu", "engine"
ENDS = ("verified", *AGAIN)
"""Phases that end an action."""


def disturbed(verdict: Verdict, trial: Trial) -> bool:
    """Whether, between the fault and its detection, PHM of the agent reported a busy CPU (WARN or ERROR) or that the Docker Engine does
    not respond, or acted there for another fault: it waits for the CPU and the engine then, and reports nothing that the load or that
    action explains.
    """
    fault = verdict.injection
    if verdict.detected_s is None or fault.moment is None or fault.unit.startswith((BESIDE, ENGINE)):
        return False
    begun, detected = fault.moment, fault.moment + verdict.detected_s
    return any(since <= detected and until >= begun for since, until in _times(trial, fault.agent))


def _times(trial: Trial, agent: int) -> Iterator[tuple[float, float]]:
    """When the agent reported a busy CPU or no engine, and when PHM acted on it."""
    for alarm in trial.alarms:
        if alarm.agent == agent and alarm.unit in (CPU, ENGINE):
            yield alarm.mono, math.inf if alarm.closed is None else alarm.closed
    for warning in trial.warned:
        if (warning.agent, warning.unit) == (agent, CPU):
            yield warning.mono, math.inf if warning.ended is None else warning.ended
    acts = sorted((act for act in trial.acts if act.agent == agent), key=lambda act: act.mono)
    for place, act in enumerate(acts):
        if act.phase == "started":
            ends = (each.mono for each in acts[place + 1 :] if each.unit == act.unit and each.phase in ENDS)
            yield act.mono, next(ends, math.inf)
