"""How soon topics and rates are told: at once with evidence that it is not their node, with patience without."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks._endpoint_history import REMADE, REMADE_MOST_S, SETTLE_S, EndpointHistory
from phm_checks._node_activity import FRESH_S, sign_s, turned_s, went_on
from phm_checks.rates import Rates
from phm_checks.topics import SURE_S, Topics

ONE, TWO = "/agent_1/node_1", "/agent_1/node_2"
TOPIC, OTHER = "/agent_1/topic_1", "/agent_1/topic_2"
STRING = "std_msgs/msg/String"
BOTH = {ONE: 1, TWO: 1}


def end(node: str, reliability: str = "reliable") -> api.EndpointFact:
    return api.EndpointFact(node, STRING, reliability)


def beat(age_s: float, late_s: float = 0.0, turns: int = 9) -> api.BeaconFact:
    return api.BeaconFact(age_s, 0.2, late_s, turns=turns)


def flows(node: str, silent_s: float, **rate: Any) -> api.TopicFact:
    return api.TopicFact((end(node),), (), api.RateFact(5.0, silent_s, **rate))


def fact(**fields: Any) -> api.RosFact:
    return api.RosFact(**{"age_s": 0.1, "up_s": 60.0, "nodes": BOTH, **fields})


# ------------------------------------------------------------ signs of life


def test_a_beat_after_the_end_is_a_sign() -> None:
    """One from before is none, and none at all is none."""
    assert went_on(ONE, fact(beacons={ONE: beat(0.1)}), 0.4)
    assert not went_on(ONE, fact(beacons={ONE: beat(0.3)}), 0.4)
    assert not went_on(ONE, fact(), 100.0)


def test_a_topic_that_the_node_alone_publishes_is_a_sign() -> None:
    """One that another publishes too says nothing about this one; nor does one whose samples cannot be told apart."""
    assert went_on(ONE, fact(topics={OTHER: flows(ONE, 0.2)}), 0.6)
    shared = api.TopicFact((end(ONE), end(TWO)), (), api.RateFact(5.0, 0.2))
    assert not went_on(ONE, fact(topics={OTHER: shared}), 0.6)
    assert not went_on(ONE, fact(topics={OTHER: flows(ONE, 0.2, problem="ambiguous")}), 0.6)


def test_a_node_that_is_listed_twice_proves_nothing() -> None:
    """One of the two may be the ghost of a dead one."""
    assert not went_on(ONE, fact(beacons={ONE: beat(0.0)}, nodes={ONE: 2}), 5.0)
    assert not went_on(ONE, fact(beacons={ONE: beat(0.0)}, nodes={}), 5.0)


def test_the_newest_sign_counts() -> None:
    """Of beacon and topics."""
    both = fact(beacons={ONE: beat(5.0)}, topics={OTHER: flows(ONE, 0.0)})
    assert sign_s(ONE, both) < FRESH_S


def test_a_beacon_tells_when_the_executor_turned_at_the_latest() -> None:
    """It asks once a second; a late one turned that much earlier, and one that is not watched is not known."""
    assert turned_s(ONE, fact(beacons={ONE: beat(0.1)})) == pytest.approx(1.1)
    assert turned_s(ONE, fact(beacons={ONE: beat(0.1, late_s=0.7)})) == pytest.approx(1.8)
    assert turned_s(ONE, fact(beacons={ONE: beat(0.1, turns=0)})) == float("inf")


# ------------------------------------------------------------ ends that are lost

KEY = (TOPIC, "subscriber", TWO)
ALIVE = fact(beacons={TWO: beat(0.0)})


def away(ends: EndpointHistory, gap_s: float, now: float) -> float:
    """The end goes and comes back; when that is."""
    assert ends.lost(KEY, there=False, listed=True, now=now)
    assert not ends.lost(KEY, there=True, listed=True, now=now + gap_s)
    return now + gap_s


def settle_s(ends: EndpointHistory, now: float, after_s: float = 1.0) -> float | None:
    """Of an end that is lost from `now` on, as judged `after_s` later."""
    assert ends.lost(KEY, there=False, listed=True, now=now)
    return ends.settle_s(KEY, ALIVE, now + after_s)


def known() -> EndpointHistory:
    ends = EndpointHistory()
    assert not ends.lost(KEY, there=True, listed=True, now=0.0)
    return ends


def test_a_lost_end_of_a_node_that_goes_on_is_told_soon() -> None:
    """As soon as it has been heard since; before, it may be ending."""
    assert settle_s(known(), 10.0) == SETTLE_S
    assert settle_s(known(), 10.0, after_s=0.1) is None


def test_a_node_that_makes_its_ends_anew_is_given_its_time() -> None:
    """As long as it took, twice over, on top; ten minutes later that is forgotten."""
    ends = known()
    back = away(ends, 1.0, 10.0)
    assert settle_s(ends, back + 5.0) == pytest.approx(SETTLE_S + REMADE)
    ends.lost(KEY, there=True, listed=True, now=back + 6.0)
    assert settle_s(ends, back + 700.0) == SETTLE_S


def test_an_end_that_was_away_for_long_was_lost() -> None:
    """That teaches nothing."""
    ends = known()
    back = away(ends, REMADE_MOST_S + 1.0, 10.0)
    assert settle_s(ends, back + 5.0) == SETTLE_S


def test_what_a_node_never_had_since_it_was_listed_is_not_lost() -> None:
    """Neither before it was there, nor after its node was away."""
    assert not EndpointHistory().lost(KEY, there=False, listed=True, now=0.0)
    ends = known()
    assert not ends.lost(KEY, there=False, listed=False, now=1.0)
    assert not ends.lost(KEY, there=False, listed=True, now=2.0)


# ------------------------------------------------------------ topics


class Connections:
    """One topic from ONE to TWO."""

    def __init__(self) -> None:
        topic = {"name": TOPIC, "publishers": [ONE], "subscribers": [TWO]}
        (self.check,) = Topics.build(testing.settings(containers=[{"name": "ros_app"}], ros={"topics": [topic]}))
        self.clock = testing.FakeClock()

    def judge(self, out: Any, into: Any, **ros: Any) -> api.Result:
        ros = {"nodes": BOTH, "topics": {TOPIC: api.TopicFact(tuple(out), tuple(into))}, **ros}
        results = self.check.run(testing.world(clock=self.clock, ros=testing.FakeRos(**ros)))
        assert not isinstance(results, api.Result)
        return results["topics/agent_1/topic_1"]


def test_a_subscription_that_a_living_node_gave_up_is_told_within_half_a_second() -> None:
    """Its beacon beats on; without a sign of it the unit's own time holds, in which a dying node is found dead."""
    bench = Connections()
    bench.judge([end(ONE)], [end(TWO)])
    lost = bench.judge([end(ONE)], [], beacons={TWO: beat(0.0)})
    assert (lost.condition, lost.settle_s) == ("subscriber_lost", None)
    bench.clock.advance(0.5)
    assert bench.judge([end(ONE)], [], beacons={TWO: beat(0.1)}).settle_s == SETTLE_S
    assert bench.judge([end(ONE)], [], beacons={TWO: beat(0.6)}).settle_s is None


