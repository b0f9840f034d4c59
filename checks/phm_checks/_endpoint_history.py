"""Named ends of topics in the course of time: which a running node had and gave up, and how long it takes to make one anew.

Not a check: memory of `topics`.
"""

from __future__ import annotations

from dataclasses import dataclass

from phm import api
from phm_checks._node_activity import went_on

SETTLE_S = 0.4
"""How long an end must be lost whose node goes on, before it is told. To make one anew, as for another quality of service,
takes some milliseconds."""
REMADE = 2.0
"""A node that has taken longer to make it anew (as one with a life cycle may) is given so many times as long again, on top."""
REMADE_MOST_S = 5.0
"""What was away for longer was lost, and teaches nothing."""
REMEMBERED_S = 600.0

Key = tuple[str, str, str]
"""Topic, `publisher` or `subscriber`, node."""


@dataclass(slots=True)
class _End:
    """An end that was there since its node came into the graph. lost_at: monotonic; gap_s: the longest of late, as of gap_at."""

    lost_at: float | None = None
    gap_s: float = 0.0
    gap_at: float = 0.0


class EndpointHistory:
    """At most as many as are configured. What never was there is a matter of configuration, and no restart helps; neither is
    anything known of a node that was started anew."""

    def __init__(self) -> None:
        self._had: dict[Key, _End] = {}

    def lost(self, key: Key, *, there: bool, listed: bool, now: float) -> bool:
        """Whether a node that is listed had this end and gave it up. Called at every look."""
        end = self._had.get(key)
        if there:
            end = end or self._had.setdefault(key, _End())
            if end.lost_at is not None:
                self._came_back(end, now)
            return False
        if end is None:
            return False
        if not listed:
            del self._had[key]
            return False
        end.lost_at = now if end.lost_at is None else end.lost_at
        return True

    def young(self, topic: str, now: float) -> bool:
        """Whether all ends of the topic that are lost may be being made anew at this moment."""
        lost = [end.lost_at for key, end in self._had.items() if key[0] == topic and end.lost_at is not None]
        return bool(lost) and now - min(lost) < SETTLE_S

    def settle_s(self, key: Key, fact: api.RosFact, now: float) -> float | None:
        """How long a lost end must have been away to be told; None while its node has not been heard since: it may be ending."""
        end = self._had[key]
        assert end.lost_at is not None
        if not went_on(key[2], fact, now - end.lost_at):
            return None
        return SETTLE_S + (REMADE * end.gap_s if now - end.gap_at <= REMEMBERED_S else 0.0)

    def _came_back(self, end: _End, now: float) -> None:
        assert end.lost_at is not None
        gap_s, end.lost_at = now - end.lost_at, None
        if gap_s > REMADE_MOST_S:
            return
        if gap_s >= end.gap_s or now - end.gap_at > REMEMBERED_S:
            end.gap_s, end.gap_at = gap_s, now
