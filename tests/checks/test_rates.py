"""Slot 8: rules of the rates check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.rates import CONFIRM_S, Rates

NAME = "/agent_1/topic_1"
UNIT = "rates/agent_1/topic_1"
WINDOW_S = 3.0
TALKER = (api.EndpointFact("/agent_1/node_1", "std_msgs/msg/String"),)
KEEPER = (api.EndpointFact("/agent_1/node_2", "std_msgs/msg/String", "reliable", "transient_local"),)


class Bench:
    """One topic with a rate, and the fakes it needs."""

    def __init__(self, rate: float | str = 1.0, **topic: Any) -> None:
        settings = testing.settings(
            containers=[{"name": "ros_app"}], ros={"topics": [{"name": NAME, "rate": rate, **topic}]}
        )
        (self.check,) = Rates.build(settings)
        self.clock, self.ros = testing.FakeClock(), testing.FakeRos()
        self.docker = testing.FakeDocker(testing.container())

    def evaluate(
        self,
        hz: float | None = None,
        silent_s: float | None = 0.1,
        problem: str = "",
        error_hz: float | None = 0.0,
        **ros: Any,
    ) -> api.Result:
        rate = api.RateFact(
            hz, silent_s, WINDOW_S, samples=5, problem=problem, limit_s=1.5, publishers=1, error_hz=error_hz
        )
        return self.see(api.TopicFact(TALKER, (), rate), **ros)

    def see(self, fact: api.TopicFact, **ros: Any) -> api.Result:
        self.ros.change(topics={NAME: fact}, **ros)
        results = self.check.run(testing.world(clock=self.clock, ros=self.ros, docker=self.docker))
        assert not isinstance(results, api.Result)
        return results[UNIT]

    def known_for(self, seconds: float) -> Bench:
        """Its publisher has been listed for this long."""
        self.evaluate(1.0)
        self.clock.advance(seconds)
        return self

    def twice(self, hz: float, apart_s: float = WINDOW_S + 0.1, **rate: Any) -> api.Result:
        """Two measurements; the second one decides."""
        self.evaluate(hz, **rate)
        self.clock.advance(apart_s)
        return self.evaluate(hz, **rate)


def test_topics_without_a_rate_have_no_unit() -> None:
    """Their rate is not checked."""
    assert list(Rates.build(testing.settings(ros={"topics": [{"name": NAME}]}))) == []


def test_the_expected_rate_is_ok() -> None:
    """Within the tolerance, limits included, in the format of the paper's log."""
    bench = Bench()
    assert bench.evaluate(0.999).summary == "agent_1/topic_1: 0.999"
    assert bench.evaluate(1.1).level is api.Level.OK
    assert bench.evaluate(0.9).level is api.Level.OK


@pytest.mark.parametrize(
    ("topic", "limit_s"), [({"rate": 10.0}, 3.0), ({"rate": 0.1}, 30.0), ({"rate": 10.0, "silence": "7s"}, 7.0)]
)
def test_a_topic_is_remembered_for_longer_than_its_silence_limit(topic: dict[str, Any], limit_s: float) -> None:
    """A topic that fell silent at a restart is OK for up to `limit_s`, which must not end its grace."""
    (unit,) = Bench(**topic).check.units
    assert unit.memory_s > limit_s + 0.5


@pytest.mark.parametrize(
    ("hz", "level", "condition"),
    [
        (0.85, api.Level.WARN, "rate_low"),
        (0.7, api.Level.ERROR, "rate_low"),
        (1.15, api.Level.WARN, "rate_high"),
        (1.5, api.Level.ERROR, "rate_high"),
    ],
)
def test_a_rate_outside_the_tolerance_is_reported(hz: float, level: api.Level, condition: str) -> None:
    """A deviation above the tolerance is WARN, above twice the tolerance ERROR."""
    result = Bench().twice(hz)
    assert (result.level, result.condition, result.target) == (level, condition, "ros_app")
    assert result.brief == f"topic_1 {hz:g} Hz, not 1"


