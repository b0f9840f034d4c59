"""Slot 7: rules of the topics check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks import _qos
from phm_checks._endpoint_matching import MAX_KINDS
from phm_checks._text import listed
from phm_checks.topics import Topics

NAME = "/agent_1/topic_1"
UNIT = "topics/agent_1/topic_1"
STRING = "std_msgs/msg/String"


def endpoint(node: str = "/agent_1/node_1", type_: str = STRING, *qos: str, **fields: Any) -> api.EndpointFact:
    return api.EndpointFact(node, type_, *qos, **fields)


def build(**topic: Any) -> api.Check:
    settings = testing.settings(containers=[{"name": "ros_app"}], ros={"topics": [{"name": NAME, **topic}]})
    (check,) = Topics.build(settings)
    return check


def evaluate(check: api.Check, fact: api.TopicFact | None, **ros: Any) -> api.Result:
    topics = {} if fact is None else {NAME: fact}
    results = check.run(testing.world(ros=testing.FakeRos(topics=topics, **ros)))
    assert not isinstance(results, api.Result)
    return results[UNIT]


PAIR = api.TopicFact((endpoint(),), (endpoint("/agent_1/node_2"),))


def test_a_connected_topic_is_ok() -> None:
    """All named endpoints exist and have the configured type."""
    check = build(type=STRING, publishers=["agent_1/node_1"], subscribers=["/agent_1/node_2"])
    assert evaluate(check, PAIR).level is api.Level.OK


def test_a_topic_depends_on_its_nodes_and_their_container() -> None:
    """A dead node is reported once, by its unit; the topic's evidence arrives earlier, so the topic settles first."""
    (unit,) = build(publishers=["/agent_1/node_1"], subscribers=["/agent_1/node_2"]).units
    assert unit.needs == ("container/ros_app", "network/ros_app", "nodes/agent_1/node_1", "nodes/agent_1/node_2")
    assert (unit.target, unit.settle_s, unit.grace_s) == ("ros_app", 1.5, 8.0)


@pytest.mark.parametrize("fact", [None, api.TopicFact()])
def test_a_topic_without_endpoints_is_missing(fact: api.TopicFact | None) -> None:
    """No node publishes or subscribes to it."""
    result = evaluate(build(), fact)
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "topic_missing", "topic_1 missing")


def test_a_topic_with_subscribers_only_lacks_its_publisher() -> None:
    """Any publisher is accepted if none is named, but one must exist."""
    assert evaluate(build(), api.TopicFact((), (endpoint(),))).condition == "publisher_missing"


@pytest.mark.parametrize(
    ("side", "condition"), [("publishers", "publisher_missing"), ("subscribers", "subscriber_missing")]
)
def test_a_missing_named_endpoint_is_reported(side: str, condition: str) -> None:
    """Another node in its place does not count, and a similar name is suggested."""
    result = evaluate(build(**{side: ["/agent_1/node_7"]}), PAIR)
    assert (result.level, result.condition) == (api.Level.ERROR, condition)
    assert "node_7" in result.brief and "Did you mean" in result.summary


def test_a_missing_publisher_beside_none_is_one_clear_sentence() -> None:
    """Without others there is no empty list of them."""
    result = evaluate(build(publishers=["/agent_1/node_7"]), api.TopicFact((), PAIR.subscribers))
    assert "lacks its publisher /agent_1/node_7 and has no other: check that node's topic names" in result.summary


@pytest.mark.parametrize(
    ("kind", "left"), [("publisher", ((), PAIR.subscribers)), ("subscriber", (PAIR.publishers, ()))]
)
def test_an_endpoint_dropped_by_a_running_node_is_lost(kind: str, left: tuple[Any, Any]) -> None:
    """It existed and its node still runs: a restart of that node's container restores it, so that is the target."""
    check = build(publishers=["/agent_1/node_1"], subscribers=["/agent_1/node_2"])
    nodes = {"/agent_1/node_1": 1, "/agent_1/node_2": 1}
    assert evaluate(check, PAIR, nodes=nodes).level is api.Level.OK
    result = evaluate(check, api.TopicFact(*left), nodes=nodes)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, f"{kind}_lost", "ros_app")
    assert evaluate(check, PAIR, nodes=nodes).level is api.Level.OK


