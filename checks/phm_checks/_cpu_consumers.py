"""Who has the CPUs that a container or the computer is short of. Not a check: files of this folder that begin with an underscore are
parts of checks.
"""

from __future__ import annotations

from phm import api
from phm_checks._text import clean

FEW = 0.1
"""Who takes fewer CPUs than this is not named."""


def top_consumer(world: api.World, but: str = "") -> tuple[str, float] | None:
    """The name and the CPUs of the consumer that takes most, other than container `but`; None when it cannot be seen.

    The probe needs two questions to know, so ask before it is urgent.
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