@pytest.mark.parametrize(
    ("hz", "level"), [(0.93, api.Level.OK), (0.85, api.Level.WARN), (0.55, api.Level.WARN), (0.4, api.Level.ERROR)]
)
def test_each_topic_has_its_own_limits(hz: float, level: api.Level) -> None:
    """`tolerance` and `error_tolerance`."""
    assert Bench(tolerance="10%", error_tolerance="50%").twice(hz).level is level


def test_one_measurement_outside_is_not_reported() -> None:
    """The previous report remains until a second measurement confirms it; an early second check does not count."""
    bench = Bench(10.0)
    bench.evaluate(10.0)
    assert bench.evaluate(5.0).level is api.Level.OK
    bench.clock.advance(0.1)
    assert bench.evaluate(5.0).level is api.Level.OK
    bench.clock.advance(1.0)
    assert bench.evaluate(10.0).level is api.Level.OK
    assert bench.evaluate(5.0).level is api.Level.OK
    bench.clock.advance(CONFIRM_S + 0.01)
    assert bench.evaluate(5.0).level is api.Level.ERROR


def test_confirming_measurements_share_no_sample_if_single_samples_matter() -> None:
    """Three samples of a 1 Hz topic in a window: one irregular period must not be reported as a wrong rate."""
    assert Bench(1.0).twice(0.5, CONFIRM_S).level is not api.Level.ERROR
    assert Bench(1.0).twice(0.5, WINDOW_S + 0.01).level is api.Level.ERROR


def test_the_jitter_of_a_publisher_is_not_a_wrong_rate() -> None:
    """Only a deviation beyond it counts, on both limits; the text says so."""
    assert Bench(1.0).twice(0.75, error_hz=0.1).level is api.Level.OK
    result = Bench(1.0).twice(0.6, error_hz=0.1)
    assert result.level is api.Level.WARN
    assert "40 % too low, expected 1 Hz within 10 %, and 25 % for its jitter" in result.summary
    assert Bench(1.0).twice(0.5, error_hz=0.1).level is api.Level.ERROR


def test_a_slow_topic_of_unknown_jitter_is_stale() -> None:
    """Its first three samples prove nothing; those of a fast one do."""
    assert Bench(1.0).twice(0.5, error_hz=None).level is api.Level.STALE
    assert Bench(10.0).twice(5.0, error_hz=None).level is api.Level.ERROR


def test_a_first_measurement_outside_is_stale() -> None:
    """There is no previous report that could remain."""
    assert Bench().evaluate(0.5).level is api.Level.STALE


def test_a_rate_at_the_limit_does_not_flap() -> None:
    """A level ends only well inside its limit."""
    bench = Bench()
    assert bench.twice(0.85).level is api.Level.WARN
    levels = [bench.evaluate(hz).level for hz in (0.905, 0.895, 0.905, 0.895)]
    assert set(levels) == {api.Level.WARN}
    assert bench.evaluate(0.95).level is api.Level.OK


def test_a_jittering_rate_keeps_its_brief() -> None:
    """The number in the brief changes only when the rate does."""
    bench = Bench()
    bench.twice(0.5)
    assert {bench.evaluate(hz).brief for hz in (0.51, 0.49, 0.5, 0.53)} == {"topic_1 0.5 Hz, not 1"}


def test_the_sampler_decides_what_is_silent() -> None:
    """A rate of 0.0; the text has the duration and the limit."""
    result = Bench().evaluate(hz=0.0, silent_s=1.8)
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "topic_silent", "topic_1 silent")
    assert "Silent for 1.8 s, expected 1 Hz and no gap over 1.5 s" in result.summary


