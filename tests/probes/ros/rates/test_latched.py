"""A latched topic whose publishers change: only a message that one of the present ones keeps counts."""

from __future__ import annotations

from typing import Any

import pytest

from phm.facts.ros import EndpointFact
from phm.probes.ros.protocol import WantedTopic
from phm.probes.ros.rates import topic_monitor
from phm.probes.ros.rates.publisher_stats import Sample
from phm.probes.ros.rates.topic_monitor import TopicMonitor
from phm.probes.ros.reader import SubscriptionQos

TICK_S = 0.25


def end(node: str) -> EndpointFact:
    return EndpointFact(node, "std_msgs/msg/String", "reliable", "transient_local")


class Bench:
    """A topic, its listed publishers, and the message that a living one keeps: each new subscription receives it once."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s, self.kept, self.samples = 100.0, False, 0
        bench = self

        class KeptReader:
            def __init__(self, node: Any, topic: str, type_name: str, qos: SubscriptionQos, *, keep: bool) -> None:
                self.qos, self.matched, self.messages = qos, None, ()
                self._new = True

            def take(self, now_s: float) -> list[Sample]:
                found = [Sample(1, 10, now_s)] if self._new and bench.kept else []
                self._new = self._new and not found
                return found

            def close(self) -> None:
                pass

        monkeypatch.setattr(topic_monitor, "Reader", KeptReader)
        self.monitor = TopicMonitor(None, WantedTopic("/a/map", 0.0))

    def received(self, *publishers: str, seconds: float = 5.0) -> list[bool]:
        """Whether a message counts, at each tick while these are listed."""
        found = []
        for _ in range(int(seconds / TICK_S)):
            self.now_s += TICK_S
            fact = self.monitor.poll(self.now_s, tuple(map(end, publishers)))
            found.append(fact.silent_s is not None)
            self.samples = fact.samples
        return found


def test_the_message_of_a_publisher_that_is_gone_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its node was started again, and has not published yet."""
    bench = Bench(monkeypatch)
    bench.kept = True
    assert all(bench.received("/a/one"))
    bench.kept = False
    assert not bench.received()[-1]
    assert not any(bench.received("/a/one"))
    bench.kept = True
    assert bench.received("/a/one")[-1]


def test_a_killed_publisher_that_is_still_listed_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until its lease ends, it is listed beside the new one."""
    bench = Bench(monkeypatch)
    bench.kept = True
    bench.received("/a/one")
    bench.kept = False
    assert not bench.received("/a/one", "/a/one")[-1]


def test_a_further_publisher_does_not_make_the_message_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one still keeps it, and it arrives again."""
    bench = Bench(monkeypatch)
    bench.kept = True
    bench.received("/a/one")
    assert all(bench.received("/a/one", "/a/two"))
    assert all(bench.received("/a/two"))


def test_a_message_that_is_received_again_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Discovery lists the publisher before the name of its node, and PHM subscribes again when that is known."""
    bench = Bench(monkeypatch)
    bench.kept = True
    bench.received("")
    bench.received("/a/one")
    assert bench.samples == 1
