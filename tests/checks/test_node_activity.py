"""When topics and rates are reported: immediately if the node is known to be alive, after a delay otherwise."""

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


def endpoint(node: str, reliability: str = "reliable") -> api.EndpointFact:
    return api.EndpointFact(node, STRING, reliability)


def beacon(age_s: float, late_s: float = 0.0, turns: int = 9) -> api.BeaconFact:
    return api.BeaconFact(age_s, 0.2, late_s, turns=turns)


def active_topic(node: str, silent_s: float, **rate: Any) -> api.TopicFact:
    return api.TopicFact((endpoint(node),), (), api.RateFact(5.0, silent_s, **rate))


def fact(**fields: Any) -> api.RosFact:
    return api.RosFact(**{"age_s": 0.1, "up_s": 60.0, "nodes": BOTH, **fields})


# ------------------------------------------------------------ signs of life


def test_a_heartbeat_after_the_loss_is_a_sign_of_life() -> None:
    """An earlier one is not, and a missing one is not."""
    assert went_on(ONE, fact(beacons={ONE: beacon(0.1)}), 0.4)
    assert not went_on(ONE, fact(beacons={ONE: beacon(0.3)}), 0.4)
    assert not went_on(ONE, fact(), 100.0)


def test_a_topic_that_only_the_node_publishes_is_a_sign_of_life() -> None:
    """Not a topic that another node publishes too, nor one whose samples cannot be attributed."""
    assert went_on(ONE, fact(topics={OTHER: active_topic(ONE, 0.2)}), 0.6)
    shared = api.TopicFact((endpoint(ONE), endpoint(TWO)), (), api.RateFact(5.0, 0.2))
    assert not went_on(ONE, fact(topics={OTHER: shared}), 0.6)
    assert not went_on(ONE, fact(topics={OTHER: active_topic(ONE, 0.2, problem="ambiguous")}), 0.6)


def test_a_node_that_is_listed_twice_proves_nothing() -> None:
    """One of the two entries may be stale, of a dead node."""
    assert not went_on(ONE, fact(beacons={ONE: beacon(0.0)}, nodes={ONE: 2}), 5.0)
    assert not went_on(ONE, fact(beacons={ONE: beacon(0.0)}, nodes={}), 5.0)


def test_the_newest_sign_of_life_counts() -> None:
    """Among beacon and topics."""
    both = fact(beacons={ONE: beacon(5.0)}, topics={OTHER: active_topic(ONE, 0.0)})
    assert sign_s(ONE, both) < FRESH_S


def test_a_beacon_shows_when_the_executor_last_ran() -> None:
    """It polls once a second; a late executor ran that much earlier, and without a watch on it the time is unknown."""
    assert turned_s(ONE, fact(beacons={ONE: beacon(0.1)})) == pytest.approx(1.1)
    assert turned_s(ONE, fact(beacons={ONE: beacon(0.1, late_s=0.7)})) == pytest.approx(1.8)
    assert turned_s(ONE, fact(beacons={ONE: beacon(0.1, turns=0)})) == float("inf")


# ------------------------------------------------------------ lost endpoints

KEY = (TOPIC, "subscriber", TWO)
ALIVE = fact(beacons={TWO: beacon(0.0)})


def away(history: EndpointHistory, gap_s: float, now: float) -> float:
    """Remove the endpoint and restore it; return when it is restored."""
    assert history.lost(KEY, there=False, listed=True, now=now)
    assert not history.lost(KEY, there=True, listed=True, now=now + gap_s)
    return now + gap_s


def settle_s(history: EndpointHistory, now: float, after_s: float = 1.0) -> float | None:
    """The settle time of an endpoint that is lost from `now` on, evaluated `after_s` later."""
    assert history.lost(KEY, there=False, listed=True, now=now)
    return history.settle_s(KEY, ALIVE, now + after_s)


def known() -> EndpointHistory:
    history = EndpointHistory()
    assert not history.lost(KEY, there=True, listed=True, now=0.0)
    return history


def test_a_lost_endpoint_of_a_live_node_is_reported_soon() -> None:
    """As soon as the node has been received since; before that it may be terminating."""
    assert settle_s(known(), 10.0) == SETTLE_S
    assert settle_s(known(), 10.0, after_s=0.1) is None


def test_a_node_that_recreates_its_endpoints_gets_time() -> None:
    """Twice as long as it took, in addition; forgotten after ten minutes."""
    history = known()
    back = away(history, 1.0, 10.0)
    assert settle_s(history, back + 5.0) == pytest.approx(SETTLE_S + REMADE)
    history.lost(KEY, there=True, listed=True, now=back + 6.0)
    assert settle_s(history, back + 700.0) == SETTLE_S


