"""Slot 7: rules of the topics check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks._text import listed
from phm_checks.topics import Topics

NAME = "/agent_1/topic_1"
UNIT = "topics/agent_1/topic_1"
STRING = "std_msgs/msg/String"


def end(node: str = "/agent_1/node_1", type_: str = STRING, *qos: str, **fields: Any) -> api.EndpointFact:
    return api.EndpointFact(node, type_, *qos, **fields)


def build(**topic: Any) -> api.Check:
    settings = testing.settings(containers=[{"name": "ros_app"}], ros={"topics": [{"name": NAME, **topic}]})
    (check,) = Topics.build(settings)
    return check


def judge(check: api.Check, fact: api.TopicFact | None, **ros: Any) -> api.Result:
    topics = {} if fact is None else {NAME: fact}
    results = check.run(testing.world(ros=testing.FakeRos(topics=topics, **ros)))
    assert not isinstance(results, api.Result)
    return results[UNIT]


PAIR = api.TopicFact((end(),), (end("/agent_1/node_2"),))


def test_a_connected_topic_is_ok() -> None:
    """All named ends are there and of the configured type."""
    check = build(type=STRING, publishers=["agent_1/node_1"], subscribers=["/agent_1/node_2"])
    assert judge(check, PAIR).level is api.Level.OK


def test_a_topic_needs_its_nodes_and_their_container() -> None:
    """A dead node is told once, at the node; the topic's evidence arrives earlier, so it settles first."""
    (unit,) = build(publishers=["/agent_1/node_1"], subscribers=["/agent_1/node_2"]).units
    assert unit.needs == ("container/ros_app", "network/ros_app", "nodes/agent_1/node_1", "nodes/agent_1/node_2")
    assert (unit.target, unit.settle_s, unit.grace_s) == ("ros_app", 1.5, 8.0)


@pytest.mark.parametrize("fact", [None, api.TopicFact()])
def test_a_topic_without_ends_is_missing(fact: api.TopicFact | None) -> None:
    """Nobody knows it."""
    result = judge(build(), fact)
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "topic_missing", "topic_1 missing")


def test_a_topic_with_subscribers_alone_lacks_its_publisher() -> None:
    """Any publisher will do when none is named, but one must be."""
    assert judge(build(), api.TopicFact((), (end(),))).condition == "publisher_missing"


@pytest.mark.parametrize(
    ("side", "condition"), [("publishers", "publisher_missing"), ("subscribers", "subscriber_missing")]
)
def test_a_named_end_that_is_lacking_is_told(side: str, condition: str) -> None:
    """Another node in its place does not count, and a near name is offered."""
    result = judge(build(**{side: ["/agent_1/node_7"]}), PAIR)
    assert (result.level, result.condition) == (api.Level.ERROR, condition)
    assert "node_7" in result.brief and "Did you mean" in result.summary


@pytest.mark.parametrize(
    ("kind", "left"), [("publisher", ((), PAIR.subscribers)), ("subscriber", (PAIR.publishers, ()))]
)
def test_an_end_that_a_running_node_gave_up_is_lost(kind: str, left: tuple[Any, Any]) -> None:
    """It was there and its node still is: a restart of that node's container brings it back, so that is the target."""
    check = build(publishers=["/agent_1/node_1"], subscribers=["/agent_1/node_2"])
    nodes = {"/agent_1/node_1": 1, "/agent_1/node_2": 1}
    assert judge(check, PAIR, nodes=nodes).level is api.Level.OK
    result = judge(check, api.TopicFact(*left), nodes=nodes)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, f"{kind}_lost", "ros_app")
    assert judge(check, PAIR, nodes=nodes).level is api.Level.OK


def test_an_end_of_a_node_that_was_started_anew_is_missing() -> None:
    """Its node was away since: it may be another version, and no restart helps against a mistake of the configuration."""
    check = build(subscribers=["/agent_1/node_2"])
    nodes = {"/agent_1/node_2": 1}
    alone = api.TopicFact(PAIR.publishers)
    judge(check, PAIR, nodes=nodes)
    judge(check, alone, nodes={})
    assert judge(check, alone, nodes=nodes).condition == "subscriber_missing"


