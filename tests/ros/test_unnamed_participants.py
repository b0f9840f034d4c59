"""Entities that PHM's own participant has lost are found with a new one, and raise no alarm meanwhile."""

from __future__ import annotations

import signal
from itertools import pairwise

from phm.facts import EndpointFact, RateFact, RosFact, TopicFact
from phm.probes.ros.renewal_pace import REST_S
from phm.probes.ros.unnamed_participants import TRIES, UNNAMED_S, UnnamedParticipants
from tests.fakes.ros_bench import Bench, seen

STRING = "std_msgs/msg/String"
TOPIC, NODE = "/agent_1/topic_1", "/agent_1/node_1"
NAMED = {TOPIC: TopicFact((EndpointFact(NODE, STRING),))}
NAMELESS = {TOPIC: TopicFact((EndpointFact("", STRING),))}
FLOWING = RateFact(10.0, 0.1)


def test_a_node_that_lost_its_lease_is_listed_again_by_name(bench: Bench) -> None:
    """Its endpoints return without the node name, which no later announcement contains: PHM opens a new participant."""
    node = bench.node("node_1", "--publish", "topic_1:10")
    probe = bench.probe([{"name": TOPIC, "rate": 10}], nodes=[{"name": NODE}])
    seen(probe, lambda fact: NODE in fact.nodes and fact.topics[TOPIC].publishers and NODE in fact.beacons, "the node")
    node.send_signal(signal.SIGSTOP)
    seen(probe, lambda fact: not fact.topics[TOPIC].publishers and not fact.nodes, "the end of its lease of 1 s")
    node.send_signal(signal.SIGCONT)

    def listed(fact: RosFact) -> bool:
        return NODE in fact.nodes and [end.node for end in fact.topics[TOPIC].publishers] == [NODE]

    # After one attempt that came too early, the next is 60 s later.
    seen(probe, listed, "the node by its name", limit_s=150.0)
    assert probe.restarts == 0


def test_lost_names_are_looked_up_with_a_new_participant() -> None:
    """After some seconds, since an endpoint arrives a moment before its name; and not repeatedly when that does not
    help.
    """
    unnamed = UnnamedParticipants()
    assert unnamed.observe(NAMED, -UNNAMED_S) == unnamed.observe(NAMED, 0.0) == ()
    assert unnamed.observe(NAMELESS, 1.0) == ()
    assert unnamed.observe(NAMELESS, 0.9 + UNNAMED_S) == ()
    assert unnamed.observe(NAMELESS, 1.0 + UNNAMED_S) == (TOPIC,)
    looked = [at for at in range(10, 2000) if unnamed.observe(NAMELESS, float(at))]
    assert [later - earlier for earlier, later in pairwise([6, *looked])] == [REST_S, 2 * REST_S]
    assert len(looked) == TRIES - 1


def test_an_endpoint_without_a_node_causes_one_new_participant() -> None:
    """PX4's uXRCE-DDS agent is not a ROS node: its topics flow and never get a name. A new participant lists a named
    subscriber a moment before it, which does not count as complete."""
    publisher, subscriber = EndpointFact("", STRING), EndpointFact(NODE, STRING)
    flowing = {TOPIC: TopicFact((publisher,), (), FLOWING)}
    unnamed = UnnamedParticipants()
    assert [bool(unnamed.observe(flowing, float(at))) for at in range(3600)].count(True) == 1
    both = {TOPIC: TopicFact((publisher,), (subscriber,), FLOWING)}
    unnamed, looked = UnnamedParticipants(), 0
    for at in range(3600):
        if unnamed.observe(both, float(at)):
            looked += 1
            unnamed.observe({TOPIC: TopicFact((), (subscriber,))}, at + 0.5)
    assert looked == 1


def test_after_its_names_were_complete_a_topic_may_cause_new_participants_again() -> None:
    """Losing them again is a new defect."""
    unnamed = UnnamedParticipants()
    unnamed.observe(NAMED, 0.0)
    assert sum(bool(unnamed.observe(NAMELESS, float(at))) for at in range(1, 1000)) == 1
    unnamed.observe(NAMED, 1000.0)
    unnamed.observe(NAMED, 1000.0 + UNNAMED_S)
    assert sum(bool(unnamed.observe(NAMELESS, float(at))) for at in range(1010, 2000)) == TRIES


def test_an_endpoint_that_never_had_a_name_is_ignored_unless_its_data_arrive() -> None:
    """Where data are blocked no name ever arrives, and a new participant gets none either."""
    unnamed = UnnamedParticipants()
    assert not any(unnamed.observe(NAMELESS, float(at)) for at in range(100))
    flowing = {TOPIC: TopicFact((EndpointFact("", STRING),), (), FLOWING)}
    assert any(unnamed.observe(flowing, float(at)) for at in range(100, 110))


def test_data_of_an_unlisted_publisher_open_a_new_participant() -> None:
    """The snapshot contradicts itself: the vehicle is not at fault."""
    flowing = {TOPIC: TopicFact((), (), FLOWING)}
    unnamed = UnnamedParticipants()
    assert any(unnamed.observe(flowing, float(at)) for at in range(10))
    assert not any(UnnamedParticipants().observe({TOPIC: TopicFact()}, float(at)) for at in range(100))


def test_a_beacon_of_an_unlisted_node_opens_a_new_participant() -> None:
    """Its beacon arrives through the same participant that does not list it."""
    unnamed = UnnamedParticipants()
    assert any(unnamed.observe({}, float(at), {NODE}) for at in range(10))
    assert not any(UnnamedParticipants().observe({}, float(at), {NODE} if at % 4 else set()) for at in range(100))
