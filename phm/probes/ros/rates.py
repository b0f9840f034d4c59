"""Topic rates without reading the messages, from the sequence numbers that the publisher itself counts.

A reader with a queue of one, never put in an executor, lets the middleware overwrite sample after sample
in C++; Python looks at one of them each tick. Its sequence number says how many were published since the
last look, its source timestamp how much time passed between those two publications. So the rate is exact
however few samples are looked at, and what Python spends does not grow with the rate.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from phm.facts import RateFact
from phm.probes.ros.message_types import UnknownType, load_type

WINDOW_S = 3.0
"""A rate is measured over this time, or three expected periods where that is longer."""
SHORTEST_S = 1.0
"""Below this span of publication time the jitter of two stamps is too large a share of it."""
JUMP_S = 1.0
"""Stamps that disagree with the time between two looks by more than this tell a clock that was set."""
FALLS, FALLS_S = 3, 10.0
"""A number that falls is a restarted publisher; this many falls within this time are two publishers."""
DEEP = 1000
"""Queue for middleware without sequence numbers: 4 kHz at four looks a second."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One look. sequence: None where the middleware has none. source_ns: publisher's clock. at_s: ours, monotonic."""

    sequence: int | None
    source_ns: int
    at_s: float
    writer: bytes | None = None
    """Identity of the publisher, where the middleware tells it (from Kilted on)."""


class Track:
    """The samples of one publisher within the window.

    Invariant: sequence numbers and source times of what is kept rise strictly; whatever breaks that
    (restart, a clock that was set) starts the window anew.
    """

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._kept: deque[Sample] = deque(maxlen=10_000)
        self._counted = 0
        self._falls: deque[float] = deque(maxlen=FALLS)
        self.last_s: float | None = None
        self.seen = 0

    def add(self, sample: Sample) -> None:
        if sample.sequence is None:
            # No sequence numbers: the deep queue hands over every sample, so counting gives them.
            self._counted += 1
            sample = Sample(self._counted, sample.source_ns, sample.at_s, sample.writer)
        if self._kept and not self._continues(self._kept[-1], sample):
            self._kept.clear()
        self._kept.append(sample)
        while sample.at_s - self._kept[0].at_s > self._window_s and len(self._kept) > 2:
            self._kept.popleft()
        self.last_s = sample.at_s
        self.seen += 1

    def _continues(self, last: Sample, sample: Sample) -> bool:
        assert last.sequence is not None and sample.sequence is not None
        if sample.sequence <= last.sequence:
            self._falls.append(sample.at_s)
            return False
        published_s = (sample.source_ns - last.source_ns) / 1e9
        return published_s > 0 and abs(published_s - (sample.at_s - last.at_s)) <= max(JUMP_S, self._window_s / 3)

    def forget(self) -> None:
        """Begin anew: what comes after a silence must not be averaged with it."""
        self._kept.clear()

    def mixed(self, now_s: float) -> bool:
        """Whether these numbers can only be those of several publishers."""
        return len(self._falls) == FALLS and now_s - self._falls[0] <= FALLS_S

    @property
    def span_s(self) -> float:
        return (self._kept[-1].source_ns - self._kept[0].source_ns) / 1e9 if self._kept else 0.0

    @property
    def hz(self) -> float | None:
        if self.span_s < SHORTEST_S:
            return None
        first, last = self._kept[0].sequence, self._kept[-1].sequence
        assert first is not None and last is not None
        return (last - first) / self.span_s


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


class Reader:
    """The raw subscription of one topic. Opened on a type, closed by `close`; never raises for a strange type."""

    def __init__(self, node: Any, topic: str, type_name: str, *, deep: bool = False) -> None:
        """Raises UnknownType."""
        from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

        self.type_name = type_name
        self._node = node
        self._deep = deep
        message = load_type(type_name)
        # Best effort and volatile match every publisher; a queue of one keeps the middleware's copy small.
        qos = QoSProfile(
            history=QoSHistoryPolicy.KEEP_LAST,
            depth=DEEP if deep else 1,
            reliability=QoSReliabilityPolicy.BEST_EFFORT,
            durability=QoSDurabilityPolicy.VOLATILE,
        )
        try:
            self._subscription = node.create_subscription(message, topic, _never_called, qos, raw=True)
        except Exception as error:  # rclpy raises its own and pybind's kinds for broken type support
            raise UnknownType(f"type unknown: {type_name} cannot be subscribed to ({error})") from error

    def take(self, now_s: float) -> list[Sample]:
        """What arrived since the last look: at most one sample, or all of them in a deep queue."""
        samples = []
        handle = self._subscription.handle
        with handle:
            for _ in range(DEEP if self._deep else 1):
                taken = handle.take_message(self._subscription.msg_type, True)
                if taken is None:
                    break
                samples.append(_sample(taken[1], now_s))
        return samples

    @property
    def needs_depth(self) -> bool:
        return not self._deep

    def close(self) -> None:
        self._node.destroy_subscription(self._subscription)


def _never_called(_: object) -> None:
    """rclpy wants a callback; without an executor nobody calls it."""


def _sample(info: Any, now_s: float) -> Sample:
    """Humble's information has no sequence number, Jazzy's no writer."""
    gid = info.get("publisher_gid")
    if isinstance(gid, dict):
        gid = gid.get("data")
    writer = bytes(gid) if gid else None
    return Sample(info.get("publication_sequence_number"), int(info["source_timestamp"]), now_s, writer)