INT = "std_msgs/msg/Int32"
ONE, TWO, THREE = "/agent_1/node_1", "/agent_1/node_2", "/agent_1/node_3"


@pytest.mark.parametrize(
    ("topic", "out", "into", "level"),
    [
        ({"subscribers": [TWO]}, [STRING], [INT], api.Level.ERROR),
        ({}, [STRING], [INT], api.Level.WARN),
        ({"publishers": [ONE]}, [INT], [STRING], api.Level.ERROR),
        ({}, [INT], [], api.Level.ERROR),
        ({}, [INT, STRING], [], api.Level.WARN),
        ({"publishers": ["/agent_1/node_10"]}, [INT, STRING], [], api.Level.WARN),
    ],
)
def test_another_type_than_the_configured_is_told_by_its_end(
    topic: Any, out: list[str], into: list[str], level: api.Level
) -> None:
    """ERROR where the configuration names the end or needs one publisher; a stranger of another type is a WARN."""
    fact = api.TopicFact(
        tuple(end(f"/agent_1/node_1{'0' * n}", kind) for n, kind in enumerate(out)),
        tuple(end(TWO, kind) for kind in into),
    )
    result = judge(build(type=STRING, **topic), fact)
    assert (result.level, result.condition) == (level, "type_wrong")
    assert f"type {INT} at {'publisher' if INT in out else 'subscriber'} /agent_1/node_" in result.summary


@pytest.mark.parametrize(
    ("topic", "level"),
    [
        ({}, api.Level.WARN),
        ({"publishers": [ONE], "subscribers": [TWO]}, api.Level.ERROR),
        ({"subscribers": [TWO]}, api.Level.ERROR),
    ],
)
def test_mixed_types_are_an_error_for_a_pair_that_is_needed(topic: Any, level: api.Level) -> None:
    """Which of them is wrong is not known; that a named subscriber is not served is."""
    result = judge(build(**topic), api.TopicFact((end(),), (end(TWO, INT),)))
    assert (result.level, result.condition) == (level, "type_wrong")
    assert f"{STRING} at publisher {ONE}, {INT} at subscriber {TWO}" in result.summary


def test_two_publishers_of_different_type_are_told_without_a_subscriber() -> None:
    """Whoever subscribes next is served by one of them alone."""
    assert judge(build(), api.TopicFact((end(), end(TWO, INT)), ())).level is api.Level.WARN


def test_one_type_in_two_versions_is_told() -> None:
    """The name is the same and the content is not: built against different versions of the package."""
    fact = api.TopicFact((end(type_hash="RIHS01_aaaa"),), (end(TWO, type_hash="RIHS01_bbbb"), end(THREE)))
    result = judge(build(type=STRING, publishers=[ONE], subscribers=[TWO]), fact)
    assert (result.level, result.condition) == (api.Level.ERROR, "type_wrong")
    assert f"publisher {ONE} has RIHS01_aaaa, subscriber {TWO} has RIHS01_bbbb" in result.summary
    assert judge(build(type=STRING), fact).level is api.Level.WARN


OFFERS = {"reliability": "best_effort", "durability": "volatile", "liveliness": "automatic"}
ASKS = {"reliability": "reliable", "durability": "transient_local", "liveliness": "manual_by_topic"}


