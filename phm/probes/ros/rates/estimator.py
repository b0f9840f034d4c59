"""Topic rates without reading the messages, from the publisher's own sequence numbers.

A reader with a queue of one, never put in an executor, lets the middleware overwrite samples in C++; Python takes one
of them each tick. Its sequence number shows how many were published since the last one taken, its source timestamp how
much time passed between the two publications. So the rate is exact however few samples are taken, and the cost in
Python does not grow with the rate. The timestamps are the middleware's, of the publisher's system clock: `use_sim_time`
does not affect them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from phm.facts.ros import RateFact
from phm.probes.ros.rates.publisher_stats import PublisherStats, Sample
from phm.probes.ros.rates.publishers import GONE_S, NEW_S, PublisherDemux, PublisherRestarts, gone_after_s
from phm.probes.ros.rates.silence import SilenceTimeout

WINDOW_S, PERIODS = 3.0, 3
"""Window of a rate in seconds, or this many expected periods if longer."""
WIDE_S, WIDE_PERIODS, WIDE_MOST_S = 10.0, 10, 60.0
"""The same for a publisher with jitter, but at most WIDE_MOST_S because of the periods."""
UNEVEN = 0.1
"""Jitter as a share of the expected rate from which the wide window is used."""
COUNTED = 20
"""Minimum number of samples to count a rate of several publishers: they do not arrive evenly."""
LATE_S, STALL_S = 0.5, 1.0
"""Looks further apart than LATE_S, two ticks, mean that PHM itself did not run. Half of that time counts as silence of
the publisher, so that a starved PHM still detects it; of the longest pause nothing beyond STALL_S counts."""
SLOW = 2
"""A publisher without a rate after this many times the time in which one of mean rate would be gone, so after 12 mean
periods, is left out of the sum: all of them together publish less than a twelfth of the expected rate."""
PACKET_BYTES = 65_000
"""A larger sample is sent in several packets and lost with any of them, as PHM's subscription is best effort. So PHM may receive few of
them, of a publisher that never pauses."""
_SHARE = 0.2
FADE_S, FADE_WINDOWS = 60.0, 20
"""Observations count for about this long, or this many windows if longer."""
_ALIKE = 0.7
"""Windows are compared if one is at least this share of the other."""


@dataclass(frozen=True, slots=True)
class Listening:
    """The circumstances of a poll.

    publishers: listed by discovery. several: whether samples may be of more than one. on: whether there was a
    subscription since the last poll. complete: whether the samples are all that were published since. closed_s: how
    long there may be no subscription. problem: why the rate cannot be measured.
    """

    publishers: int = 1
    several: bool = False
    on: bool = True
    complete: bool = False
    closed_s: float = 0.0
    matched: int | None = None
    problem: str = ""


ALONE = Listening()


class RateUncertainty:
    """Compares each rate with the one before its window began: both are of the same publisher, and share no sample.

    So jitter, bursts and stalls count by their effect on the rate. A rate that really changes is one difference among
    many and has little effect.
    """

    def __init__(self, window_s: float) -> None:
        self._fade_s = max(FADE_S, FADE_WINDOWS * window_s)
        self._past: deque[tuple[float, float, float]] = deque(maxlen=1000)
        self._seen_s = 0.0
        self._square = 0.0
        """Mean of half the squared difference, times the window: for a window twice as long the square is half."""

    def add(self, now_s: float, hz: float, window_s: float) -> None:
        """Record the rate measured over the last `window_s`."""
        past = self._past
        since_s = now_s - past[-1][0] if past else 0.0
        while len(past) > 1 and now_s - past[1][0] >= window_s:
            past.popleft()
        if past and now_s - past[0][0] >= window_s and past[0][2] >= _ALIKE * window_s:
            self._seen_s += since_s
            share = min(1.0, since_s / min(self._fade_s, self._seen_s)) if since_s else 0.0
            self._square += share * ((hz - past[0][1]) ** 2 / 2 * window_s - self._square)
        past.append((now_s, hz, window_s))

    def forget(self) -> None:
        """The next sample does not continue the previous ones."""
        self._past.clear()

    def error_hz(self, window_s: float) -> float | None:
        """Standard deviation of a rate that is measured over `window_s`; None until two windows have been compared."""
        return math.sqrt(self._square / window_s) if self._seen_s and window_s else None


class RateEstimator:
    """Converts the samples of one topic to a `RateFact`.

    expected_hz and silence_s determine only how long samples are kept and from when on the topic counts as silent, at
    most max(3 periods, silence_s) and at least least_silence_s (see `SilenceTimeout`); then the rate is 0.0. expected_hz
    0 is a latched topic, which is never silent.
    """

    def __init__(self, expected_hz: float, silence_s: float, least_silence_s: float = 0.0) -> None:
        self._expected_hz = expected_hz
        self._narrow_s = max(WINDOW_S, PERIODS / expected_hz) if expected_hz else WINDOW_S
        wide_s = min(WIDE_MOST_S, WIDE_PERIODS / expected_hz) if expected_hz else 0.0
        self._wide_s = max(WIDE_S, wide_s, self._narrow_s)
        self._spread = RateUncertainty(self._narrow_s)
        self._counted_over_s = max(WINDOW_S, COUNTED / expected_hz) if expected_hz else WINDOW_S
        self._silence = (
            SilenceTimeout(expected_hz, max(3.0 / expected_hz, silence_s), least_silence_s) if expected_hz else None
        )
        self._tracks: dict[bytes | None, PublisherStats] = {}
        self._sorter: PublisherDemux | None = None
        self._slow_s = 0.0
        """How long a publisher may be without a rate before it is a slow one; see `_sum`."""
        self._last_look_s: float | None = None
        self._last_s: float | None = None
        self._quiet_s = 0.0
        self._paused_s = 0.0
        self._held: tuple[float, float] | None = None
        self._restarts = PublisherRestarts(expected_hz)
        self._samples = 0
        self._uneven = False
        self.sample_bytes: float | None = None

    def update(self, now_s: float, samples: Sequence[Sample], listening: Listening = ALONE) -> RateFact:
        """Process the samples since the last poll, oldest first. Called once per tick."""
        passed_s = self._listen(now_s, samples, listening)
        self._slow_s = SLOW * gone_after_s(self._mean_hz(listening)) + listening.closed_s
        if samples:
            if samples[0].sequence is None and not listening.complete and passed_s > LATE_S:
                self.hold()  # while PHM did not run, samples were overwritten in the queue
            self._take(now_s, samples, listening)
        self._drop_gone(now_s, listening)
        self._restarts.settle(now_s, listening.closed_s, mixed=self.mixed(now_s))
        silent = self._silence is not None and self._last_s is not None and self._quiet_s > self._silence.limit_s
        if silent:
            self.forget()
        return self._fact(now_s, listening, silent)

    def missing_s(self, samples: Sequence[Sample], listening: Listening) -> float:
        """For how long a publisher published nothing between the last samples and these, the first ones after a pause in the
        subscription; 0.0 if as much as before. Infinite if several cannot be distinguished."""
        if listening.several and samples[0].writer is None:
            return math.inf
        hz = self._mean_hz(listening)
        tracks = ((self._tracks.get(sample.writer), sample) for sample in samples)
        return max((track.missing_s(sample, hz) for track, sample in tracks if track is not None), default=0.0)

    @property
    def measured(self) -> bool:
        """Whether the rate is known without the one from before `hold`."""
        return self._hz() is not None

    @property
    def span_s(self) -> float:
        """Publication time covered by the window, in seconds."""
        return max((track.span_s for track in self._tracks.values()), default=0.0)

    def mixed(self, now_s: float) -> bool:
        """Whether the sequence numbers of an apparent single publisher must be those of several."""
        return any(track.mixed(now_s) for track in self._tracks.values())

    def hold(self) -> None:
        """The next sample does not continue the previous ones, without a fault of the publisher: keep the rate."""
        hz = self._hz()
        held = self._held if hz is None else (hz, self.span_s)
        self.forget()
        self._held = held

    def forget(self) -> None:
        """Restart the measurement."""
        self._held = None
        self._spread.forget()
        for track in self._tracks.values():
            track.forget()

    # ---- input

    def _listen(self, now_s: float, samples: Sequence[Sample], listening: Listening) -> float:
        """Count the time without a sample in which one would have been received. Returns the time since the last poll."""
        passed_s = now_s - self._last_look_s if self._last_look_s is not None else 0.0
        self._last_look_s = now_s
        if not samples and listening.on:
            longest_s = max(self._paused_s, passed_s)
            # Only the longest of the pauses until now is shortened.
            self._quiet_s += _listened_s(passed_s) - _cut_s(longest_s) + _cut_s(self._paused_s)
            self._paused_s = longest_s
        return passed_s

    def _take(self, now_s: float, samples: Sequence[Sample], listening: Listening) -> None:
        before_s, self._last_s = self._last_s, now_s
        if listening.several and samples[0].writer is None and samples[0].sequence is not None:
            if self._sorter is None:
                self._sorter = PublisherDemux(self._counted_over_s)
                self._hand_over()
            samples = self._sorter.sort(samples, listening.publishers, complete=listening.complete)
        elif self._sorter is not None:
            self._take_back()
        if self._silence is not None and self._quiet_s > self._silence.most_s and self._published(samples, listening):
            self._silence.disproved(self._quiet_s, now_s)
        steady = True
        for sample in samples:
            steady = self._add(sample) and steady
        if self._silence is not None and before_s is not None and steady:
            self._silence.ended(self._quiet_s, now_s)
        self._quiet_s = self._paused_s = 0.0

    def _published(self, samples: Sequence[Sample], listening: Listening) -> bool:
        """Whether these, the first ones after a silence, show that a publisher of large samples has published on meanwhile."""
        if (self.sample_bytes or 0.0) <= PACKET_BYTES:
            return False
        hz = self._mean_hz(listening)
        tracks = ((self._tracks.get(sample.writer), sample) for sample in samples)
        return any(track is not None and track.published(sample, hz) for track, sample in tracks)

    def _hand_over(self) -> None:
        """Pass the former single publisher to the sorter: another one may replace it."""
        assert self._sorter is not None
        if (alone := self._tracks.pop(None, None)) is not None and alone.last is not None:
            self._tracks[self._sorter.adopt(alone.last, alone.hz)] = alone

    def _take_back(self) -> None:
        """One publisher remains: the one received last."""
        newest = max(self._tracks.values(), key=lambda track: track.at_s, default=None)
        self._sorter = None
        self._tracks.clear()
        if newest is not None:
            self._tracks[None] = newest

    def _add(self, sample: Sample) -> bool:
        """Process one sample. False if it does not continue the samples of its publisher."""
        track = self._tracks.get(sample.writer)
        new = track is None
        if track is None:
            track = self._tracks[sample.writer] = PublisherStats(self._narrow_s)
            self._restarts.back(sample.writer)
        if self.sample_bytes is None:
            self.sample_bytes = float(sample.size)
        self.sample_bytes += _SHARE * (sample.size - self.sample_bytes)
        track.window_s = self._wide_s if self._uneven else self._narrow_s
        last, hz = track.last, track.hz
        self._samples += not self._again(sample, last)
        self._restarts.receive(sample, last)
        continues = track.add(sample)
        if track.turned:
            self._spread.forget()  # a change of the rate is not jitter
        if track.fell and last is not None:
            self._restarts.numbers_fell(last, hz)
        return continues and not new

    def _again(self, sample: Sample, last: Sample | None) -> bool:
        """Whether it is the message that a latched topic keeps, received again by a new subscription."""
        if self._silence is not None or last is None:
            return False
        return (last.sequence, last.source_ns) == (sample.sequence, sample.source_ns)

    def _drop_gone(self, now_s: float, listening: Listening) -> None:
        """Forget publishers that fell silent while another continues; one that began since has replaced one."""
        if len(self._tracks) < 2 or self._last_s is None:
            return
        sure = self._sorter is None or not self._sorter.unreliable(listening.publishers, now_s)
        most = 1 + NEW_S * self._expected_hz
        for writer, track in list(self._tracks.items()):
            if not listening.several and any(other.takes_place(track, most) for other in self._tracks.values()):
                gone_s = GONE_S  # a restarted node, of which discovery still lists both publishers
            elif track.hz is None and len(self._tracks) <= listening.publishers:
                continue  # as many as are listed: it may be a slow one, whose next message is not due yet
            else:
                gone_s = gone_after_s(self._mean_hz(listening) if track.hz is None else track.hz)
            if self._last_s - track.at_s <= gone_s + listening.closed_s:
                continue
            del self._tracks[writer]
            if sure:
                self._restarts.gone(writer, track, list(self._tracks.values()))

    def _mean_hz(self, listening: Listening) -> float:
        """The expected rate of one publisher."""
        return self._expected_hz / max(1, listening.publishers)

    # ---- report

    def _fact(self, now_s: float, listening: Listening, silent: bool) -> RateFact:
        problem = listening.problem or ("" if silent else self._ambiguous(now_s, listening.publishers))
        hz, window_s = self._hz(), self.span_s
        if hz is not None:
            self._held = None  # it would be an old one when this rate ends
        elif self._held is not None:
            hz, window_s = self._held
        if problem:
            hz = None
        elif silent:
            hz = 0.0
        error_hz = self._error_hz(now_s, hz, window_s)
        newest = max(self._tracks.values(), key=lambda track: track.at_s, default=None)
        return RateFact(
            _rounded(hz),
            None if self._last_s is None else round(now_s - self._last_s, 3),
            round(window_s, 3),
            self._samples,
            problem,
            None if self._silence is None else round(self._silence.limit_s + listening.closed_s, 3),
            _rounded(newest.jitter_s if newest is not None and not listening.several else None),
            _rounded(self._age_s(newest, now_s)),
            listening.publishers,
            listening.matched,
            self._restarts.count,
            _rounded(self.sample_bytes),
            _rounded(error_hz),
            _rounded(newest.changed_s if newest is not None and hz and len(self._tracks) == 1 else None),
        )

    def _error_hz(self, now_s: float, hz: float | None, window_s: float) -> float | None:
        if not hz:
            return None
        self._spread.add(now_s, hz, window_s)
        self._uneven = (self._spread.error_hz(self._narrow_s) or 0.0) > UNEVEN * self._expected_hz
        return self._spread.error_hz(window_s)

    def _sum(self) -> float | None:
        """Rate of all publishers together; None while that of one is unknown that is not known to be slow."""
        now_s = self._last_look_s or 0.0
        if any(track.hz is None and now_s - track.began_window_s <= self._slow_s for track in self._tracks.values()):
            return None
        known = [track.hz for track in self._tracks.values() if track.hz is not None]
        return sum(known) if known else None

    def _hz(self) -> float | None:
        counted_hz = None if self._sorter is None else self._sorter.counted_hz
        return self._sum() if counted_hz is None else counted_hz

    def _ambiguous(self, now_s: float, publishers: int) -> str:
        sorter = self._sorter
        if sorter is None or sorter.counted_hz is not None or not sorter.unreliable(publishers, now_s):
            return ""
        return f"ambiguous: {publishers} publishers, whose sequence numbers cannot be distinguished"

    def _age_s(self, newest: PublisherStats | None, now_s: float) -> float | None:
        if newest is None:
            return None
        return newest.age_s(now_s) if self._silence is not None else newest.clock_age_s(now_s)


def _listened_s(passed_s: float) -> float:
    """The part of the time between two polls that counts as silence."""
    return passed_s if passed_s <= LATE_S else passed_s / 2


def _cut_s(longest_s: float) -> float:
    """The part of the longest time between two polls in which PHM was suspended, which does not count as silence."""
    return max(0.0, (longest_s - STALL_S) / 2)


def _rounded(number: float | None) -> float | None:
    return None if number is None else round(number, 6)
