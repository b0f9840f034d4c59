"""Advice for nodes that PHM does not receive: the difference between the application's ROS environment and PHM's, if one is visible."""

from __future__ import annotations

from phm import api
from phm_checks._text import clean

MOST = 2
"""Maximum number of differences that a text names."""
MAX_TEXT = 400
TRANSPORT = frozenset({"FASTDDS_BUILTIN_TRANSPORTS", "FASTDDS_DEFAULT_PROFILES_FILE", "ipc"})
"""Differences that leave discovery working and keep data from arriving."""


def advice(world: api.World, container: str, otherwise: str, *, data_only: bool = False) -> str:
    """What to change, or `otherwise` if no difference is visible. container: key of the configuration, or empty.

    data_only: discovery works, so only the transport can differ.
    """
    if not container:
        return otherwise
    try:
        found = world.environment.differences(container)
    except api.CannotTell:
        return otherwise
    named = [one for one in found if not data_only or one.variable in TRANSPORT]
    certain = [clean(one.text, MAX_TEXT) for one in named if one.certain][:MOST]
    if certain:
        return "; ".join(certain)
    return "; ".join([otherwise, *(clean(one.text, MAX_TEXT) for one in named[:MOST])])