def test_a_missing_endpoint_of_a_restarted_node_is_not_lost() -> None:
    """Its node was away since: it may be another version, and no restart helps against a configuration mistake."""
    check = build(subscribers=["/agent_1/node_2"])
    nodes = {"/agent_1/node_2": 1}
    alone = api.TopicFact(PAIR.publishers)
    evaluate(check, PAIR, nodes=nodes)
    evaluate(check, alone, nodes={})
    assert evaluate(check, alone, nodes=nodes).condition == "subscriber_missing"


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
def test_a_wrong_type_is_reported_for_its_endpoint(
    topic: Any, out: list[str], into: list[str], level: api.Level
) -> None:
    """ERROR if the configuration names the endpoint or needs a publisher; a wrong type at an unnamed endpoint is a WARN."""
    fact = api.TopicFact(
        tuple(endpoint(f"/agent_1/node_1{'0' * n}", kind) for n, kind in enumerate(out)),
        tuple(endpoint(TWO, kind) for kind in into),
    )
    result = evaluate(build(type=STRING, **topic), fact)
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
def test_mixed_types_are_an_error_for_a_required_pair(topic: Any, level: api.Level) -> None:
    """Which type is wrong is unknown, but the named subscriber receives nothing."""
    result = evaluate(build(**topic), api.TopicFact((endpoint(),), (endpoint(TWO, INT),)))
    assert (result.level, result.condition) == (level, "type_wrong")
    assert f"{STRING} at publisher {ONE}, {INT} at subscriber {TWO}" in result.summary


def test_two_publishers_of_different_type_are_reported_without_a_subscriber() -> None:
    """The next subscriber would receive only one of them."""
    assert evaluate(build(), api.TopicFact((endpoint(), endpoint(TWO, INT)), ())).level is api.Level.WARN


def test_one_type_in_two_versions_is_reported() -> None:
    """The name is equal but the definition is not: built with different versions of the package."""
    fact = api.TopicFact(
        (endpoint(type_hash="RIHS01_aaaa"),), (endpoint(TWO, type_hash="RIHS01_bbbb"), endpoint(THREE))
    )
    result = evaluate(build(type=STRING, publishers=[ONE], subscribers=[TWO]), fact)
    assert (result.level, result.condition) == (api.Level.ERROR, "type_wrong")
    assert f"publisher {ONE} has RIHS01_aaaa, subscriber {TWO} has RIHS01_bbbb" in result.summary
    assert evaluate(build(type=STRING), fact).level is api.Level.WARN


OFFERS = {"reliability": "best_effort", "durability": "volatile", "liveliness": "automatic"}
ASKS = {"reliability": "reliable", "durability": "transient_local", "liveliness": "manual_by_topic"}