def test_an_endpoint_that_was_missing_for_long_was_lost() -> None:
    """Its return does not extend the time."""
    history = known()
    back = away(history, REMADE_MOST_S + 1.0, 10.0)
    assert settle_s(history, back + 5.0) == SETTLE_S


def test_an_endpoint_that_a_node_never_had_since_it_was_listed_is_not_lost() -> None:
    """Neither before the node appeared nor after it was away."""
    assert not EndpointHistory().lost(KEY, there=False, listed=True, now=0.0)
    history = known()
    assert not history.lost(KEY, there=False, listed=False, now=1.0)
    assert not history.lost(KEY, there=False, listed=True, now=2.0)


# ------------------------------------------------------------ topics


class Connections:
    """One topic from ONE to TWO."""

    def __init__(self) -> None:
        topic = {"name": TOPIC, "publishers": [ONE], "subscribers": [TWO]}
        (self.check,) = Topics.build(testing.settings(containers=[{"name": "ros_app"}], ros={"topics": [topic]}))
        self.clock = testing.FakeClock()

    def evaluate(self, out: Any, into: Any, **ros: Any) -> api.Result:
        ros = {"nodes": BOTH, "topics": {TOPIC: api.TopicFact(tuple(out), tuple(into))}, **ros}
        results = self.check.run(testing.world(clock=self.clock, ros=testing.FakeRos(**ros)))
        assert not isinstance(results, api.Result)
        return results["topics/agent_1/topic_1"]


def test_a_subscription_that_a_live_node_dropped_is_reported_within_half_a_second() -> None:
    """Its beacon stays alive; without that the unit's settle time applies, in which a dying node is detected as dead."""
    bench = Connections()
    bench.evaluate([endpoint(ONE)], [endpoint(TWO)])
    lost = bench.evaluate([endpoint(ONE)], [], beacons={TWO: beacon(0.0)})
    assert (lost.condition, lost.settle_s) == ("subscriber_lost", None)
    bench.clock.advance(0.5)
    assert bench.evaluate([endpoint(ONE)], [], beacons={TWO: beacon(0.1)}).settle_s == SETTLE_S
    assert bench.evaluate([endpoint(ONE)], [], beacons={TWO: beacon(0.6)}).settle_s is None


def test_a_mismatch_between_live_nodes_is_reported_immediately() -> None:
    """Both endpoints exist and their nodes are alive: there is no other explanation."""
    out, into = [endpoint(ONE, "best_effort")], [endpoint(TWO)]
    alive = {ONE: beacon(0.1), TWO: beacon(0.1)}
    found = Connections().evaluate(out, into, beacons=alive)
    assert (found.level, found.condition, found.settle_s) == (api.Level.ERROR, "qos_mismatch", SURE_S)
    assert Connections().evaluate(out, into, beacons={ONE: beacon(0.1)}).settle_s is None
    assert Connections().evaluate(out, into, beacons=alive, nodes={ONE: 2, TWO: 1}).settle_s is None


def test_a_publisher_that_is_being_recreated_is_not_lost_yet() -> None:
    """A QoS change removes a publisher and creates another: the result after that is reported."""
    bench = Connections()
    alive = {ONE: beacon(0.0), TWO: beacon(0.0)}
    bench.evaluate([endpoint(ONE)], [endpoint(TWO)])
    assert bench.evaluate([], [endpoint(TWO)], beacons=alive).condition == "publisher_lost"
    bench.clock.advance(0.1)
    assert bench.evaluate([], [endpoint(TWO)], beacons=alive).settle_s is None
    assert bench.evaluate([endpoint(ONE, "best_effort")], [endpoint(TWO)], beacons=alive).condition == "qos_mismatch"


def test_a_fault_keeps_its_text_while_a_publisher_is_recreated() -> None:
    """From one incompatible QoS to another, or to a compatible one: the moment in between is not reported."""
    bench = Connections()
    bench.evaluate([endpoint(ONE)], [endpoint(TWO)])
    bench.evaluate([endpoint(ONE, "best_effort")], [endpoint(TWO)])
    assert bench.evaluate([], [endpoint(TWO)]).condition == "qos_mismatch"
    bench.clock.advance(SETTLE_S + 0.1)
    assert bench.evaluate([], [endpoint(TWO)]).condition == "publisher_lost"
    assert bench.evaluate([endpoint(ONE)], [endpoint(TWO)]).level is api.Level.OK
    assert bench.evaluate([], [endpoint(TWO)]).condition == "publisher_lost"


