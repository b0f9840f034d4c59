"""Endpoints as the ROS child process reports them, without ROS."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from phm.facts import EndpointFact
from phm.probes.ros import graph

PUBLISHER, SUBSCRIPTION = "PUBLISHER", "SUBSCRIPTION"


def info(side: str, **qos: Any) -> Any:
    """rclpy's TopicEndpointInfo of a latched topic with a deadline."""
    profile = {
        "reliability": SimpleNamespace(name="RELIABLE"),
        "durability": SimpleNamespace(name="TRANSIENT_LOCAL"),
        "liveliness": SimpleNamespace(name="AUTOMATIC"),
        "deadline": SimpleNamespace(nanoseconds=500_000_000),
        "liveliness_lease_duration": SimpleNamespace(nanoseconds=0),
    }
    return SimpleNamespace(
        node_name="map_server",
        node_namespace="/",
        topic_type="nav_msgs/msg/OccupancyGrid",
        endpoint_type=SimpleNamespace(name=side),
        qos_profile=SimpleNamespace(**profile),
    )


def test_where_qos_matters_every_policy_of_both_sides_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with DDS, which does not connect some pairs."""
    monkeypatch.setattr(graph, "quality_matters", lambda: True)
    full = EndpointFact(
        "/map_server", "nav_msgs/msg/OccupancyGrid", "reliable", "transient_local", 0.5, "automatic", None
    )
    assert graph.endpoints([info(PUBLISHER)]) == graph.endpoints([info(SUBSCRIPTION)]) == (full,)


def test_where_all_connect_a_latched_topic_is_still_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Zenoh connects all pairs, and a publisher keeps its messages there, too. Without the policies of the subscriptions there is
    no mismatch."""
    monkeypatch.setattr(graph, "quality_matters", lambda: False)
    plain = EndpointFact("/map_server", "nav_msgs/msg/OccupancyGrid")
    (publisher,) = graph.endpoints([info(PUBLISHER)])
    assert (publisher.reliability, publisher.durability, publisher.deadline_s) == ("reliable", "transient_local", None)
    assert graph.endpoints([info(SUBSCRIPTION)]) == (plain,)