@pytest.mark.parametrize(("silent_s", "ran_s", "conclusive"), [(5.0, 1.9, True), (5.0, 2.1, False), (3.5, 1.9, False)])
def test_silence_of_a_running_executor_is_not_explained_by_starvation(
    silent_s: float, ran_s: float, conclusive: bool
) -> None:
    """The node's executor ran twice, 2 s after a message was due: it had the CPU, and did not publish."""
    bench = Bench().known_for(30.0)
    beacon = api.BeaconFact(0.1, 1.0, turns=20, ran_since=bench.clock.mono() - ran_s)
    result = bench.evaluate(0.0, silent_s, nodes={"/agent_1/node_1": 1}, beacons={"/agent_1/node_1": beacon})
    assert (result.condition, result.evidence.conclusive) == ("topic_silent", conclusive)


@pytest.mark.parametrize("ran_since", [None, 10.0])
def test_an_executor_that_is_in_time_by_the_account_of_a_starved_process_may_not_have_run(
    ran_since: float | None,
) -> None:
    """A process without CPU does not count this time as lateness of its executor; the number of turns shows that it did not run."""
    bench = Bench().known_for(100.0)
    beacon = api.BeaconFact(0.1, 1.0, late_s=0.0, turns=20, ran_since=ran_since)
    result = bench.evaluate(0.0, 30.0, nodes={"/agent_1/node_1": 1}, beacons={"/agent_1/node_1": beacon})
    assert result.condition == "topic_silent" and not result.evidence.conclusive


@pytest.mark.parametrize(("input_hz", "conclusive"), [(10.0, True), (0.0, False), (None, False)])
def test_silence_behind_an_input_without_data_may_follow_from_starvation(
    input_hz: float | None, conclusive: bool
) -> None:
    """A node that publishes once per input is silent although its executor runs."""
    bench, node = Bench().known_for(30.0), "/agent_1/node_1"
    silent = api.RateFact(0.0, 5.0, WINDOW_S, samples=5, limit_s=1.5, publishers=1, error_hz=0.0)
    source = api.TopicFact((), TALKER, api.RateFact(input_hz, 0.1, WINDOW_S, samples=5, publishers=1))
    topics = {NAME: api.TopicFact(TALKER, (), silent), "/agent_1/in": source}
    beacon = api.BeaconFact(0.1, 1.0, turns=20, ran_since=bench.clock.mono() - 1.0)
    bench.ros.change(topics=topics, nodes={node: 1}, beacons={node: beacon})
    results = bench.check.run(testing.world(clock=bench.clock, ros=bench.ros))
    assert not isinstance(results, api.Result)
    assert results[UNIT].evidence.conclusive is conclusive


@pytest.mark.parametrize(
    ("listed_s", "up_s", "conclusive"), [(4.1, 60.0, True), (3.9, 60.0, False), (30.0, 3.9, False)]
)
def test_silence_of_a_publisher_that_was_discovered_again_may_follow_from_starvation(
    listed_s: float, up_s: float, conclusive: bool
) -> None:
    """PHM's reader had lost it when the message was due, or PHM's ROS child was restarted: the message may have been sent."""
    bench, node = Bench().known_for(30.0), "/agent_1/node_1"
    if listed_s < 30.0:
        bench.see(api.TopicFact())
        bench.evaluate(0.0, 1.0)
        bench.clock.advance(listed_s)
    beacon = api.BeaconFact(0.1, 1.0, turns=20, ran_since=bench.clock.mono() - 1.0)
    result = bench.evaluate(0.0, 5.0, nodes={node: 1}, beacons={node: beacon}, up_s=up_s)
    assert (result.condition, result.evidence.conclusive) == ("topic_silent", conclusive)


@pytest.mark.parametrize(("received_s", "level"), [(0.5, api.Level.STALE), (5.0, api.Level.ERROR)])
def test_silence_of_a_node_that_only_others_receive_is_not_reported(received_s: float, level: api.Level) -> None:
    """PHM's own participant has lost the node, whose other topics it would not receive either: a restart would be for nothing."""
    views = {"/agent_1/node_1": api.NeighbourFact(alive=True, age_s=received_s)}
    own, other = api.BeaconFact(5.0, 0.2, witness="one"), api.BeaconFact(0.1, 0.2, views=views, witness="other")
    beacons = {"/agent_1/node_1": own, "/agent_1/node_9": other}
    result = Bench().known_for(30.0).evaluate(0.0, 5.0, nodes={"/agent_1/node_1": 1}, beacons=beacons)
    assert result.level is level
    assert (result.condition == "topic_silent") == (level is api.Level.ERROR)


