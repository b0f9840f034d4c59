"""Whether a publisher's rate has become another one: told as soon as every look of late shows it, before a window's mean does."""

from __future__ import annotations

LOOKS, SPAN_S = 4, 1.0
"""So many looks in a row, over so much publication time, must each show it. A stall is one long look, however long."""
OFF = 0.15
"""Each by more than this share of what the rate was, and by JITTERS standard deviations of how even the publisher was."""
JITTERS = 4.0


class RateChange:
    """Watches one publisher, look by look. Costs a few operations a look, and nothing grows."""

    def __init__(self) -> None:
        self._looks = 0
        self._seconds = 0.0
        self._sign = 0
        self._room_s = 0.0

    @property
    def steady(self) -> bool:
        """Whether the newest look showed the usual rate."""
        return not self._looks

    def add(self, count: int, seconds: float, usual_hz: float | None, jitter_s: float | None) -> bool:
        """A look: `count` publications took `seconds`. usual_hz, jitter_s: of what was before the run of odd looks.

        True when the run is long enough to be another rate; then a new run begins.
        """
        if usual_hz is None or jitter_s is None:
            self.forget()
            return False
        if not self._looks:
            self._room_s = JITTERS * jitter_s
        due_s = count / usual_hz
        late_s = seconds - due_s
        sign = 0 if abs(late_s) <= max(OFF * due_s, self._room_s) else (1 if late_s > 0 else -1)
        if not sign or sign != self._sign:
            self.forget()
            self._sign = sign
        if not sign:
            return False
        self._looks += 1
        self._seconds += seconds
        if self._looks < LOOKS or self._seconds < SPAN_S:
            return False
        self.forget()
        return True

    def forget(self) -> None:
        """Begin anew."""
        self._looks, self._seconds, self._sign = 0, 0.0, 0
