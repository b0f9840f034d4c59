"""Runs of a campaign that did not go as planned: aborted ones, and those without their load. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from sitl.campaign.groups import Group
from sitl.campaign.table import Rows
from sitl.campaign.trial import BUSY, Trial

LOADED = 95.0
"""Mean CPU of the machine in percent below which the load of a busy run was missing for a part of it."""


def rows(groups: Sequence[Group]) -> Rows:
    """How many there are of each."""
    return [
        ("runs that were aborted and repeated", *(str(len(group.aborted)) for group in groups)),
        (
            f"runs with the load busy whose mean CPU was below {LOADED:g} %: in all figures",
            *(str(sum(unloaded(trial) for trial in group.trials)) if group.load == BUSY else "-" for group in groups),
        ),
    ]


def unloaded(trial: Trial) -> bool:
    """Whether the machine was not busy during a run that is meant for a busy one, or this was not measured."""
    if trial.campaign[1] != BUSY:
        return False
    used = trial.machine_cpu
    return used is None or used < LOADED