@pytest.mark.parametrize(
    ("offered", "asked", "words"),
    [
        *(({policy: OFFERS[policy]}, {policy: ASKS[policy]}, f"{policy}: publisher") for policy in OFFERS),
        ({"reliability": "BEST-EFFORT"}, {"reliability": "RELIABLE"}, "reliability: publisher"),
        ({"liveliness": "automatic"}, {"liveliness": "manual_by_node"}, "liveliness: publisher"),
        ({"deadline_s": None}, {"deadline_s": 0.5}, "deadline: publisher {} offers none, subscriber {} asks for 0.5 s"),
        ({"deadline_s": 2.0}, {"deadline_s": 0.5}, "deadline: publisher {} offers 2 s, subscriber {} asks for 0.5 s"),
        ({"lease_s": None}, {"lease_s": 1.0}, "liveliness lease: publisher {} offers none, subscriber {} asks for 1 s"),
        ({"lease_s": 3.0}, {"lease_s": 1.0}, "liveliness lease: publisher {} offers 3 s, subscriber {} asks for 1 s"),
        *(({policy: ASKS[policy]}, {policy: OFFERS[policy]}, "") for policy in OFFERS),
        *(({policy: kind}, {policy: kind}, "") for policy, kind in ASKS.items()),
        ({}, ASKS, ""),
        ({"reliability": "system_default"}, {"reliability": "reliable"}, ""),
        ({"deadline_s": 0.5}, {"deadline_s": 0.5}, ""),
        ({"deadline_s": 0.5}, {"deadline_s": None}, ""),
        ({"lease_s": 0.5, "deadline_s": 0.1}, {"lease_s": 1.0, "deadline_s": None}, ""),
    ],
)
def test_each_policy_is_judged_as_dds_does(offered: Any, asked: Any, words: str) -> None:
    """Policy and both sides are named; offering as much or more fits; what is not told is not judged."""
    result = judge(build(), api.TopicFact((end("/talker", **offered),), (end("/listener", **asked),)))
    assert result.level is (api.Level.WARN if words else api.Level.OK)
    assert words.format("/talker", "/listener") in result.summary


STRICT, LAX = {"reliability": "reliable"}, {"reliability": "best_effort"}


@pytest.mark.parametrize(
    ("topic", "level"),
    [
        ({}, api.Level.WARN),
        ({"publishers": [ONE]}, api.Level.WARN),
        ({"subscribers": [TWO]}, api.Level.ERROR),
        ({"publishers": [ONE], "subscribers": [TWO]}, api.Level.ERROR),
    ],
)
def test_a_pair_that_the_configuration_needs_must_connect(topic: Any, level: api.Level) -> None:
    """A subscriber that is named gets nothing: ERROR. A pair that nobody asked for: WARN."""
    result = judge(build(**topic), api.TopicFact((end(**LAX),), (end(TWO, **STRICT),)))
    assert (result.level, result.condition) == (level, "qos_mismatch")
    assert result.evidence.conclusive


def test_a_named_subscriber_that_another_publisher_serves_is_a_warning() -> None:
    """No publisher is named, so any one will do; where both are named, that pair must connect."""
    fact = api.TopicFact((end(ONE, **LAX), end(THREE, **STRICT)), (end(TWO, **STRICT),))
    assert judge(build(subscribers=[TWO]), fact).level is api.Level.WARN
    assert judge(build(publishers=[THREE], subscribers=[TWO]), fact).level is api.Level.WARN
    assert judge(build(publishers=[ONE, THREE], subscribers=[TWO]), fact).level is api.Level.ERROR


@pytest.mark.parametrize(
    ("out", "into", "change"),
    [
        ([LAX], [STRICT], "set at the publisher reliable, or at the subscriber best_effort"),
        ([LAX, STRICT], [STRICT], "set at the publisher reliable"),
        ([LAX], [STRICT, LAX], "set at the subscriber best_effort"),
    ],
)
def test_what_to_change_is_said_for_the_end_that_stands_alone(out: list[Any], into: list[Any], change: str) -> None:
    """If the publisher serves others, it is the subscriber that asks too much, and the other way round."""
    fact = api.TopicFact(
        tuple(end(f"/out_{n}", **qos) for n, qos in enumerate(out)),
        tuple(end(f"/in_{n}", **qos) for n, qos in enumerate(into)),
    )
    assert judge(build(), fact).summary.endswith(f"{change}.")


