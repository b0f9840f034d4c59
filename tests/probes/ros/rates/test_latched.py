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
TOOL = "/a/tool"


def end(node: str) -> EndpointFact:
    """The publisher of a node, which keeps its last message; of `tool` it does not."""
    return EndpointFact(node, "std_msgs/msg/String", "reliable", "volatile" if node == TOOL else "transient_local")


class Bench:
    """A topic, its listed publishers, and the message that a living one keeps: each new latched subscription receives it once.

    every_s: period of a living publisher that keeps nothing, which only other subscriptions receive; 0: there is none.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s, self.kept, self.samples, self.every_s = 100.0, False, 0, 0.0
        bench = self

        class KeptReader:
            def __init__(self, node: Any, topic: str, type_name: str, qos: SubscriptionQos, *, keep: bool) -> None:
                self.qos, self.matched, self.messages = qos, None, ()
                self._new = True

            def take(self, now_s: float) -> list[Sample]:
                if not self.qos.latched:
                    sent = bench.every_s and now_s % bench.every_s == 0.0
                    return [Sample(int(now_s), int(now_s * 1e9), now_s)] if sent else []
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


def test_a_kept_message_is_received_beside_a_publisher_that_keeps_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tool that only advertises the topic: the message must not depend on who began first. It is forgotten with its publisher."""
    bench = Bench(monkeypatch)
    bench.kept = True
    assert all(bench.received("/a/one", TOOL))
    assert all(bench.received("/a/one"))
    assert all(bench.received("/a/one", TOOL))
    bench.kept = False
    assert not bench.received("/a/two", TOOL, seconds=10.0)[-1]
    bench.kept = True
    assert bench.received("/a/two", TOOL, seconds=5.0)[-1]


def test_a_publisher_that_keeps_none_is_received_beside_one_that_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the tool publishes: a subscription for kept messages would never receive it."""
    bench = Bench(monkeypatch)
    bench.every_s = 2.0
    assert bench.received("/a/one", TOOL, seconds=6.0)[-1]
    assert all(bench.received(TOOL, seconds=10.0))
    assert all(bench.received("/a/one", TOOL, seconds=10.0))
