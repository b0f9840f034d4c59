"""The traffic of one MAVLink endpoint over time: rates, silence, and loss per sender. Pure; callers pass the time."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import replace

from phm.core.scheduling_delay import Late, never_late
from phm.facts.links import LineFact, LinkFact, SenderFact
from phm.transport.mavlink_traffic import Traffic
from phm.transport.serial_errors import SerialErrorCount

SAMPLE_S = 0.4
"""Endpoints request an update twice a second, and there may be several."""
RATE_S = 5.0
STEP_S, LOSS_S = 5.0, 30.0
SHORT_S = 5.0
"""Checks that evaluate a silence here do so after less time."""
MIN_FRAMES = 20
"""With fewer frames the number of missing ones is unknown."""
_Counts = dict[tuple[int, int], tuple[int, int]]


class LinkStats:
    """Not thread-safe. own: PHM's own system and component, whose frames a router may send back. late_s: for how long
    PHM did not run, which is excluded from every silence."""

    def __init__(self, own: tuple[int, int], late_s: Late = never_late) -> None:
        self._own, self._late_s = own, late_s
        self._totals: deque[tuple[float, Traffic]] = deque(maxlen=int(RATE_S / SAMPLE_S) + 2)
        self._steps: deque[tuple[float, _Counts]] = deque(maxlen=int(LOSS_S / STEP_S) + 1)
        self._moved_at: float | None = None
        self._received_at: dict[tuple[int, int], float] = {}

    def sample(self, now: float, traffic: Traffic) -> None:
        """Record the counters; calls more frequent than SAMPLE_S are ignored."""
        if self._totals and now - self._totals[-1][0] < SAMPLE_S:
            return
        before = self._totals[-1][1] if self._totals else Traffic()
        if traffic.bytes_in != before.bytes_in:
            self._moved_at = now
        moved = {key: now for key, counts in traffic.senders.items() if counts[0] != before.senders.get(key, (0, 0))[0]}
        known = {key: at for key, at in self._received_at.items() if key in traffic.senders}
        self._received_at = {**known, **moved}
        self._totals.append((now, traffic))
        while now - self._totals[0][0] > RATE_S:
            self._totals.popleft()
        if not self._steps or now - self._steps[-1][0] >= STEP_S:
            self._steps.append((now, dict(traffic.senders)))

    def fact(self, now: float, base: LinkFact) -> LinkFact:
        """`base` with the known traffic figures."""
        if not self._totals:
            return base
        (first, old), (last, new) = self._totals[0], self._totals[-1]
        span_s = last - first

        def rate(before: int, after: int) -> float | None:
            return max(0, after - before) / span_s if span_s >= 1.0 else None

        return replace(
            base,
            rx_age_s=None if self._moved_at is None else self._silent_s(self._moved_at, now),
            rx_s=rate(old.bytes_in, new.bytes_in),
            tx_s=rate(old.bytes_out, new.bytes_out),
            frames_s=rate(old.frames, new.frames),
            bad_s=rate(old.bad, new.bad),
            frame_bytes_s=rate(old.frame_bytes, new.frame_bytes),
            verified_s=rate(old.verified, new.verified),
            senders=self._senders(now, new),
            line=_line(old.line, new.line, span_s),
        )

    def _senders(self, now: float, newest: Traffic) -> tuple[SenderFact, ...]:
        known: Collection[tuple[int, int]] = [key for key in newest.senders if key != self._own]
        return tuple(self._sender(key, now, newest) for key in sorted(known))

    def _sender(self, key: tuple[int, int], now: float, newest: Traffic) -> SenderFact:
        frames, lost = newest.senders[key]
        before = next((counts[key] for _, counts in self._steps if key in counts), (frames, lost))
        came, missing = frames - before[0], max(0, lost - before[1])
        loss = 100.0 * missing / (came + missing) if came >= MIN_FRAMES else None
        return SenderFact(*key, self._silent_s(self._received_at.get(key, now), now), max(0, came), loss)

    def _silent_s(self, since: float, now: float) -> float:
        return max(0.0, now - since - self._late_s(since, SHORT_S))


def _line(old: SerialErrorCount | None, new: SerialErrorCount | None, span_s: float) -> LineFact | None:
    if old is None or new is None or span_s < 1.0:
        return None
    pairs = ((old.framing, new.framing), (old.overrun, new.overrun), (old.parity, new.parity))
    return LineFact(*(max(0, after - before) / span_s for before, after in pairs))
