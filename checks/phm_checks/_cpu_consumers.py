"""The consumer of the CPU time that a container or the computer lacks.

Not a check: files in this folder whose names start with an underscore are parts of checks.
"""

from __future__ import annotations

from phm import api
from phm_checks._text import clean

FEW = 0.1
"""A consumer that uses fewer CPUs than this is not named."""


def top_consumer(world: api.World, but: str = "") -> tuple[str, float] | None:
    """The name and CPU use of the largest consumer, other than container `but`; None if it is unknown.

    The probe needs two queries before it has an answer, so call this before the answer is urgent.
    """
    try:
        found = [fact for fact in world.pressure.consumers() if fact.name != but and fact.cpus >= FEW]
    except api.CannotTell:
        return None
    if not found:
        return None
    first = found[0]
    return clean(first.name, 80) or OUTSIDE, first.cpus


OUTSIDE = "a process outside containers"
