"""How often a defect of PHM's participant may cause a new one. Pure; callers pass the time."""

from __future__ import annotations

from phm.core.backoff import Backoff

REST_S, REST_MOST_S = 60.0, 900.0
"""Time between two new participants for one kind of defect. Doubled while they do not help: others can cause what looks like it."""


class RenewalPace:
    """Not thread-safe."""

    def __init__(self) -> None:
        self._renewed_at: float | None = None
        self._backoff = Backoff(REST_S, REST_MOST_S)

    def allows(self, now: float) -> bool:
        """Whether a new participant may be requested now; counts it if so. now: monotonic seconds."""
        rest_s, before = self._backoff.pause_s, self._renewed_at
        if before is not None and now - before < rest_s:
            return False
        if before is not None and now - before < 2 * rest_s:
            self._backoff.next_s()
        else:
            self._backoff.reset()
        self._renewed_at = now
        return True
