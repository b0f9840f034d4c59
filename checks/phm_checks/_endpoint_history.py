"""History of named topic endpoints: which ones a running node had and closed, and how long it takes to recreate one.

Not a check: holds state for `topics`.
"""

from __future__ import annotations

from dataclasses import dataclass

from phm import api
from phm_checks._node_activity import went_on

SETTLE_S = 0.4
"""How long an endpoint must be lost before it is reported, while its node continues to run. Recreating one, for example to change its
quality of service, takes some milliseconds."""
REMADE = 2.0
"""A node that took longer to recreate an endpoint, as a lifecycle node may, gets this multiple of that time in addition."""
REMADE_MOST_S = 5.0
"""An endpoint that was gone for longer was lost; the duration is not used as a reference."""
REMEMBERED_S = 600.0

Key = tuple[str, str, str]
"""Topic, `publisher` or `subscriber`, node."""


@dataclass(slots=True)
class _End:
    """An endpoint that has existed since its node appeared in the graph. lost_at: monotonic time; gap_s: the longest recent gap,
    measured at gap_at."""

    lost_at: float | None = None
    gap_s: float = 0.0
    gap_at: float = 0.0


class EndpointHistory:
    """State of the configured endpoints, at most one entry each. An endpoint that never existed is a configuration problem, which no
    restart fixes. Nothing is known about the endpoints of a restarted node."""

    def __init__(self) -> None:
        self._had: dict[Key, _End] = {}

    def lost(self, key: Key, *, there: bool, listed: bool, now: float) -> bool:
        """Whether a listed node had this endpoint and closed it. Called for every snapshot."""
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

    def being_recreated(self, topic: str, now: float) -> bool:
        """Whether all lost endpoints of the topic may currently be being recreated."""
        lost = [end.lost_at for key, end in self._had.items() if key[0] == topic and end.lost_at is not None]
        return bool(lost) and now - min(lost) < SETTLE_S

    def settle_s(self, key: Key, fact: api.RosFact, now: float) -> float | None:
        """How long an endpoint must have been lost before it is reported. None while its node has given no sign of life since: it may be
        terminating."""
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
