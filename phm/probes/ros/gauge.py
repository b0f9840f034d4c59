"""The gauge of one topic: a reader of its publishers' type, and the meter that its samples go into."""

from __future__ import annotations

from typing import Any

from phm.probes.ros.message_types import UnknownType
from phm.probes.ros.meter import Meter
from phm.probes.ros.protocol import WantedTopic
from phm.probes.ros.reader import Reader
from phm.ros_facts import RateFact


class Gauge:
    """Follows the publishers of one topic with a reader of their type."""

    def __init__(self, node: Any, topic: WantedTopic) -> None:
        assert topic.rate_hz
        self._node = node
        self._name = topic.name
        self._meter = Meter(topic.rate_hz, topic.silence_s)
        self._reader: Any = None
        self._type = ""
        self._problem = ""

    def look(self, now_s: float, publishers: tuple[Any, ...]) -> RateFact:
        types = sorted({publisher.type for publisher in publishers})
        if types and self._type not in types:
            self._open(types[0], deep=False)
        if self._reader is not None:
            self._take(now_s)
        problem = self._problem
        if len(types) > 1:
            problem = f"ambiguous: published as {' and as '.join(types)}"
        return self._meter.fact(now_s, len({publisher.node for publisher in publishers}), problem)

    def _take(self, now_s: float) -> None:
        samples = self._reader.take(now_s)
        if samples and samples[0].sequence is None and self._reader.needs_depth:
            # This middleware does not number its samples: count them all instead.
            self._open(self._type, deep=True)
            return
        for sample in samples:
            self._meter.add(sample)

    def _open(self, type_name: str, *, deep: bool) -> None:
        if self._reader is not None:
            self._reader.close()
        self._reader, self._type, self._problem = None, type_name, ""
        try:
            self._reader = Reader(self._node, self._name, type_name, deep=deep)
        except UnknownType as error:
            self._problem = str(error)