def test_a_mismatch_between_living_nodes_is_told_at_once() -> None:
    """Both ends are there and of nodes that live: nothing else explains it."""
    out, into = [end(ONE, "best_effort")], [end(TWO)]
    alive = {ONE: beat(0.1), TWO: beat(0.1)}
    found = Connections().judge(out, into, beacons=alive)
    assert (found.level, found.condition, found.settle_s) == (api.Level.ERROR, "qos_mismatch", SURE_S)
    assert Connections().judge(out, into, beacons={ONE: beat(0.1)}).settle_s is None
    assert Connections().judge(out, into, beacons=alive, nodes={ONE: 2, TWO: 1}).settle_s is None


def test_a_publisher_that_is_made_anew_is_not_yet_lost() -> None:
    """Another quality of service is a publisher that goes and one that comes: what is told is what they are then."""
    bench = Connections()
    alive = {ONE: beat(0.0), TWO: beat(0.0)}
    bench.judge([end(ONE)], [end(TWO)])
    assert bench.judge([], [end(TWO)], beacons=alive).condition == "publisher_lost"
    bench.clock.advance(0.1)
    assert bench.judge([], [end(TWO)], beacons=alive).settle_s is None
    assert bench.judge([end(ONE, "best_effort")], [end(TWO)], beacons=alive).condition == "qos_mismatch"


def test_a_fault_keeps_its_words_while_a_publisher_is_made_anew() -> None:
    """From one quality of service that does not fit to another, or to one that fits: the moment in between is not told."""
    bench = Connections()
    bench.judge([end(ONE)], [end(TWO)])
    bench.judge([end(ONE, "best_effort")], [end(TWO)])
    assert bench.judge([], [end(TWO)]).condition == "qos_mismatch"
    bench.clock.advance(SETTLE_S + 0.1)
    assert bench.judge([], [end(TWO)]).condition == "publisher_lost"
    assert bench.judge([end(ONE)], [end(TWO)]).level is api.Level.OK
    assert bench.judge([], [end(TWO)]).condition == "publisher_lost"


