"""Finds the agent of a recording of ROS 2, which has no MAVLink system."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterable, Sequence

from phm.review.agent_record import AgentRecord
from phm.review.external_entry import ExternalEntry

OURS = "phm/"
"""Names of PHM's own diagnostics begin with this."""
MOST_FOLDERS = 8
"""Maximum number of folders in the name of a recording."""


def owned(others: Iterable[ExternalEntry], agents: Sequence[AgentRecord]) -> tuple[list[ExternalEntry], dict[str, str]]:
    """The entries with the agent that is known, and names for the recordings without one, by path.

    A recording without PHM's own diagnostics belongs to the agent whose logs are in the same folder or in the nearest one above
    it, if these are logs of one agent.
    """
    folders = [(agent.id, folder) for agent in agents for run, _ in agent.runs for folder in run.folders]
    near: dict[str, int] = {}
    found: list[ExternalEntry] = []
    for other in others:
        if other.system:
            found.append(other)
            continue
        if other.file not in near:
            near[other.file] = _nearest(os.path.dirname(os.path.abspath(other.file)), folders)
        found.append(other._replace(system=near[other.file]))
    return found, _names({other.file for other in found if not other.system})


def without_ours(others: Iterable[ExternalEntry], logged: Collection[int]) -> list[ExternalEntry]:
    """Without PHM's own diagnostics of agents with a log: it says the same."""
    return [
        other
        for other in others
        if not (other.what == "diagnostic" and other.system in logged and other.text.startswith(OURS))
    ]


def _nearest(folder: str, logs: Sequence[tuple[int, str]]) -> int:
    """The agent of the logs in the nearest folder at or above this one that has some; 0: of several, or there are none."""
    while True:
        found = {
            number for number, place in logs if place == folder or place.startswith(folder.rstrip(os.sep) + os.sep)
        }
        if found or folder == os.path.dirname(folder):
            return found.pop() if len(found) == 1 else 0
        folder = os.path.dirname(folder)


def _names(files: set[str]) -> dict[str, str]:
    """The file's name, with as many folders before it as distinguish it from the others, up to MOST_FOLDERS."""
    words = {file: os.path.abspath(file).split(os.sep)[-1 - MOST_FOLDERS :] for file in files}
    ends = Counter(tuple(one[place:]) for one in words.values() for place in range(len(one)))

    def shortest(one: list[str]) -> list[str]:
        return next((one[place:] for place in reversed(range(len(one))) if ends[tuple(one[place:])] == 1), one)

    return {file: f"recording {os.sep.join(shortest(one))}" for file, one in words.items()}
