"""The nodes that `phm init` writes: those of the real graph."""

from __future__ import annotations

import pytest

from phm.setup import ros_nodes
from tests.fakes.ros_bench import Bench, until


def test_nodes_of_the_domain_are_listed_without_our_own(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the domain of the application alone."""
    bench.node("node_1", "--publish", "topic_1:1")
    monkeypatch.setattr(ros_nodes, "LIMIT_S", 60.0)
    names = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")
    environment = {name: bench.environ[name] for name in names}
    until(lambda: ros_nodes.nodes(environment) == ("/agent_1/node_1",), "the only node")