# ------------------------------------------------------------ rates


class TwoTopics:
    """Two topics, each of its own node."""

    def __init__(self, hz: float = 5.0) -> None:
        topics = [{"name": name, "rate": hz} for name in (TOPIC, OTHER)]
        (self.check,) = Rates.build(testing.settings(containers=[{"name": "ros_app"}], ros={"topics": topics}))
        self.clock, self.hz = testing.FakeClock(), hz

    def evaluate(self, rate: api.RateFact, other: api.RateFact | None = None, **ros: Any) -> api.Result:
        other = other or api.RateFact(self.hz, 0.1, 3.0, error_hz=0.0)
        topics = {TOPIC: api.TopicFact((endpoint(ONE),), (), rate), OTHER: api.TopicFact((endpoint(TWO),), (), other)}
        ros = {"nodes": BOTH, "topics": topics, **ros}
        results = self.check.run(testing.world(clock=self.clock, ros=testing.FakeRos(**ros)))
        assert not isinstance(results, api.Result)
        return results["rates/agent_1/topic_1"]

    def silent(self, silent_s: float, beacon: api.BeaconFact | None, limit_s: float = 1.0) -> float | None:
        rate = api.RateFact(0.0, silent_s, limit_s=limit_s)
        found = self.evaluate(rate, beacons={} if beacon is None else {ONE: beacon})
        assert found.condition == "topic_silent"
        return found.settle_s


def test_a_silent_topic_of_a_live_node_is_reported_immediately() -> None:
    """Its executor ran after a message was due, so the node is neither dead nor hung."""
    assert TwoTopics().silent(1.4, beacon(0.1)) == 0.0


@pytest.mark.parametrize("beacon", [None, beacon(0.1, late_s=0.5), beacon(0.4), beacon(0.1, turns=0)])
def test_a_silent_topic_of_a_possibly_hung_or_dead_node_settles(beacon: api.BeaconFact | None) -> None:
    """No beacon, or none that shows that the executor ran since."""
    assert TwoTopics().silent(1.4, beacon) is None


def test_the_start_of_silence_of_a_large_topic_is_unknown() -> None:
    """It is sampled with pauses, so its node may have hung since its last message."""
    large = api.RateFact(0.0, 4.0, limit_s=3.0, sample_bytes=1e6)
    assert TwoTopics().evaluate(large, beacons={ONE: beacon(0.1)}).settle_s is None


@pytest.mark.parametrize(("hz", "limit_s", "settles_s"), [(10.0, 1.0, 0.0), (2.5, 1.0, 1.0), (1.0, 1.5, 2.0)])
def test_a_slow_topic_gets_five_periods(hz: float, limit_s: float, settles_s: float) -> None:
    """One late message is not silence, even if the node is alive; but never longer than the usual settle time."""
    assert TwoTopics(hz).silent(4.0, beacon(0.1), limit_s) == pytest.approx(settles_s)


CHANGED = api.RateFact(2.5, 0.1, 1.6, error_hz=0.0, changed_s=1.6)


def test_a_certain_rate_change_is_reported_immediately() -> None:
    """Each sample shows it: no second measurement, no settling."""
    bench = TwoTopics()
    bench.evaluate(api.RateFact(5.0, 0.1, 3.0, error_hz=0.0))
    found = bench.evaluate(CHANGED)
    assert (found.level, found.condition, found.settle_s) == (api.Level.ERROR, "rate_low", 0.0)
    assert found.summary.startswith("agent_1/topic_1: 2.500 Hz, 50 % too low")


@pytest.mark.parametrize(
    ("other", "beacon"),
    [
        (api.RateFact(3.0, 0.1, 1.6, error_hz=0.0, changed_s=1.6), beacon(0.1)),
        (api.RateFact(0.0, 1.3), beacon(0.1)),
        (None, beacon(0.1, late_s=0.3)),
        (None, beacon(1.5)),
    ],
)
def test_a_slow_machine_gets_the_usual_time(other: api.RateFact | None, beacon: api.BeaconFact) -> None:
    """The topic of another node changed too, or the node itself waits for a CPU."""
    bench = TwoTopics()
    bench.evaluate(api.RateFact(5.0, 0.1, 3.0, error_hz=0.0))
    assert bench.evaluate(CHANGED, other, beacons={ONE: beacon}).level is api.Level.OK
    bench.clock.advance(2.0)
    found = bench.evaluate(CHANGED, other, beacons={ONE: beacon})
    assert (found.level, found.settle_s) == (api.Level.ERROR, None)
