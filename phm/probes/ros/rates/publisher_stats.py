"""The samples of one publisher of a topic: rate, jitter, changes of the rate, and age of its newest sample."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

from phm.probes.ros.rates.silence import WindowedMax

SHORTEST_S = 1.0
"""Over a shorter span of publication time the jitter of two timestamps is too large a share."""
JUMP_S = 1.0
"""If timestamps and the time between two polls differ by more than this, a clock was set."""
FALLS, FALLS_S = 3, 10.0
"""A decreasing sequence number is a restarted publisher; this many within this time are two publishers."""
QUICKEST_S = 60.0
"""Minimum time for which the fastest delivery counts: clocks of two hosts drift apart by 3 ms meanwhile."""
POLLS, CHANGE_SPAN_S = 4, 1.0
"""Number of polls in a row, and their publication time, that must each show the change. A stall is a single long poll.
"""
OFF = 0.15
"""Each poll must differ by more than this share of the former rate, and by JITTERS standard deviations of the
publisher."""
JITTERS = 4.0
MISSING = 0.05
"""The smallest share of the time between two samples in which nothing was published that is not neglected."""
PUBLISHED = 0.5
"""The least share of the expected rate that disproves a silence."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One poll. sequence: None if the middleware has none. source_ns: publisher's clock. at_s: ours, monotonic."""

    sequence: int | None
    source_ns: int
    at_s: float
    writer: bytes | None = None
    """Identity of the publisher, if the middleware reports it (from Kilted on)."""
    size: int = 0
    """Bytes of the serialized message."""
    delay_s: float = 0.0
    """Time from publication to reception, each by the clock of its own host: apart from a constant, its delay."""
    waited_s: float = 0.0
    """Time from reception to the poll that took it."""


class PublisherStats:
    """One publisher.

    Invariant: in the window, sequence numbers rise and source times do not fall; anything else (a restart, a clock that
    was set) begins a new window.
    """

    def __init__(self, window_s: float) -> None:
        self.window_s = window_s
        self._kept: deque[Sample] = deque(maxlen=10_000)
        self._counted = 0
        self._falls: deque[float] = deque(maxlen=FALLS)
        self._jitter = Jitter()
        self._rate_change = RateChange()
        self._usual: tuple[float | None, float | None] = (None, None)
        """Rate and jitter at the last poll without a deviation."""
        self._odd_from: Sample | None = None
        self._changed_from: Sample | None = None
        """The newest sample before the polls that show another rate, also after they were enough."""
        self._quickest = WindowedMax(QUICKEST_S)
        self.last: Sample | None = None
        self.fell = False
        """Whether the sequence number of the newest sample was lower than that of the previous one."""
        self.turned = False
        """Whether the newest sample showed that its rate has changed."""
        self.began_s = 0.0
        self._first: int | None = None
        self.replaced = False
        """Whether it is known to be the restarted form of another publisher."""

    def add(self, sample: Sample) -> bool:
        """Take the next sample; False if it does not continue the previous ones."""
        numbered = sample.sequence is not None
        if not numbered:
            # Without sequence numbers: the deep queue provides every sample, so they are counted.
            self._counted += 1
            sample = replace(sample, sequence=self._counted)
        if self.last is None:
            self.began_s, self._first = sample.at_s, sample.sequence
        self.fell = self.turned = False
        continues = self.last is None or self._continues(self.last, sample, numbered)
        if not continues:
            self.forget()
        self._kept.append(sample)
        while sample.at_s - self._kept[0].at_s > self.window_s and len(self._kept) > 2:
            self._kept.popleft()
        if self._rate_change.steady:
            jitter_s = self.jitter_s
            self._usual, self._odd_from = (self.hz, self._usual[1] if jitter_s is None else jitter_s), sample
        self._quickest.add(-sample.delay_s, sample.at_s)
        self.last = sample
        return continues

    def _continues(self, last: Sample, sample: Sample, numbered: bool) -> bool:
        assert last.sequence is not None and sample.sequence is not None
        count = sample.sequence - last.sequence
        if count <= 0:
            self._falls.append(sample.at_s)
            self.fell = True
            return False
        published_s = (sample.source_ns - last.source_ns) / 1e9
        # Counted samples may be of several publishers, in any order.
        if (numbered and published_s < 0) or abs(published_s - (sample.at_s - last.at_s)) > JUMP_S:
            self._quickest.clear()
            return False
        if self._kept:  # otherwise this is the first sample after a silence
            if numbered and self._rate_change.add(count, published_s, *self._usual):
                self._change()
            self._jitter.add(count, published_s)
        return True

    def _change(self) -> None:
        """Earlier samples belong to another rate."""
        self._changed_from, self.turned = self._odd_from, True
        assert self._changed_from is not None
        while self._kept[0].at_s < self._changed_from.at_s:
            self._kept.popleft()
        self._jitter = Jitter()

    def forget(self) -> None:
        """Begin a new window: samples after a silence must not be averaged with earlier ones."""
        self._kept.clear()
        self._rate_change.forget()
        self._changed_from = None

    def missing_s(self, sample: Sample, expected_hz: float) -> float:
        """For how long nothing was published since the newest sample, by its rate, or by `expected_hz` if it has none; 0.0 if
        jitter explains it, or without either rate."""
        hz = self.hz or expected_hz
        if not hz or not self._kept or self.last is None or self.last.sequence is None or sample.sequence is None:
            return 0.0
        count, seconds = sample.sequence - self.last.sequence, (sample.source_ns - self.last.source_ns) / 1e9
        late_s = seconds - count / hz
        explained_s = max(MISSING * seconds, JITTERS * (self.jitter_s or 0.0))
        return late_s if count > 0 and late_s > explained_s else 0.0

    def published(self, sample: Sample, expected_hz: float) -> bool:
        """Whether it has published on since its newest sample, at PUBLISHED of this rate or more: what is missing was lost on the way."""
        last = self.last
        if last is None or last.sequence is None or sample.sequence is None:
            return False
        count = sample.sequence - last.sequence
        return count > 1 and count >= PUBLISHED * expected_hz * (sample.at_s - last.at_s)

    def mixed(self, now_s: float) -> bool:
        """Whether these sequence numbers must be those of several publishers."""
        return len(self._falls) == FALLS and now_s - self._falls[0] <= FALLS_S

    @property
    def span_s(self) -> float:
        """Publication time between the oldest and the newest sample of the window."""
        return (self._kept[-1].source_ns - self._kept[0].source_ns) / 1e9 if self._kept else 0.0

    @property
    def began_window_s(self) -> float:
        """When the oldest sample of the window was taken; without a window, the newest sample."""
        return self._kept[0].at_s if self._kept else self.at_s

    @property
    def hz(self) -> float | None:
        """The rate; None until the window is long enough."""
        if self.span_s < SHORTEST_S:
            return None
        first, last = self._kept[0].sequence, self._kept[-1].sequence
        assert first is not None and last is not None
        return (last - first) / self.span_s

    @property
    def changed_s(self) -> float | None:
        """How long it has had another rate than before, at each poll; None if that did not begin within the window."""
        return self.span_s if self._kept and self._kept[0] is self._changed_from else None

    @property
    def jitter_s(self) -> float | None:
        """See `Jitter`."""
        return self._jitter.jitter_s

    @property
    def at_s(self) -> float:
        """When its newest sample was taken; -inf before the first."""
        return -math.inf if self.last is None else self.last.at_s

    def takes_place(self, of: PublisherStats, most: float) -> bool:
        """Whether it is the restarted form of another publisher: it began after the other's end, with a sequence number
        of at most `most`, and replaces no third one."""
        assert self._first is not None
        return self._first <= most and self.began_s > of.at_s and not self.replaced

    def age_s(self, now_s: float) -> float | None:
        """Seconds since the newest sample was published, relative to the fastest recent delivery."""
        last, quickest = self.last, self._quickest.most
        if last is None or quickest is None:
            return None
        return now_s - last.at_s + last.waited_s + last.delay_s + quickest

    def clock_age_s(self, now_s: float) -> float | None:
        """The same by the clocks of both hosts; None if that is impossible."""
        if self.last is None:
            return None
        age_s = now_s - self.last.at_s + self.last.waited_s + self.last.delay_s
        return age_s if age_s >= 0 else None