def test_silence_without_evidence_of_the_node_may_follow_from_starvation() -> None:
    """It is not conclusive."""
    assert not Bench().evaluate(0.0, 60.0).evidence.conclusive


def test_a_delay_of_phm_itself_is_not_silence() -> None:
    """The child is late, so its last snapshot grows old; it reported no silence."""
    assert Bench().evaluate(hz=1.0, silent_s=2.9, age_s=2.8).level is api.Level.OK


def test_a_topic_without_any_sample_is_an_error() -> None:
    """Listed, but not one sample: another fault than silence, often of the transport."""
    result = Bench().evaluate(silent_s=None)
    assert (result.level, result.condition) == (api.Level.ERROR, "not_received")
    assert "FASTDDS_BUILTIN_TRANSPORTS" in result.summary


@pytest.mark.parametrize(("size", "lost"), [(6_200_000, True), (1000, False), (None, False)])
def test_the_text_says_that_large_messages_may_be_lost_on_the_way(size: float | None, *, lost: bool) -> None:
    """Before any was received, the type of an image suffices."""
    rate = api.RateFact(0.0, 5.0, WINDOW_S, samples=5, limit_s=3.0, publishers=1, sample_bytes=size)
    silent = Bench(30.0).see(api.TopicFact(TALKER, (), rate))
    assert silent.condition == "topic_silent" and ("net.core.rmem_default" in silent.summary) is lost
    camera = (api.EndpointFact("/agent_1/node_1", "sensor_msgs/msg/Image"),)
    never = Bench(30.0).see(api.TopicFact(camera, (), api.RateFact(None, None)), up_s=60.0)
    assert never.condition == "not_received" and "net.core.rmem_default" in never.summary


BEACON = {"/agent_1/node_1": api.BeaconFact(0.1, 0.2, witness="one")}


@pytest.mark.parametrize(
    ("up_s", "beacons", "restarted", "condition"),
    [
        (12.0, BEACON, False, "topic_silent"),
        (10.0, BEACON, False, "not_received"),
        (60.0, {}, False, "not_received"),
        (60.0, BEACON, True, "not_received"),
    ],
)
def test_a_topic_that_was_received_in_this_run_is_silent_for_a_new_child_too(
    up_s: float, beacons: dict[str, api.BeaconFact], restarted: bool, condition: str
) -> None:
    """PHM has lost the network meanwhile. The child has waited for `ros.grace` and three periods and receives the node; another run of
    the container proves nothing."""
    bench = Bench()
    for _ in range(2):
        bench.evaluate(1.0, beacons=beacons)
        bench.clock.advance(10.0)
    if restarted:
        bench.docker.change("ros_app", started_at="2026-01-02T00:00:00Z")
    result = bench.evaluate(silent_s=None, up_s=up_s, listened_s=400.0)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, condition, "ros_app")


class BlockedTransport:
    """Three topics of three nodes, none of which is received unless a test changes that."""

    def __init__(self) -> None:
        topics = [{"name": f"/agent_1/topic_{n}", "rate": rate} for n, rate in ((1, 1), (2, 10), (3, 0.01))]
        containers = [{"name": "ros_app"}]
        (self.check,) = Rates.build(testing.settings(containers=containers, ros={"topics": topics}))
        self.ros = testing.FakeRos()
        self.silent_s: dict[int, float | None] = {1: None, 2: None, 3: None}
        self.nodes = {1: "node_1", 2: "node_2", 3: "node_3"}
        self.subscribers = {1: "", 2: "", 3: ""}

    def condition(self, **ros: Any) -> str:
        """The condition of topic_1."""
        topics = {
            f"/agent_1/topic_{n}": api.TopicFact(
                (api.EndpointFact(f"/agent_1/{self.nodes[n]}", "std_msgs/msg/String"),),
                (api.EndpointFact(f"/agent_1/{self.subscribers[n]}", "std_msgs/msg/String"),),
                api.RateFact(None, silent_s),
            )
            for n, silent_s in self.silent_s.items()
        }
        self.ros.change(topics=topics, **ros)
        results = self.check.run(testing.world(clock=testing.FakeClock(), ros=self.ros))
        assert not isinstance(results, api.Result)
        return results[UNIT].condition