def test_many_pairs_are_counted() -> None:
    """The text stays short."""
    fact = api.TopicFact((end(**LAX),), tuple(end(f"/in_{n}", **STRICT) for n in range(9)))
    assert judge(build(), fact).summary.endswith("And 6 more.")


def test_ends_are_looked_through_again_when_they_changed() -> None:
    """What was found out about the ends before does not outlive them."""
    check = build()
    bad, good = (api.TopicFact((end(**qos),), (end(TWO, **STRICT),)) for qos in (LAX, STRICT))
    assert [judge(check, fact).level for fact in (bad, bad, good, bad)] == [
        api.Level.WARN,
        api.Level.WARN,
        api.Level.OK,
        api.Level.WARN,
    ]


def uses(publishers: Any = (), subscribers: Any = ()) -> api.NameFact:
    return api.NameFact(tuple(publishers), tuple(subscribers))


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("/agent_1/topc_1", "one character different"),
        ("/agent_1/Topic_1", "different capitalization"),
        ("/topic_1", "namespace incomplete"),
        ("/agent_1/agent_1/topic_1", "extra namespace"),
        ("/uav/topic_1", "in another namespace"),
        ("/agent_2/topic_1", "one character different"),
        ("/agent_1/topic_7", "one character different"),
    ],
)
def test_a_node_that_uses_an_almost_right_name_is_named(name: str, why: str) -> None:
    """The node that is lacking publishes under another name: which node, which name, and what was meant."""
    result = judge(build(publishers=[ONE]), api.TopicFact((), (end(TWO),)), others={name: uses([ONE])})
    assert result.condition == "publisher_missing"
    assert f"{ONE} publishes {name}, {why}: did you mean {NAME}?" in result.summary


def test_an_almost_right_name_with_both_ends_is_no_hint_while_the_right_one_is_used() -> None:
    """Somebody else's topic; but where nobody uses the right name, it may be this one."""
    others = {"/agent_1/topc_1": uses([THREE], ["/agent_1/node_4"])}
    assert "did you mean" not in judge(build(publishers=[ONE]), api.TopicFact((), (end(TWO),)), others=others).summary
    assert "did you mean" in judge(build(publishers=[ONE]), None, others=others).summary


def test_a_near_name_of_another_node_is_a_hint_when_it_is_used_from_one_side() -> None:
    """A subscription without a publisher beside a topic without its subscriber."""
    result = judge(build(subscribers=[TWO]), api.TopicFact((end(),), ()), others={"/agent_1/topc_1": uses((), [THREE])})
    assert f"{THREE} subscribes to /agent_1/topc_1, one character different: did you mean {NAME}?" in result.summary


def stray(name: str, fact: api.NameFact, seconds: float) -> api.Result:
    """What a topic that is well is, `seconds` after a near name was first seen."""
    check, clock = build(), testing.FakeClock()
    ros = testing.FakeRos(topics={NAME: PAIR}, others={name: fact})
    world = testing.world(clock=clock, ros=ros)
    check.run(world)
    clock.advance(seconds)
    results = check.run(world)
    assert not isinstance(results, api.Result)
    return results[UNIT]


def test_a_subscription_that_nobody_feeds_on_an_almost_right_name_is_a_warning() -> None:
    """Although the topic itself is well: nobody else would ever say so."""
    result = stray("/agent_1/topc_1", uses((), [THREE]), 10.0)
    assert (result.level, result.condition) == (api.Level.WARN, "name_mistaken")
    assert f"{THREE} subscribes to /agent_1/topc_1, one character different: did you mean {NAME}?" in result.summary
    assert result.brief == "topic_1 misnamed /agent_1/topc_1"