@pytest.mark.parametrize(
    ("offered", "asked", "words"),
    [
        *(({policy: OFFERS[policy]}, {policy: ASKS[policy]}, f"{policy}: publisher") for policy in OFFERS),
        ({"reliability": "BEST-EFFORT"}, {"reliability": "RELIABLE"}, "reliability: publisher"),
        ({"liveliness": "automatic"}, {"liveliness": "manual_by_node"}, "liveliness: publisher"),
        ({"deadline_s": None}, {"deadline_s": 0.5}, "deadline: publisher {} offers none, subscriber {} requests 0.5 s"),
        ({"deadline_s": 2.0}, {"deadline_s": 0.5}, "deadline: publisher {} offers 2 s, subscriber {} requests 0.5 s"),
        ({"lease_s": None}, {"lease_s": 1.0}, "liveliness lease: publisher {} offers none, subscriber {} requests 1 s"),
        ({"lease_s": 3.0}, {"lease_s": 1.0}, "liveliness lease: publisher {} offers 3 s, subscriber {} requests 1 s"),
        *(({policy: ASKS[policy]}, {policy: OFFERS[policy]}, "") for policy in OFFERS),
        *(({policy: kind}, {policy: kind}, "") for policy, kind in ASKS.items()),
        ({}, ASKS, ""),
        ({"reliability": "system_default"}, {"reliability": "reliable"}, ""),
        ({"deadline_s": 0.5}, {"deadline_s": 0.5}, ""),
        ({"deadline_s": 0.5}, {"deadline_s": None}, ""),
        ({"lease_s": 0.5, "deadline_s": 0.1}, {"lease_s": 1.0, "deadline_s": None}, ""),
    ],
)
def test_each_policy_is_checked_by_the_rules_of_dds(offered: Any, asked: Any, words: str) -> None:
    """Policy and both sides are named; an offer of the same or more is compatible; unknown policies are ignored."""
    result = evaluate(build(), api.TopicFact((endpoint("/talker", **offered),), (endpoint("/listener", **asked),)))
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
def test_a_required_pair_must_connect(topic: Any, level: api.Level) -> None:
    """A named subscriber receives nothing: ERROR. A pair that the configuration does not name: WARN."""
    result = evaluate(build(**topic), api.TopicFact((endpoint(**LAX),), (endpoint(TWO, **STRICT),)))
    assert (result.level, result.condition) == (level, "qos_mismatch")
    assert result.evidence.conclusive


def test_a_named_subscriber_with_another_publisher_is_a_warning() -> None:
    """No publisher is named, so any is accepted; if both are named, that pair must connect."""
    fact = api.TopicFact((endpoint(ONE, **LAX), endpoint(THREE, **STRICT)), (endpoint(TWO, **STRICT),))
    assert evaluate(build(subscribers=[TWO]), fact).level is api.Level.WARN
    assert evaluate(build(publishers=[THREE], subscribers=[TWO]), fact).level is api.Level.WARN
    assert evaluate(build(publishers=[ONE, THREE], subscribers=[TWO]), fact).level is api.Level.ERROR


@pytest.mark.parametrize(
    ("out", "into", "change"),
    [
        ([LAX], [STRICT], "set reliable at the publisher, or best_effort at the subscriber"),
        ([LAX, STRICT], [STRICT], "set reliable at the publisher"),
        ([LAX], [STRICT, LAX], "set best_effort at the subscriber"),
    ],
)
def test_the_advice_addresses_the_endpoint_that_differs(out: list[Any], into: list[Any], change: str) -> None:
    """If the publisher serves others, the subscriber requests too much, and vice versa."""
    fact = api.TopicFact(
        tuple(endpoint(f"/out_{n}", **qos) for n, qos in enumerate(out)),
        tuple(endpoint(f"/in_{n}", **qos) for n, qos in enumerate(into)),
    )
    assert evaluate(build(), fact).summary.endswith(f"{change}.")


def test_many_pairs_are_counted() -> None:
    """The text stays short."""
    fact = api.TopicFact((endpoint(**LAX),), tuple(endpoint(f"/in_{n}", **STRICT) for n in range(9)))
    assert evaluate(build(), fact).summary.endswith("And 6 more.")


