"""Topic rates without reading the messages, from the sequence numbers that the publisher itself counts.

A reader with a queue of one, never put in an executor, lets the middleware overwrite sample after sample
in C++; Python looks at one of them each tick. Its sequence number says how many were published since the
last look, its source timestamp how much time passed between those two publications. So the rate is exact
however few samples are looked at, and what Python spends does not grow with the rate.
"""

from __future__ import annotations

from phm.facts import RateFact
from phm.probes.ros.track import Sample, Track

WINDOW_S = 3.0
"""A rate is measured over this time, or three expected periods where that is longer."""


class Meter:
    """Judges nothing: turns samples of one topic into a `RateFact`.

    expected_hz (> 0) and silence_s only set for how long samples are kept and from when on the topic
    counts as silent, max(3 periods, silence_s); then the rate is 0.0.
    """

    def __init__(self, expected_hz: float, silence_s: float) -> None:
        self._limit_s = max(3.0 / expected_hz, silence_s)
        self._window_s = max(WINDOW_S, 3.0 / expected_hz)
        self._tracks: dict[bytes | None, Track] = {}

    def add(self, sample: Sample) -> None:
        track = self._tracks.get(sample.writer)
        if track is None:
            track = self._tracks[sample.writer] = Track(self._window_s)
        track.add(sample)

    def fact(self, now_s: float, publishers: int, problem: str = "") -> RateFact:
        """publishers: how many different nodes publish the topic now, according to discovery."""
        self._drop_old(now_s)
        heard = [track.last_s for track in self._tracks.values() if track.last_s is not None]
        silent_s = round(now_s - max(heard), 3) if heard else None
        samples = sum(track.seen for track in self._tracks.values())
        if problem:
            return RateFact(None, silent_s, samples=samples, problem=problem)
        if silent_s is not None and silent_s > self._limit_s:
            for track in self._tracks.values():
                track.forget()
            return RateFact(0.0, silent_s, samples=samples)
        several = self._several(now_s, publishers)
        if several:
            return RateFact(None, silent_s, samples=samples, problem=several)
        rates = [track.hz for track in self._tracks.values()]
        known = [hz for hz in rates if hz is not None]
        hz = round(sum(known), 4) if known and len(known) == len(rates) else None
        span_s = max((track.span_s for track in self._tracks.values()), default=0.0)
        return RateFact(hz, silent_s, round(span_s, 3), samples)

    def _several(self, now_s: float, publishers: int) -> str:
        if any(track.mixed(now_s) for track in self._tracks.values()):
            return "ambiguous: the sequence numbers of several publishers are mixed"
        if publishers > 1 and None in self._tracks:
            return f"ambiguous: {publishers} publishers"
        return ""

    def _drop_old(self, now_s: float) -> None:
        """Forget publishers that fell silent while another goes on (a node that was restarted)."""
        for writer, track in list(self._tracks.items()):
            if len(self._tracks) > 1 and track.last_s is not None and now_s - track.last_s > self._limit_s:
                del self._tracks[writer]
