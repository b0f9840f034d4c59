"""The rate of one topic: a reader that follows its publishers, and the estimator that processes its samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from phm.facts.ros import DataFact, EndpointFact, RateFact
from phm.probes.ros.data.data_monitor import DataMonitor
from phm.probes.ros.message_types import UnknownType
from phm.probes.ros.protocol import WantedTopic
from phm.probes.ros.rates.estimator import Listening, RateEstimator
from phm.probes.ros.rates.publisher_stats import Sample
from phm.probes.ros.rates.publishers import DEPTH_MOST, PER_PUBLISHER
from phm.probes.ros.reader import Reader, SubscriptionQos

LARGE_BPS = 1e6
"""A topic with more bytes per second is subscribed only in windows: the middleware copies all samples to PHM."""
SMALL_BPS = 0.8e6
PAUSE_S = 2.0
"""Time between two windows. A window ends with the first poll that finds a sample, or when the rate is measured within it."""
WHOLE = 0.9
"""The share of a pause without a publication from which nothing was published in it: publishers have jitter."""
WITHIN_S, WITHIN_PERIODS = 5.0, 3
"""A window in which the rate is measured ends after this time, or after these periods of each publisher if that is longer."""
MATCH_S = 3.0
"""A subscription not connected to a listed publisher for this long never will be; normally it takes 0.1 s."""
STALE_S = 25.0
"""Two publishers of one node are one that was restarted, until the lease of the older one (20 s by default) ends."""
MIXED_S = 60.0
"""How long mixed sequence numbers are sorted, regardless of discovery; then the normal method is tried again."""
COUNTED_POLLS = 4
"""Without sequence numbers, the queue has space for this many polls at the expected rate, so for up to this multiple of
the rate."""
TYPES = 3
"""Maximum number of types that are named."""
COUNTED, COUNTED_MOST = 10, 1000


class TopicMonitor:
    """Follows the publishers of one topic; their properties never cause an exception."""

    def __init__(self, node: Any, topic: WantedTopic, tick_s: float = 0.25) -> None:
        assert topic.rate_hz is not None
        self._node = node
        self._name = topic.name
        self._expected_hz = topic.rate_hz
        self._tick_s = tick_s
        self._silence_s = topic.silence_s
        self._estimator = RateEstimator(topic.rate_hz, topic.silence_s, topic.least_silence_s)
        self._data = DataMonitor(topic.data, topic.rate_hz) if topic.data is not None else None
        self._reader: Reader | None = None
        self._type = ""
        self._unknown = ""
        self._counted = False
        self._large = False
        self._resumed = False
        """Whether no sample was taken since the pause of a large topic."""
        self._within = False
        """Whether the rate is to be measured within this window, without the samples from before it."""
        self._partly = False
        """Whether less was published than before in the newest pause, but not nothing."""
        self._complete = False
        """Whether no sample was missed since the last one, as far as the queue shows."""
        self._open_at_s = -math.inf
        self._lonely_since_s: float | None = None
        self._twins_since_s: float | None = None
        self._mixed_at_s = -math.inf
        self._publishers: tuple[EndpointFact, ...] = ()
        self._requested_s: float | None = None
        """Since when the kept messages of a latched topic are requested; None: they have arrived."""

    def poll(self, now_s: float, publishers: tuple[EndpointFact, ...]) -> RateFact:
        """Called once per tick, with the publishers that discovery lists now."""
        several = self._several(now_s, publishers)
        self._request_again(now_s, publishers)
        listened = self._reader is not None
        self._follow(now_s, publishers, several)
        samples = self._take(now_s)
        self._drop_unkept(now_s, samples)
        if self._data is not None and self._reader is not None:
            pause_s = PAUSE_S if self._large else 0.0
            self._data.update(now_s, self._type, self._reader.messages, pause_s=pause_s, mixed=several)
        matched = self._reader.matched if self._reader is not None else None
        listening = Listening(
            publishers=len(publishers),
            several=several,
            on=listened,
            complete=self._complete,
            closed_s=PAUSE_S if self._large else 0.0,
            matched=matched,
            problem=self._problem(now_s, publishers, matched),
        )
        if samples and self._resumed:
            self._resume(samples, listening)
        fact = self._estimator.update(now_s, samples, listening)
        if samples:
            self._complete = True
            self._shut_window(now_s, fact)
        return fact

    @property
    def data(self) -> DataFact | None:
        """What the messages contain; None if they are not examined, or none was received yet."""
        return None if self._data is None else self._data.fact

    def _request_again(self, now_s: float, publishers: tuple[EndpointFact, ...]) -> None:
        """After a change of its publishers the message of a latched topic may be of one that is gone: a new subscription receives
        what the present ones keep."""
        before, self._publishers = self._publishers, publishers
        kept = any(map(_keeps, publishers)) or (before and all(map(_keeps, before)))
        if self._expected_hz or before == publishers or not kept:
            return
        self._close()
        self._open_at_s, self._requested_s = -math.inf, now_s

    def _drop_unkept(self, now_s: float, samples: Sequence[Sample]) -> None:
        """Forget the message if no present publisher has sent it again, then request it again."""
        wait_s = MATCH_S if all(map(_keeps, self._publishers)) else MATCH_S + self._silence_s
        if samples:
            self._requested_s = None
        elif self._requested_s is not None and now_s - self._requested_s > wait_s:
            self._estimator, self._requested_s = RateEstimator(self._expected_hz, self._silence_s), now_s

    def _take(self, now_s: float) -> list[Sample]:
        if self._reader is None:
            return []
        samples = self._reader.take(now_s)
        if samples and samples[0].sequence is None and not self._counted:
            # This middleware provides no sequence numbers: count all samples instead.
            self._counted = True
            self._close()
            return []
        self._complete = self._complete and len(samples) < self._reader.qos.depth
        return samples

    def _several(self, now_s: float, publishers: Sequence[EndpointFact]) -> bool:
        """Whether samples may be of more than one publisher. A restarted node is listed twice for a while."""
        if len(publishers) < 2:
            self._twins_since_s = None
        elif self._twins_since_s is None:
            self._twins_since_s = now_s
        if self._estimator.mixed(now_s):
            self._mixed_at_s = now_s
        twins = self._twins_since_s is not None and now_s - self._twins_since_s > STALE_S
        mixed = now_s - self._mixed_at_s < MIXED_S
        # An endpoint is listed a moment before its node's name: an empty name is not another name.
        return twins or mixed or len({publisher.node for publisher in publishers if publisher.node}) > 1

    def _follow(self, now_s: float, publishers: Sequence[EndpointFact], several: bool) -> None:
        """Open a suitable reader, unless it is the time between two windows."""
        types = sorted({publisher.type for publisher in publishers if publisher.type})
        if types and self._type not in types:
            self._close()
            self._type, self._unknown, self._open_at_s = types[0], "", -math.inf
        qos = SubscriptionQos(self._depth(publishers, several), self._latched(now_s, publishers))
        if self._reader is not None and publishers and self._reader.qos != qos:
            self._close()
        if self._reader is None and self._type and not self._unknown and now_s >= self._open_at_s:
            self._open(qos)

    def _depth(self, publishers: Sequence[EndpointFact], several: bool) -> int:
        if self._counted:
            polls = COUNTED_POLLS * self._tick_s * self._expected_hz * max(1, len(publishers))
            return min(COUNTED_MOST, max(COUNTED, math.ceil(polls)))
        if several or len(publishers) > 1:
            # Also for a restarted node: whether the older one is gone shows in all samples, not in the newest.
            return min(DEPTH_MOST, PER_PUBLISHER * max(2, len(publishers)))
        return 1

    def _latched(self, now_s: float, publishers: Sequence[EndpointFact]) -> bool:
        """Whether to subscribe for kept messages. Such a subscription does not receive publishers that keep none, so beside these it is
        open only until a kept message arrives, or for MATCH_S."""
        if self._expected_hz or not any(map(_keeps, publishers)):
            return False
        requests = self._requested_s is not None and now_s - self._requested_s <= MATCH_S
        return requests or all(map(_keeps, publishers))

    def _open(self, qos: SubscriptionQos) -> None:
        try:
            self._reader = Reader(self._node, self._name, self._type, qos, keep=self._data is not None)
        except UnknownType as error:
            self._unknown = str(error)
        # Without an expected rate the measured one is not compared with anything, so a wrong one does no harm.
        self._resumed = self._large and not self._counted and bool(self._expected_hz)
        self._within = self._counted
        if self._counted:
            self._estimator.hold()

    def _resume(self, samples: Sequence[Sample], listening: Listening) -> None:
        """The first samples after a pause.

        A publisher may publish only while it has a subscription. Discovery does not show whether it had one: those in its process
        and those that are not connected are listed too. So a pause in which nothing was published does not count. If less was
        published than before, the last other subscription may have ended, but not in two pauses in a row.
        """
        self._resumed = False
        missing_s = self._estimator.missing_s(samples, listening)
        before, self._partly = self._partly, 0.0 < missing_s < self._whole_s(listening.publishers)
        self._within = missing_s > 0.0 and not (before and self._partly)
        if self._within:
            self._estimator.hold()

    def _whole_s(self, publishers: int) -> float:
        """For how long nothing seems to be published if nothing is in a pause: a period less if one ends in it."""
        return WHOLE * (PAUSE_S - max(1, publishers) / self._expected_hz) if self._expected_hz else 0.0

    def _close(self) -> None:
        if self._reader is not None:
            self._reader.close()
        self._reader = self._lonely_since_s = None
        self._complete = False

    def _shut_window(self, now_s: float, fact: RateFact) -> None:
        """After a sample of a large topic: close the reader for a while."""
        hz = fact.hz or self._expected_hz
        self._large = (self._estimator.sample_bytes or 0.0) * hz > (SMALL_BPS if self._large else LARGE_BPS)
        if not self._large or self._measures(now_s, fact):
            return
        self._close()
        self._open_at_s = now_s + PAUSE_S

    def _measures(self, now_s: float, fact: RateFact) -> bool:
        """Whether this window stays open, because the rate is not measured yet. One that cannot be is forgotten."""
        if not self._within or self._estimator.measured:
            return False
        periods_s = WITHIN_PERIODS * max(1, fact.publishers) / self._expected_hz if self._expected_hz else 0.0
        if self._counted or (not fact.problem and now_s - self._open_at_s <= max(WITHIN_S, periods_s)):
            return True
        self._estimator.forget()
        return False

    def _problem(self, now_s: float, publishers: Sequence[EndpointFact], matched: int | None) -> str:
        """Why the rate cannot be measured, regardless of the samples; empty if it can."""
        types = sorted({publisher.type for publisher in publishers if publisher.type})
        if len(types) > 1:
            more = f" and {len(types) - TYPES} more" if len(types) > TYPES else ""
            return f"ambiguous: published as {' and as '.join(types[:TYPES])}{more}"
        if self._unknown:
            return self._unknown
        if matched != 0 or not publishers:
            self._lonely_since_s = None
        elif self._lonely_since_s is None:
            self._lonely_since_s = now_s
        if self._lonely_since_s is not None and now_s - self._lonely_since_s > MATCH_S:
            return "QoS mismatch: the middleware does not connect PHM with the publisher (another partition, or another definition of its type?)"
        return ""


def _keeps(publisher: EndpointFact) -> bool:
    """Whether it keeps its last message for later subscribers."""
    return (publisher.durability, publisher.reliability) == ("transient_local", "reliable")
