"""A telemetry radio, from its RADIO_STATUS. Pure; callers pass the time.

The firmware of a SiK radio answers each HEARTBEAT from its own side with a report, whether or not the other radio is
reachable. So PHM's own heartbeats cause reports, at most as often as they are sent.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import fmean, median
from typing import Any

from phm.facts.links import RadioFact

UNKNOWN = 255
KEPT = 9
ENOUGH = 4
"""Number of pauses between reports that determine their period."""
MEAN_OF = 5


class RadioState:
    """The radio behind one endpoint. Not thread-safe."""

    def __init__(self, link: str) -> None:
        self._link = link
        self._times: deque[float] = deque(maxlen=KEPT)
        self._counts: deque[tuple[float, int, int]] = deque(maxlen=MEAN_OF + 1)
        self._margins: deque[float] = deque(maxlen=MEAN_OF)
        self._remmargins: deque[float] = deque(maxlen=MEAN_OF)
        self._newest: Any = None
        self._partnered = False
        self._asked_s = 0.0

    def receive(self, now: float, message: Any, asked_s: float) -> None:
        """Process a RADIO_STATUS. asked_s: seconds between PHM's own heartbeats."""
        if asked_s != self._asked_s:
            self._times.clear()
            self._asked_s = asked_s
        self._times.append(now)
        self._counts.append((now, message.rxerrors, message.fixed))
        for margins, signal, noise in (
            (self._margins, message.rssi, message.noise),
            (self._remmargins, message.remrssi, message.remnoise),
        ):
            if UNKNOWN not in (signal, noise):
                margins.append(float(signal - noise))
        if _partnerless(message):
            self._remmargins.clear()
        elif UNKNOWN not in (message.remrssi, message.remnoise):
            self._partnered = True
        self._newest = message

    @property
    def received_at(self) -> float:
        """When it reported last, in monotonic seconds; call only after the first report."""
        return self._times[-1]

    def fact(self, now: float, not_counted_s: float = 0.0) -> RadioFact | None:
        """The fact; None if never received. not_counted_s: see `RadioFact`."""
        if self._newest is None:
            return None
        newest, rates, without = self._newest, self._rates(), _partnerless(self._newest)
        far = (None, None) if without else (_known(newest.remrssi), _known(newest.remnoise))
        return RadioFact(
            self._link,
            now - self._times[-1],
            self._due_s(),
            _known(newest.rssi),
            far[0],
            _known(newest.noise),
            far[1],
            newest.txbuf,
            fmean(self._margins) if self._margins else None,
            fmean(self._remmargins) if self._remmargins else None,
            *rates,
            without and self._partnered,
            not_counted_s,
        )

    def _due_s(self) -> float:
        pauses = [after - before for before, after in pairwise(self._times)]
        return median(pauses) if len(pauses) >= ENOUGH else self._asked_s

    def _rates(self) -> tuple[float | None, float | None]:
        """Rates of rxerrors and fixed. Counters that went back mean that the radio restarted."""
        span_s = self._counts[-1][0] - self._counts[0][0]
        if span_s <= 0.0:
            return None, None
        damaged, fixed = (
            sum(new - old if new >= old else new for old, new in pairwise(values))
            for values in ([count[1] for count in self._counts], [count[2] for count in self._counts])
        )
        return damaged / span_s, fixed / span_s


def _partnerless(message: Any) -> bool:
    """Whether the other radio is lost.

    A SiK radio reports zeros for the other one after it has received nothing from it for 3.2 to 3.7 s (`link_update` of
    its firmware: more than five looks of 0.52 s). A radio that never reports these values counts too.
    """
    return bool(message.remrssi == 0 and message.remnoise == 0)


def _known(value: int) -> int | None:
    return None if value == UNKNOWN else value