class Jitter:
    """How evenly a publisher publishes, from occasional polls.

    Between two polls `count` samples are published in `seconds`. `jitter_s` is the standard deviation of `seconds -
    count * period`. If each period is observed separately (topics slower than the polls, 4 Hz) that is the standard
    deviation of the period. For faster topics it is that of publication times against an even period, which is the same
    for a timer; for independent periods it is larger by the square root of `count`.
    """

    FADE = 0.98
    """The weight of a poll relative to the next one: half of the total weight is on the last 34."""
    LEAST = 5.0

    def __init__(self) -> None:
        self._weight = self._count = self._seconds = self._counts2 = self._cross = self._seconds2 = 0.0

    def add(self, count: int, seconds: float) -> None:
        fade = self.FADE
        self._weight = self._weight * fade + 1.0
        self._count = self._count * fade + count
        self._seconds = self._seconds * fade + seconds
        self._counts2 = self._counts2 * fade + count * count
        self._cross = self._cross * fade + count * seconds
        self._seconds2 = self._seconds2 * fade + seconds * seconds

    @property
    def jitter_s(self) -> float | None:
        """The jitter; None until at least LEAST polls."""
        if self._weight < self.LEAST - 0.5:
            return None
        period_s = self._seconds / self._count
        squares = self._seconds2 - 2 * period_s * self._cross + period_s**2 * self._counts2
        return math.sqrt(max(0.0, squares / self._weight))


class RateChange:
    """Detects a change of rate of one publisher, poll by poll, with a few operations and constant memory."""

    def __init__(self) -> None:
        self._polls = 0
        self._seconds = 0.0
        self._sign = 0
        self._room_s = 0.0

    @property
    def steady(self) -> bool:
        """Whether the newest poll showed the usual rate."""
        return not self._polls

    def add(self, count: int, seconds: float, usual_hz: float | None, jitter_s: float | None) -> bool:
        """Record a poll: `count` publications took `seconds`.

        usual_hz, jitter_s: of the time before the deviating polls. True when these are enough for another rate; then a
        new series begins.
        """
        if usual_hz is None or jitter_s is None:
            self.forget()
            return False
        if not self._polls:
            self._room_s = JITTERS * jitter_s
        due_s = count / usual_hz
        late_s = seconds - due_s
        sign = 0 if abs(late_s) <= max(OFF * due_s, self._room_s) else (1 if late_s > 0 else -1)
        if not sign or sign != self._sign:
            self.forget()
            self._sign = sign
        if not sign:
            return False
        self._polls += 1
        self._seconds += seconds
        if self._polls < POLLS or self._seconds < CHANGE_SPAN_S:
            return False
        self.forget()
        return True

    def forget(self) -> None:
        """Restart the measurement."""
        self._polls, self._seconds, self._sign = 0, 0.0, 0
