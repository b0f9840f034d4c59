"""Configured nodes whose beacons other nodes receive and PHM's participant does not. Pure; callers pass the time.

When the lease of PHM's participant ends only for a node, as for a process that was stopped or got no CPU, the node drops PHM's
subscriptions. Fast DDS considers their announcements as acknowledged and does not send them again. PHM's graph is complete then, but
it receives nothing more from this node (seen with Jazzy and a lease of 5 s: a node that was stopped for 8 s). A new participant has new
subscriptions.
"""

from __future__ import annotations

from collections.abc import Collection

from phm.facts.ros import RosFact
from phm.probes.ros.renewal_pace import RenewalPace

UNRECEIVED_S = 10.0
"""It must have lasted this long: after an interruption of the network, nodes are discovered again one by one, on a busy machine within
10 s. Meanwhile what others receive keeps the node from being reported."""


class UnreceivedNodes:
    """Decides for which nodes a new participant is needed."""

    def __init__(self, unreceived_s: float = UNRECEIVED_S) -> None:
        self._unreceived_s = unreceived_s
        self._since: dict[str, float] = {}
        self._pace = RenewalPace()

    def observe(self, fact: RosFact, nodes: Collection[str], now: float) -> dict[str, str]:
        """By name of each node, who receives it; usually none. nodes: the configured ones. now: monotonic seconds."""
        unreceived = {name: report.by for name in nodes if (report := fact.received_only_elsewhere(name)) is not None}
        self._since = {name: self._since.get(name, now) for name in unreceived}
        due = {name: unreceived[name] for name, at in self._since.items() if now - at >= self._unreceived_s}
        if not due or not self._pace.allows(now):
            return {}
        self._since = {}
        return due