def test_when_no_data_of_a_container_arrives_the_transport_is_blocked() -> None:
    """Two nodes have been listed for long enough, and not one sample of either was ever received."""
    assert BlockedTransport().condition() == "transport_blocked"


def test_a_publisher_without_node_name_is_behind_a_blocked_transport() -> None:
    """Node names arrive as data; one such publisher is enough."""
    publisher = (api.EndpointFact("", "std_msgs/msg/String"),)
    result = Bench().see(api.TopicFact(publisher, (), api.RateFact(None, None)))
    assert (result.level, result.condition) == (api.Level.ERROR, "transport_blocked")


@pytest.mark.parametrize("others", ["names", "samples"])
def test_a_publisher_without_node_name_does_not_publish_if_other_data_arrive(others: str) -> None:
    """PX4's agent is not a ROS node and never gets a name. Names of other nodes are data, as are samples of another topic."""
    publisher = (api.EndpointFact("", "px4_msgs/msg/SensorGps"),)
    seen = {NAME: api.TopicFact(publisher, (), api.RateFact(None, None))}
    bench = Bench()
    if others == "names":
        bench.ros.change(topics=seen, nodes={"/agent_1/offboard": 1})
    else:
        bench.ros.change(topics={**seen, "/fmu/out/odometry": api.TopicFact(publisher, (), api.RateFact(50.0, 0.1))})
    results = bench.check.run(testing.world(clock=bench.clock, ros=bench.ros))
    assert not isinstance(results, api.Result)
    assert (results[UNIT].level, results[UNIT].condition) == (api.Level.ERROR, "not_received")


def test_one_received_node_clears_the_transport() -> None:
    """Then a topic that never arrived is one that its node does not publish."""
    blocked = BlockedTransport()
    blocked.silent_s[2] = 0.1
    assert blocked.condition() == "not_received"


def test_a_beacon_clears_the_transport() -> None:
    """A beacon is a sample, too."""
    assert BlockedTransport().condition(beacons={"/agent_1/node_2": api.BeaconFact(0.1, 1.0)}) == "not_received"


def test_a_node_that_waits_for_another_is_not_a_second_witness() -> None:
    """A camera that is absent at boot, and its detector."""
    blocked = BlockedTransport()
    blocked.subscribers[1] = "node_2"
    assert blocked.condition() == "not_received"


@pytest.mark.parametrize(
    ("ros", "condition"),
    [
        ({"diagnostics": {"node_2: driver": api.DiagnosticFact(0.5, 0)}}, "transport_blocked"),
        ({"lifecycle": {"/agent_1/node_2": api.AnswerFact("active", served=True)}}, "not_received"),
        (
            {"lifecycle": {"/agent_1/node_2": api.AnswerFact("inactive", served=True, unanswered_s=9.0)}},
            "not_received",
        ),
    ],
    ids=["a status of an unknown node", "an answer", "not active"],
)
def test_an_answer_clears_the_transport(ros: dict[str, Any], condition: str) -> None:
    """It arrives. A node that is not active is not expected to send, and the other one alone is not evidence."""
    assert BlockedTransport().condition(**ros) == condition


def test_a_single_node_may_have_no_data_to_send() -> None:
    """A single node that does not publish does not prove a blocked transport; nor does one that is not due yet."""
    blocked = BlockedTransport()
    blocked.nodes[2] = "node_1"
    assert blocked.condition(up_s=60.0) == "not_received"


