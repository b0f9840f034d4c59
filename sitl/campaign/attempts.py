"""The recovery actions of a trial, and whether they helped. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.campaign.trial import Trial

AGAIN = ("started", "failed", "escalated")
"""Phases after which an attempt at the same unit cannot be verified any more."""


@dataclass(frozen=True)
class Attempt:
    """One action. `helped`: None when the trial, or the fault on its agent, was ended from outside first."""

    agent: int
    unit: str
    action: str
    mono: float
    helped: bool | None


def attempts(trial: Trial) -> list[Attempt]:
    """Every action that was started, in order."""
    acts = sorted(trial.acts, key=lambda act: act.mono)
    found = []
    for place, act in enumerate(acts):
        if act.phase != "started":
            continue
        later = [each for each in acts[place + 1 :] if (each.agent, each.unit) == (act.agent, act.unit)]
        end = next((each for each in later if each.phase in ("verified", *AGAIN)), None)
        helped: bool | None = None
        if end is not None and end.mono <= _cleared(trial, act.agent):
            helped = end.phase == "verified"
        found.append(Attempt(act.agent, act.unit, act.action, act.mono, helped))
    return found


def _cleared(trial: Trial, agent: int) -> float:
    """When the campaign began to clear the faults of an agent."""
    times = [each.cleared for each in trial.injections if each.agent == agent and each.cleared is not None]
    return min(times, default=math.inf)
