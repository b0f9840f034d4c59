"""Pictures of the graph that are incomplete by their own evidence: they are no reason for an alarm.

Not a check: memory of `topics`. Why pictures can be so, and what is done about it: `phm.probes.ros.unnamed_participants`.
"""

from __future__ import annotations

from phm import api
from phm_checks._endpoint_matching import full, named_sides
from phm_checks._text import listed

LATE_S = 0.3
"""Topics are looked at every 0.25 s: a sample this much younger than the last listed publisher came after it."""


class GraphGaps:
    """At most as many as topics are configured."""

    def __init__(self) -> None:
        self._unlisted_since: dict[str, float] = {}
        """Topics without a listed publisher, on the monotonic clock."""

    def judge(self, topic: api.TopicSettings, seen: api.TopicFact, now: float) -> api.Result | None:
        """STALE where it is open whether a named end is there, or data prove what is not listed; else nothing."""
        name = full(topic.name)
        numbers: dict[str, api.Value] = {"publishers": len(seen.publishers), "subscribers": len(seen.subscribers)}
        for kind, wanted, there in named_sides(topic, seen):
            names = {end.node for end in there}
            lacking = [node for node in map(full, wanted) if node not in names]
            if lacking and "" in names:
                return api.stale(
                    f"topic {name} has a {kind} whose node PHM does not know: whether {listed(lacking)} "
                    f"{'is' if len(lacking) == 1 else 'are'} connected is unknown",
                    brief="",
                    **numbers,
                )
        if self._unlisted_flows(name, seen, now):
            return api.stale(
                f"data arrives on topic {name} though discovery lists no publisher: PHM's view of the graph is incomplete",
                brief="",
                **numbers,
            )
        return None

    def _unlisted_flows(self, name: str, seen: api.TopicFact, now: float) -> bool:
        """Whether a sample came after the last publisher was listed."""
        if seen.publishers:
            self._unlisted_since.pop(name, None)
            return False
        since = self._unlisted_since.setdefault(name, now)
        silent_s = seen.rate.silent_s if seen.rate is not None else None
        return silent_s is not None and now - silent_s >= since + LATE_S
