"""Which topics are kept when there are more than fit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from phm.facts import NameFact
from phm.probes.ros import graph
from phm.probes.ros.unconfigured_topics import (
    CLOCK,
    MAX_COUNTED,
    MAX_NODES,
    MAX_READS,
    MAX_TOPICS,
    POLL_S,
    UnconfiguredTopics,
)


class Domain:
    """In place of a ROS node: topics with the names of the nodes on both sides."""

    def __init__(self, topics: dict[str, tuple[list[str], list[str]]]) -> None:
        self._topics = topics

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [(name, []) for name in self._topics]

    def count_publishers(self, topic: str) -> int:
        return len(self._topics[topic][0])

    def count_subscribers(self, topic: str) -> int:
        return len(self._topics[topic][1])

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return [_info(node) for node in self._topics[topic][0]]

    def get_subscriptions_info_by_topic(self, topic: str) -> list[Any]:
        return [_info(node) for node in self._topics[topic][1]]


def _info(node: str) -> Any:
    side = SimpleNamespace(name="SUBSCRIPTION")
    return SimpleNamespace(node_name=node, node_namespace="/", topic_type="", endpoint_type=side, qos_profile=None)


@pytest.mark.parametrize(
    ("number", "node"),
    [(10, "a"), (MAX_TOPICS, "a"), (MAX_COUNTED, "a"), (MAX_TOPICS - 1, "long" * 60)],
    ids=["few", "too many", "too many to count", "too long"],
)
def test_the_clock_is_kept_whatever_else_there_is(number: int, node: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It shows that time is simulated. Topics used on one side only, as those of an autopilot, displace others."""
    monkeypatch.setattr(graph, "quality_matters", lambda: False)
    readers = [f"{node}{reader}" for reader in range(MAX_NODES)]
    others: dict[str, tuple[list[str], list[str]]] = {f"/a/{topic}": ([], readers) for topic in range(number)}
    topics = UnconfiguredTopics(Domain({**others, CLOCK: (["simulator"], readers)}), ())
    for poll in range(10):
        topics.observe(2 * POLL_S * poll)
    assert topics.names[CLOCK] == NameFact(("/simulator",), tuple(f"/{reader}" for reader in readers))
    assert len(topics.names) <= min(number + 1, MAX_TOPICS)


class Strict(Domain):
    """Raises for a name that ROS does not allow, as rclpy does."""

    def count_publishers(self, topic: str) -> int:
        if "-" in topic:
            raise ValueError("Invalid topic name")
        return super().count_publishers(topic)


def test_a_name_that_ros_does_not_allow_hides_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plain DDS participant can announce `rt/arm-state`, or worse. It is reported as long as it is there."""
    monkeypatch.setattr(graph, "quality_matters", lambda: False)
    topics = UnconfiguredTopics(Strict({"/a": (["n"], []), "/arm-state\n": (["n"], []), "/z": (["n"], [])}), ())
    for poll in range(2):
        topics.observe(2 * POLL_S * poll)
        assert topics.problem.endswith(r"/arm-state\n")
    assert list(topics.names) == ["/a", "/z"]


def test_topics_without_names_do_not_starve_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """PX4's agent never gets a name, so its topics are read again and again; those whose users change are read before them."""
    monkeypatch.setattr(graph, "quality_matters", lambda: False)
    nameless = "_NODE_NAME_UNKNOWN_"
    px4: dict[str, tuple[list[str], list[str]]] = {f"/fmu/{topic}": ([nameless], []) for topic in range(MAX_READS + 10)}
    late, users = [nameless], ["a"]
    topics = UnconfiguredTopics(Domain({**px4, "/late": (["n"], late), "/z": (["n"], users)}), ())
    for poll in range(3):
        topics.observe(2 * POLL_S * (poll + 1))
    late[:] = ["b"]
    users.append("b")
    topics.observe(2 * POLL_S * 4)
    assert topics.names["/z"] == NameFact(("/n",), ("/a", "/b"))
    topics.observe(2 * POLL_S * 5)
    assert topics.names["/late"] == NameFact(("/n",), ("/b",))