def test_a_slow_topic_gets_time() -> None:
    """Three periods of a 0.1 Hz topic are 30 s."""
    bench = Bench(0.1)
    assert bench.evaluate(silent_s=None, up_s=20.0).level is api.Level.STALE
    assert bench.evaluate(silent_s=None, up_s=31.0).condition == "not_received"


def test_restarts_of_the_ros_child_do_not_hide_a_slow_topic_permanently() -> None:
    """It has been awaited long enough; after a restart only discovery gets its grace."""
    bench = Bench(0.01)
    assert bench.evaluate(silent_s=None, up_s=20.0, listened_s=299.0).level is api.Level.STALE
    assert bench.evaluate(silent_s=None, up_s=2.0, listened_s=400.0).level is api.Level.STALE
    assert bench.evaluate(silent_s=None, up_s=20.0, listened_s=400.0).condition == "not_received"


@pytest.mark.parametrize("problem", ["type unknown: x", "ambiguous: 9 publishers", "QoS mismatch: y"])
def test_an_unknown_rate_is_stale(problem: str) -> None:
    """The topic is not at fault, and the text has the reason."""
    result = Bench().evaluate(silent_s=None, problem=problem)
    assert result.level is api.Level.STALE
    assert problem in result.summary


def test_a_rate_still_being_measured_is_stale() -> None:
    """Two samples far enough apart are needed first."""
    assert Bench().evaluate(hz=None).level is api.Level.STALE


@pytest.mark.parametrize(
    ("publishers", "up_s", "level"),
    [(TALKER, 60.0, api.Level.OK), ((), 60.0, api.Level.ERROR), ((), 1.0, api.Level.STALE)],
)
def test_a_latched_topic_is_checked_by_its_publisher_only(
    publishers: tuple[api.EndpointFact, ...], up_s: float, level: api.Level
) -> None:
    """`rate: 0` means published once: silence is normal."""
    assert Bench(0).see(api.TopicFact(publishers), up_s=up_s).level is level


def test_the_text_of_a_latched_topic_has_the_age_of_its_sample() -> None:
    """However old it is."""
    rate = api.RateFact(None, 700.0, samples=1, age_s=700.0)
    result = Bench(0).see(api.TopicFact(KEEPER, (), rate))
    assert (result.level, result.summary) == (api.Level.OK, "agent_1/topic_1: latched, published 12 min ago")


@pytest.mark.parametrize(
    ("publishers", "up_s", "level"),
    [
        (KEEPER, 60.0, api.Level.WARN),
        (KEEPER, 1.0, api.Level.OK),
        (TALKER, 60.0, api.Level.OK),
        (KEEPER + TALKER, 60.0, api.Level.OK),
    ],
)
def test_a_missing_latched_sample_is_a_warning(
    publishers: tuple[api.EndpointFact, ...], up_s: float, level: api.Level
) -> None:
    """PHM must have received it only if the publishers keep it for late subscribers."""
    result = Bench(0).see(api.TopicFact(publishers, (), api.RateFact(None, None)), up_s=up_s)
    assert result.level is level
    assert (result.condition == "not_received") is (level is api.Level.WARN)


def test_a_topic_without_a_sampler_is_stale() -> None:
    """The child has not subscribed to it yet."""
    assert Bench().see(api.TopicFact(TALKER)).level is api.Level.STALE


def test_without_a_snapshot_every_rate_is_stale() -> None:
    """A dead ROS child process is PHM's own problem."""
    bench = Bench()
    bench.ros.fail("the ROS child is silent")
    assert bench.see(api.TopicFact()).level is api.Level.STALE


def test_a_rate_depends_on_its_topic() -> None:
    """A topic that is not connected is reported once."""
    (unit,) = Bench().check.units
    assert unit.needs == ("topics/agent_1/topic_1",)
    assert unit.settle_s == 2.0