# ------------------------------------------------------------ rates


class Flows:
    """Two topics, each of a node of its own."""

    def __init__(self, hz: float = 5.0) -> None:
        topics = [{"name": name, "rate": hz} for name in (TOPIC, OTHER)]
        (self.check,) = Rates.build(testing.settings(containers=[{"name": "ros_app"}], ros={"topics": topics}))
        self.clock, self.hz = testing.FakeClock(), hz

    def judge(self, rate: api.RateFact, other: api.RateFact | None = None, **ros: Any) -> api.Result:
        other = other or api.RateFact(self.hz, 0.1, 3.0, error_hz=0.0)
        topics = {TOPIC: api.TopicFact((end(ONE),), (), rate), OTHER: api.TopicFact((end(TWO),), (), other)}
        ros = {"nodes": BOTH, "topics": topics, **ros}
        results = self.check.run(testing.world(clock=self.clock, ros=testing.FakeRos(**ros)))
        assert not isinstance(results, api.Result)
        return results["rates/agent_1/topic_1"]

    def silent(self, silent_s: float, beacon: api.BeaconFact | None, limit_s: float = 1.0) -> float | None:
        rate = api.RateFact(0.0, silent_s, limit_s=limit_s)
        found = self.judge(rate, beacons={} if beacon is None else {ONE: beacon})
        assert found.condition == "silent"
        return found.settle_s


def test_a_topic_whose_node_goes_on_is_told_silent_at_once() -> None:
    """Its executor turned after a message was due, so the node neither died nor hangs."""
    assert Flows().silent(1.4, beat(0.1)) == 0.0


@pytest.mark.parametrize("beacon", [None, beat(0.1, late_s=0.5), beat(0.4), beat(0.1, turns=0)])
def test_a_topic_whose_node_may_hang_or_be_dead_settles(beacon: api.BeaconFact | None) -> None:
    """No beacon, or none that shows that the executor has turned since."""
    assert Flows().silent(1.4, beacon) is None


def test_when_a_large_topic_fell_silent_is_not_known() -> None:
    """It is listened to with pauses, so its node may have hung since its last message."""
    large = api.RateFact(0.0, 4.0, limit_s=3.0, sample_bytes=1e6)
    assert Flows().judge(large, beacons={ONE: beat(0.1)}).settle_s is None


@pytest.mark.parametrize(("hz", "limit_s", "settles_s"), [(10.0, 1.0, 0.0), (2.5, 1.0, 1.0), (1.0, 1.5, 2.0)])
def test_a_slow_topic_is_given_five_periods(hz: float, limit_s: float, settles_s: float) -> None:
    """One message that is late is no silence, whatever speaks for the node; but no more than what any topic is given."""
    assert Flows(hz).silent(4.0, beat(0.1), limit_s) == pytest.approx(settles_s)


CHANGED = api.RateFact(2.5, 0.1, 1.6, error_hz=0.0, changed_s=1.6)


def test_a_rate_that_surely_changed_is_told_at_once() -> None:
    """Each look shows it: no second measurement, no settling."""
    bench = Flows()
    bench.judge(api.RateFact(5.0, 0.1, 3.0, error_hz=0.0))
    found = bench.judge(CHANGED)
    assert (found.level, found.condition, found.settle_s) == (api.Level.ERROR, "rate_low", 0.0)
    assert found.summary.startswith("agent_1/topic_1: 2.500 Hz, 50 % too low")


@pytest.mark.parametrize(
    ("other", "beacon"),
    [
        (api.RateFact(3.0, 0.1, 1.6, error_hz=0.0, changed_s=1.6), beat(0.1)),
        (api.RateFact(0.0, 1.3), beat(0.1)),
        (None, beat(0.1, late_s=0.3)),
        (None, beat(1.5)),
    ],
)
def test_a_machine_that_is_slow_as_a_whole_gets_the_usual_time(
    other: api.RateFact | None, beacon: api.BeaconFact
) -> None:
    """Another node's topic changed as well, or the node itself waits for its processor."""
    bench = Flows()
    bench.judge(api.RateFact(5.0, 0.1, 3.0, error_hz=0.0))
    assert bench.judge(CHANGED, other, beacons={ONE: beacon}).level is api.Level.OK
    bench.clock.advance(2.0)
    found = bench.judge(CHANGED, other, beacons={ONE: beacon})
    assert (found.level, found.settle_s) == (api.Level.ERROR, None)
