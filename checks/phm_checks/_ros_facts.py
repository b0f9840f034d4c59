"""What the checks of the ROS graph read from a snapshot in the same way: names, its age, silent beacons, large topics."""

from __future__ import annotations

from phm import api
from phm_checks._text import span

OLD_SNAPSHOT_S = 5.0
"""Older snapshots of the ROS child process are not evaluated."""
SILENT_PERIODS, SILENT_S = 3.0, 0.5
"""A beacon is silent if it misses this many periods, and for at least this long."""
LARGE_BPS = 0.8e6
"""Topics with more bytes per second are sampled with pauses (`phm.probes.ros.rates.topic_monitor`)."""


def full_name(name: str) -> str:
    """A ROS name with its leading slash."""
    return f"/{api.topic_id(name)}"


def snapshot(world: api.World) -> api.RosFact:
    """The newest snapshot. Raises CannotTell without a recent one."""
    fact = world.ros.snapshot()
    if fact.age_s > OLD_SNAPSHOT_S:
        raise api.CannotTell(f"the ROS child process has sent nothing for {span(fact.age_s)}, too old to evaluate")
    return fact


def graph_snapshot(world: api.World) -> api.RosFact:
    """The newest snapshot of the graph. Raises CannotTell without a recent one."""
    fact = world.ros.snapshot()
    if fact.age_s > OLD_SNAPSHOT_S:
        raise api.CannotTell(f"the newest ROS graph snapshot is {span(fact.age_s)} old, too old to evaluate")
    return fact


def beacon_silent(fact: api.BeaconFact, late_s: float = 0.0) -> bool:
    """Whether PHM does not receive the node's beacon. late_s: age of the snapshot, which does not count."""
    return max(0.0, fact.silent_s - late_s) > max(SILENT_PERIODS * fact.period_s, SILENT_S)


def is_large(rate: api.RateFact, hz: float) -> bool:
    """Whether the samples of a topic, at this rate, are so many bytes that PHM pauses between them."""
    return (rate.sample_bytes or 0.0) * hz > LARGE_BPS
