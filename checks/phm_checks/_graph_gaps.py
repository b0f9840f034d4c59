"""Detects graph snapshots that are incomplete by their own evidence: they are not a reason for an alarm.

Not a check: holds state for `topics`. `phm.probes.ros.unnamed_participants` explains why snapshots can be incomplete, and what PHM
does about it.
"""

from __future__ import annotations

from phm import api
from phm_checks._endpoint_matching import named_sides
from phm_checks._ros_facts import full_name
from phm_checks._text import listed

LATE_S = 0.3
"""Topics are polled every 0.25 s: a sample that is this much newer than the last listed publisher arrived after it."""


class GraphGaps:
    """State of the configured topics, at most one entry each."""

    def __init__(self) -> None:
        self._unlisted_since: dict[str, float] = {}
        """Topics without a listed publisher, on the monotonic clock."""

    def judge(self, topic: api.TopicSettings, seen: api.TopicFact, now: float) -> api.Result | None:
        """STALE if it is unknown whether a named endpoint exists, or data proves an endpoint that is not listed; otherwise None."""
        name = full_name(topic.name)
        numbers: dict[str, api.Value] = {"publishers": len(seen.publishers), "subscribers": len(seen.subscribers)}
        for kind, wanted, there in named_sides(topic, seen):
            names = {end.node for end in there}
            lacking = [node for node in map(full_name, wanted) if node not in names]
            if lacking and "" in names:
                return api.stale(
                    f"topic {name} has a {kind} whose node PHM does not know: whether {listed(lacking)} "
                    f"{'is' if len(lacking) == 1 else 'are'} connected is unknown",
                    values=numbers,
                )
        if self._unlisted_flows(name, seen, now):
            return api.stale(
                f"data arrives on topic {name} though discovery lists no publisher: PHM's view of the graph is incomplete",
                values=numbers,
            )
        return None

    def _unlisted_flows(self, name: str, seen: api.TopicFact, now: float) -> bool:
        """Whether a sample arrived after the last publisher disappeared from the list."""
        if seen.publishers:
            self._unlisted_since.pop(name, None)
            return False
        since = self._unlisted_since.setdefault(name, now)
        silent_s = seen.rate.silent_s if seen.rate is not None else None
        return silent_s is not None and now - silent_s >= since + LATE_S