@pytest.mark.parametrize("deadlines", [1, 200], ids=["alike", "all different"])
def test_hundreds_of_endpoints_are_compared_quickly(deadlines: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Anyone may announce them. Comparing each pair, or even all endpoints for each pair, would take seconds to minutes."""
    compared, compare = [0], _qos._kinds

    def counted(*pair: api.EndpointFact) -> Any:
        compared[0] += 1
        assert compared[0] < 200 * 200 / 10
        return compare(*pair)

    monkeypatch.setattr(_qos, "_kinds", counted)
    out, into = (
        tuple(endpoint(f"/a/{side}_{n}", **qos, deadline_s=9.0 + at * (n % deadlines)) for n in range(200))
        for side, qos, at in (("out", LAX, -0.01), ("in", STRICT, 0.01))
    )
    assert " more." in evaluate(build(), api.TopicFact(out, into)).summary
    fact = api.TopicFact((*out, endpoint(ONE, **LAX)), (*into, endpoint(TWO, **STRICT)))
    compared[0] = 0
    result = evaluate(build(publishers=[ONE], subscribers=[TWO]), fact)
    assert result.level is api.Level.ERROR
    assert f"publisher {ONE} offers best_effort, subscriber {TWO} requests reliable" in result.summary


@pytest.mark.parametrize("kind", ["std_msgs/msg/String", "std_msgs/msg/Bool"])
def test_invented_publishers_do_not_hide_the_one_that_serves_a_subscriber(kind: str) -> None:
    """Any participant may announce as many as it likes. An ERROR could restart the container of the subscriber."""
    invented = [endpoint(f"/0/out_{n}", kind, **LAX, deadline_s=1.0 + n) for n in range(2 * MAX_KINDS)]
    fact = api.TopicFact((*invented, endpoint(ONE, **STRICT)), (endpoint(TWO, **STRICT),))
    assert evaluate(build(subscribers=[TWO], type=None), fact).level is api.Level.WARN


def test_changed_endpoints_are_compared_again() -> None:
    """Earlier results about the endpoints are discarded."""
    check = build()
    bad, good = (api.TopicFact((endpoint(**qos),), (endpoint(TWO, **STRICT),)) for qos in (LAX, STRICT))
    assert [evaluate(check, fact).level for fact in (bad, bad, good, bad)] == [
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
def test_a_node_that_uses_a_similar_name_is_reported(name: str, why: str) -> None:
    """The missing node publishes under another name: the text has the node, its name, and the configured name."""
    result = evaluate(build(publishers=[ONE]), api.TopicFact((), (endpoint(TWO),)), others={name: uses([ONE])})
    assert result.condition == "publisher_missing"
    assert f"{ONE} publishes {name}, {why}: did you mean {NAME}?" in result.summary


def test_a_similar_name_with_both_endpoints_is_not_suggested_while_the_right_one_is_used() -> None:
    """It is another topic; but if no node uses the right name, it may be this one."""
    others = {"/agent_1/topc_1": uses([THREE], ["/agent_1/node_4"])}
    assert (
        "did you mean"
        not in evaluate(build(publishers=[ONE]), api.TopicFact((), (endpoint(TWO),)), others=others).summary
    )
    assert "did you mean" in evaluate(build(publishers=[ONE]), None, others=others).summary


def test_a_similar_name_of_another_node_is_suggested_when_one_side_is_missing() -> None:
    """A subscription without a publisher beside a topic without its subscriber."""
    result = evaluate(
        build(subscribers=[TWO]), api.TopicFact((endpoint(),), ()), others={"/agent_1/topc_1": uses((), [THREE])}
    )
    assert f"{THREE} subscribes to /agent_1/topc_1, one character different: did you mean {NAME}?" in result.summary


def stray(name: str, fact: api.NameFact, seconds: float) -> api.Result:
    """The result of a healthy topic, `seconds` after a similar name was first seen."""
    check, clock = build(), testing.FakeClock()
    ros = testing.FakeRos(topics={NAME: PAIR}, others={name: fact})
    world = testing.world(clock=clock, ros=ros)
    check.run(world)
    clock.advance(seconds)
    results = check.run(world)
    assert not isinstance(results, api.Result)
    return results[UNIT]


def test_a_subscription_without_publisher_on_a_similar_name_is_a_warning() -> None:
    """Although the topic itself is OK: no other unit would report it."""
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
def test_an_intentional_similar_name_is_not_a_warning(name: str, fact: api.NameFact, seconds: float) -> None:
    """Too recent, with a publisher, a publisher only, another number, another agent, another name."""
    assert stray(name, fact, seconds).level is api.Level.OK


def test_a_new_snapshot_proves_no_absence() -> None:
    """Discovery needs seconds to fill the graph."""
    assert evaluate(build(), None, up_s=2.0).level is api.Level.STALE


def test_an_outdated_snapshot_proves_nothing() -> None:
    """A frozen graph is not evaluated."""
    assert evaluate(build(), PAIR, age_s=30.0).level is api.Level.STALE


def test_without_a_snapshot_every_topic_is_stale() -> None:
    """Without rclpy the rest of PHM keeps working."""
    ros = testing.FakeRos()
    ros.fail("rclpy is not installed")
    results = build().run(testing.world(ros=ros))
    assert not isinstance(results, api.Result)
    assert results[UNIT].level is api.Level.STALE
    assert "rclpy" in results[UNIT].summary


def test_without_configured_topics_no_check_is_built() -> None:
    """There is nothing to check."""
    assert list(Topics.build(testing.settings())) == []


NAMELESS = endpoint("")


@pytest.mark.parametrize("side", ["publishers", "subscribers"])
def test_an_endpoint_of_an_unknown_node_does_not_count_as_missing(side: str) -> None:
    """It may be the expected one: STALE with a complete sentence, no alarm and no restart."""
    check = build(publishers=[ONE], subscribers=[TWO])
    nodes = {ONE: 1, TWO: 1}
    assert evaluate(check, PAIR, nodes=nodes).level is api.Level.OK
    seen = {"publishers": PAIR.publishers, "subscribers": PAIR.subscribers, side: (NAMELESS,)}
    result = evaluate(check, api.TopicFact(**seen), nodes=nodes)
    assert (result.level, result.condition) == (api.Level.STALE, "")
    lacking = ONE if side == "publishers" else TWO
    assert f"has a {side[:-1]} whose node PHM does not know: whether {lacking} is connected" in result.summary
    assert evaluate(check, PAIR, nodes=nodes).level is api.Level.OK


def test_a_list_of_unnamed_endpoints_is_a_sentence() -> None:
    """An unnamed endpoint is called so instead of leaving a gap in the list."""
    found = api.TopicFact((endpoint(""), endpoint("", INT)))
    assert "publisher (unnamed node)" in evaluate(build(), found).summary
    assert listed(["", "/a"]) == "(unnamed), /a" and listed([]) == "none"


def test_received_data_prove_a_publisher_that_is_not_listed() -> None:
    """Samples arrived after the last publisher had left the graph: the snapshot is wrong, not the vehicle."""
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


def test_a_lasting_warning_about_others_shows_that_the_publisher_is_back() -> None:
    """Else its fault would stay open for as long as a recorder requests what the publisher does not offer."""
    check = build(publishers=["/agent_1/node_1"])
    bag, other = endpoint("/rosbag2", STRING, "reliable"), endpoint("/agent_1/node_1", STRING, "best_effort")
    nodes = {"/agent_1/node_1": 1}
    assert evaluate(check, api.TopicFact((), (bag,)), nodes=nodes).condition == "publisher_missing"
    result = evaluate(check, api.TopicFact((other,), (bag,)), nodes=nodes)
    assert (result.level, result.condition, result.ends_fault) == (api.Level.WARN, "qos_mismatch", True)


def test_a_weaker_mismatch_is_not_the_end_of_a_mismatch() -> None:
    """The same measurement: the fault ends with an OK."""
    check = build(publishers=["/agent_1/node_1"], subscribers=["/agent_1/node_2"])
    publisher = endpoint("/agent_1/node_1", STRING, "best_effort")
    mine, bag = endpoint("/agent_1/node_2", STRING, "reliable"), endpoint("/rosbag2", STRING, "reliable")
    result = evaluate(check, api.TopicFact((publisher,), (mine, bag)))
    assert (result.level, result.condition) == (api.Level.ERROR, "qos_mismatch")
    right = endpoint("/agent_1/node_2", STRING, "best_effort")
    result = evaluate(check, api.TopicFact((publisher,), (right, bag)))
    assert (result.level, result.condition, result.ends_fault) == (api.Level.WARN, "qos_mismatch", False)
