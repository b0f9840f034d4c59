"""PHM sees applications in other ROS environments than the default; all of them: `python -m sitl.bench.ros_environments`."""

from __future__ import annotations

import os

from phm.facts import RosFact
from tests.fakes.ros_bench import Bench, seen, until

TOPIC = "/agent_1/topic_1"
TOPICS = [{"name": TOPIC, "rate": 10}]
NODES = {"/agent_1/node_1", "/agent_1/node_2"}
PUBLISH = ("--publish", "topic_1:10", "--no-beacon")
OWN_MEMORY = (
    "unshare",
    *(() if os.geteuid() == 0 else ("--map-root-user",)),
    "--mount",
    *("sh", "-c", 'mount -t tmpfs tmpfs /dev/shm && exec "$@"', "sh"),
)
"""Starts a program with its own /dev/shm, as in another container."""


def all_seen(fact: RosFact) -> bool:
    """Both nodes, and data of the topic."""
    topic = fact.topics.get(TOPIC)
    return fact.nodes.keys() >= NODES and topic is not None and topic.rate is not None and bool(topic.rate.hz)


def test_localhost_works_without_shared_memory(bench: Bench) -> None:
    """Two containers on the host's network: rmw_fastrtps alone would find the nodes and lose their names and data."""
    bench.node("node_1", *PUBLISH, before=OWN_MEMORY)
    bench.node("node_2", "--no-beacon", before=OWN_MEMORY)
    assert bench.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert seen(bench.probe(TOPICS), all_seen, "nodes and data without a shared /dev/shm")


def test_the_clients_of_a_discovery_server_are_seen(bench: Bench) -> None:
    """Both names, though PHM subscribes to one topic alone."""
    bench.environ["ROS_DISCOVERY_SERVER"] = bench.discovery_server()
    bench.node("node_1", *PUBLISH, before=OWN_MEMORY)
    bench.node("node_2", "--no-beacon", before=OWN_MEMORY)
    assert seen(bench.probe(TOPICS), all_seen, "the clients of the discovery server")


def test_a_peer_that_cannot_be_resolved_yet_hides_no_other_node(bench: Bench) -> None:
    """The container of that name may not run; rmw_fastrtps itself creates no participant then."""
    bench.node("node_1", *PUBLISH)
    bench.node("node_2", "--no-beacon")
    bench.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", ROS_STATIC_PEERS="127.0.0.1;no.such.host.invalid")
    assert seen(bench.probe(TOPICS), all_seen, "nodes and data, without the second peer")
    until(lambda: [note for note in bench.notes if "no.such.host.invalid" in note], "the log line")