@pytest.mark.parametrize(
    ("name", "fact", "seconds"),
    [
        ("/agent_1/topc_1", uses((), [THREE]), 9.0),
        ("/agent_1/topc_1", uses([ONE], [THREE]), 99.0),
        ("/agent_1/topc_1", uses([ONE]), 99.0),
        ("/agent_1/topic_2", uses((), [THREE]), 99.0),
        ("/agent_2/topic_1", uses((), [THREE]), 99.0),
        ("/uav/topic_1", uses((), [THREE]), 99.0),
        ("/agent_1/other", uses((), [THREE]), 99.0),
    ],
)
def test_what_may_be_on_purpose_is_no_warning(name: str, fact: api.NameFact, seconds: float) -> None:
    """Not yet for long, fed, a publisher alone, another number, another agent, another name."""
    assert stray(name, fact, seconds).level is api.Level.OK


def test_a_young_picture_proves_no_absence() -> None:
    """Discovery needs seconds to fill the graph."""
    assert judge(build(), None, up_s=2.0).level is api.Level.STALE


def test_an_old_picture_proves_nothing() -> None:
    """A frozen graph is not judged."""
    assert judge(build(), PAIR, age_s=30.0).level is api.Level.STALE


def test_no_picture_makes_every_topic_stale() -> None:
    """Without rclpy the rest of PHM goes on."""
    ros = testing.FakeRos()
    ros.fail("rclpy is not installed")
    results = build().run(testing.world(ros=ros))
    assert not isinstance(results, api.Result)
    assert results[UNIT].level is api.Level.STALE
    assert "rclpy" in results[UNIT].summary


def test_no_topics_no_check() -> None:
    """Nothing to judge, nothing built."""
    assert list(Topics.build(testing.settings())) == []


NAMELESS = end("")


@pytest.mark.parametrize("side", ["publishers", "subscribers"])
def test_an_end_whose_node_is_not_known_is_not_taken_for_missing(side: str) -> None:
    """It may be the one that is looked for: STALE with a sentence that is one, no alarm and no restart."""
    check = build(publishers=[ONE], subscribers=[TWO])
    nodes = {ONE: 1, TWO: 1}
    assert judge(check, PAIR, nodes=nodes).level is api.Level.OK
    seen = {"publishers": PAIR.publishers, "subscribers": PAIR.subscribers, side: (NAMELESS,)}
    result = judge(check, api.TopicFact(**seen), nodes=nodes)
    assert (result.level, result.condition) == (api.Level.STALE, "")
    lacking = ONE if side == "publishers" else TWO
    assert f"has a {side[:-1]} whose node PHM does not know: whether {lacking} is connected" in result.summary
    assert judge(check, PAIR, nodes=nodes).level is api.Level.OK


def test_a_list_of_ends_without_names_is_a_sentence() -> None:
    """What has no name is called so: an empty place in a list is no text."""
    found = api.TopicFact((end(""), end("", INT)))
    assert "publisher (unnamed node)" in judge(build(), found).summary
    assert listed(["", "/a"]) == "(unnamed), /a" and listed([]) == "none"


def test_data_that_flow_prove_a_publisher_that_is_not_listed() -> None:
    """Samples that came after the last publisher had left the graph: the picture is wrong, and not the vehicle."""
    clock = testing.FakeClock()
    check = build(publishers=[ONE])
    ros = testing.FakeRos(topics={NAME: PAIR}, nodes={ONE: 1})
    world = testing.world(ros=ros, clock=clock)

    def judged(rate: api.RateFact) -> api.Result:
        ros.change(topics={NAME: api.TopicFact((), PAIR.subscribers, rate)})
        results = check.run(world)
        assert not isinstance(results, api.Result)
        return results[UNIT]

    check.run(world)
    clock.advance(1.0)
    assert judged(api.RateFact(10.0, 0.05)).level is api.Level.ERROR
    clock.advance(1.0)
    assert judged(api.RateFact(10.0, 1.05)).level is api.Level.ERROR
    assert judged(api.RateFact(10.0, 0.05)).level is api.Level.STALE
    clock.advance(5.0)
    assert judged(api.RateFact(0.0, 6.0)).level is api.Level.ERROR
