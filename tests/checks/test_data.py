"""Slot 8: rules of the check of messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm.core.model import FaultOpened
from phm.probes.ros.data.publisher_data import Examined, PublisherData
from phm.probes.ros.protocol import WantedData
from phm.recovery.verification import Verification, VerificationResult
from phm.tracker import TrackedUnit, Tracker, graph_of
from phm_checks.data import SETTLE_S, Data
from tests.recovery.test_verification import Silent

NAME = "/agent_1/odom"
UNIT = "data/agent_1/odom"
FLOWING = api.RateFact(10.0, 0.1)
LIMITS = {
    "max_age": "500ms",
    "order": True,
    "frozen": "2s",
    "counter": "seq",
    "gaps": "5%",
    "ranges": {"twist.linear.x": [-5, 5], "level": [0, None]},
}


class Bench:
    """One topic whose messages are examined, and the fakes it needs."""

    def __init__(self, **data: Any) -> None:
        settings = testing.settings(
            containers=[{"name": "ros_app"}],
            ros={"topics": [{"name": NAME, "rate": 10, "data": data or LIMITS}]},
        )
        (self.check,) = Data.build(settings)
        self.ros = testing.FakeRos()

    def see(self, *conditions: str, samples: int = 9, rate: api.RateFact = FLOWING, **data: Any) -> api.Result:
        fact = api.DataFact(conditions, samples, **data)
        return self.evaluate(api.TopicFact((), (), rate, fact))

    def evaluate(self, fact: api.TopicFact, **ros: Any) -> api.Result:
        self.ros.change(topics={NAME: fact, **ros.pop("topics", {})}, **ros)
        results = self.check.run(testing.world(ros=self.ros))
        assert not isinstance(results, api.Result)
        return results[UNIT]


def test_topics_without_data_have_no_unit() -> None:
    """Their messages are not examined."""
    assert list(Data.build(testing.settings(ros={"topics": [{"name": NAME, "rate": 10}]}))) == []


def test_a_unit_needs_the_rate_of_its_topic() -> None:
    """A silent topic, its dead node or its container are one alarm each, and not another one here."""
    (unit,) = Bench().check.units
    assert (unit.id, unit.needs, unit.target) == (UNIT, ("rates/agent_1/odom",), "ros_app")


def test_messages_within_their_limits_are_ok() -> None:
    """The summary says what was checked."""
    result = Bench().see(age_s=0.012, lost_percent=0.0)
    assert result.level is api.Level.OK
    expected = "agent_1/odom: stamps 12 ms old, in order, content changes, 0 % lost, values within their ranges"
    assert result.summary == expected and result.values["samples"] == 9


@pytest.mark.parametrize(
    ("age_s", "brief", "words"),
    [
        (
            0.8,
            "odom stamp 0.8 s old",
            "0.8 s old, allowed is 0.5 s: its messages wait before they are published, or the clock",
        ),
        (3600.0, "odom stamp 60 min old", "its stamps are 60 min old, allowed is 0.5 s"),
        (-3600.0, "odom stamp 60 min ahead", "60 min in the future, allowed is 0.5 s: the clock of its source differs"),
        (20 * 86400.0, "odom stamp 20 d old", "its stamps are 20 d old"),
    ],
)
def test_a_wrong_stamp_is_an_error(age_s: float, brief: str, words: str) -> None:
    """With how far it is off, and in which direction."""
    result = Bench().see("data_stamp", age_s=age_s)
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "data_stamp", brief)
    assert words in result.summary and "check time synchronization" in result.summary


def test_only_a_small_age_can_be_due_to_starvation() -> None:
    """A publisher that waits for a CPU is late by seconds, not by an hour, and never early."""
    conclusive = [Bench().see("data_stamp", age_s=age_s).evidence.conclusive for age_s in (3.0, 3600.0, -3.0)]
    assert conclusive == [False, True, True]


def test_a_stamp_that_is_not_set_is_named() -> None:
    """Not as an age of decades."""
    result = Bench().see("data_stamp", age_s=1.7e9, unset=True)
    assert result.brief == "odom stamp not set" and "header.stamp is not set (0)" in result.summary


@pytest.mark.parametrize("where", ["topics", "others"])
def test_with_simulated_time_the_age_cannot_be_judged(where: str) -> None:
    """Whether /clock is configured or not; other limits count, and a correct age is OK."""
    publisher = api.EndpointFact("/sim", "rosgraph_msgs/msg/Clock")
    clock: dict[str, Any] = {
        "topics": {"topics": {"/clock": api.TopicFact((publisher,))}},
        "others": {"others": {"/clock": api.NameFact(("/sim",))}},
    }
    bench = Bench()
    wrong = api.TopicFact((), (), FLOWING, api.DataFact(("data_stamp",), 9, age_s=1e9))
    result = bench.evaluate(wrong, **clock[where])
    assert result.level is api.Level.STALE and "/clock is published" in result.summary
    both = api.TopicFact((), (), FLOWING, api.DataFact(("data_stamp", "data_frozen"), 9, age_s=1e9, frozen_s=3.0))
    assert bench.evaluate(both, **clock[where]).condition == "data_frozen"
    fine = api.TopicFact((), (), FLOWING, api.DataFact((), 9, age_s=0.1))
    assert bench.evaluate(fine, **clock[where]).level is api.Level.OK


def test_stamps_that_go_back_once_are_a_warning() -> None:
    """A clock that was set; repeatedly, messages are out of order."""
    once = Bench().see("data_order", backs=1, back_s=0.04)
    assert (once.level, once.condition, once.brief) == (api.Level.WARN, "data_stamp", "odom stamps go back")
    assert "by 40 ms: the clock of its source was set" in once.summary
    again = Bench().see("data_order", backs=3, back_s=0.04)
    assert again.level is api.Level.ERROR and "3 times in the last messages examined" in again.summary


def test_frozen_content_is_an_error() -> None:
    """At the right rate, so no other check finds it; starvation cannot be its cause."""
    result = Bench().see("data_frozen", frozen_s=2.5)
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "data_frozen", "odom frozen")
    assert "the same content for 2.5 s, allowed is 2 s" in result.summary and result.evidence.conclusive


def test_a_value_out_of_range_is_an_error() -> None:
    """With each field, its value, which may be NaN, and its limits; of the brief, only the last part of the field."""
    found = (api.OutsideFact("twist.linear.x", "nan"), api.OutsideFact("level", "-1"))
    result = Bench().see("data_range", outside=found)
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "data_range", "odom x out of range")
    assert "twist.linear.x is nan, allowed is -5 to 5; level is -1, allowed is 0 or more" in result.summary
    assert result.values["outside"] == "twist.linear.x=nan, level=-1"


@pytest.mark.parametrize(("lost", "level"), [(7.0, api.Level.WARN), (50.0, api.Level.ERROR)])
def test_gaps_are_a_warning_and_from_twice_the_limit_an_error(lost: float, level: api.Level) -> None:
    """They wait for the rate: if it is low, it is the cause."""
    result = Bench().see("data_gaps", lost_percent=lost)
    assert (result.level, result.condition, result.settle_s) == (level, "data_gaps", SETTLE_S)
    assert f"{lost:.0f} % of the numbers in seq are missing, allowed is 5 %" in result.summary


def test_several_findings_are_one_result() -> None:
    """The worst one decides, the others follow in its text."""
    result = Bench().see("data_gaps", "data_frozen", lost_percent=7.0, frozen_s=3.0)
    assert result.condition == "data_frozen" and "7 % of the numbers" in result.summary


def test_a_mistake_in_the_configuration_is_not_a_fault_of_the_vehicle() -> None:
    """It is named, and the unit is not OK; what can be examined is."""
    problem = "geometry_msgs/Twist has no field 'foo'; it has linear, angular"
    result = Bench().see(problem=problem)
    assert result.level is api.Level.STALE
    assert f"ros.topics[0].data cannot be examined completely: {problem}" in result.summary
    result = Bench().see("data_frozen", problem=problem, frozen_s=3.0)
    assert result.condition == "data_frozen" and problem in result.summary


@pytest.mark.parametrize("rate", [api.RateFact(0.0, 5.0), api.RateFact(None, None, problem="ambiguous: 9 publishers")])
def test_a_topic_without_messages_is_not_judged(rate: api.RateFact) -> None:
    """The last ones received say nothing about the present; its rate is the fault."""
    result = Bench().see("data_frozen", frozen_s=3.0, rate=rate)
    assert result.level is api.Level.STALE and "no messages to examine" in result.summary


def test_before_two_messages_nothing_is_known() -> None:
    """Also without any, and without the ROS child process."""
    bench = Bench()
    assert bench.see(samples=1).level is api.Level.STALE
    assert bench.evaluate(api.TopicFact()).level is api.Level.STALE
    bench.ros.fail("the ROS child has not been started yet")
    assert bench.evaluate(api.TopicFact()).summary == "the ROS child has not been started yet"


def test_texts_from_outside_are_cleaned() -> None:
    """Values and problems contain received data."""
    result = Bench().see("data_range", outside=(api.OutsideFact("level", "1\n\x1b[31m"),), problem="a\nb")
    assert "\n" not in result.summary and "\x1b" not in result.summary


def test_content_that_has_not_changed_yet_does_not_end_a_fault() -> None:
    """After a restart of the container or of the ROS child process two equal messages are no recovery; waiting decides."""
    bench, publisher = Bench(frozen="60s"), PublisherData(WantedData(frozen_s=60.0))
    units = [TrackedUnit(unit, Data.name, Data.slot, Data.layer) for unit in bench.check.units]
    clock = testing.FakeClock()
    tracker = Tracker(units, graph_of(units), clock.stamp())
    opened = 0

    def see(fact: api.DataFact) -> api.Result:
        nonlocal opened
        result = bench.evaluate(api.TopicFact((), (), FLOWING, replace(fact, samples=9)))
        events = [
            *tracker.observe(UNIT, result, clock.mono(), clock.stamp()).events,
            *tracker.tick(clock.stamp()).events,
        ]
        opened += sum(isinstance(event, FaultOpened) for event in events)
        clock.advance(1.0)
        return result

    for _ in range(60):
        see(api.DataFact())
    for _ in range(3):
        see(api.DataFact(("data_frozen",), frozen_s=61.0))
    for number in range(61):
        publisher.add(Examined(float(number), number + 1, content=b"same"))
        result = see(publisher.fact())
        if number == 1:
            assert result.level is api.Level.STALE and "the content has not changed yet" in result.summary
            assert result.decides_s == 60.0
    assert result.condition == "data_frozen" and opened == 1
    publisher.add(Examined(61.0, 62, content=b"other"))
    assert see(publisher.fact()).level is api.Level.OK and not tracker.open_faults()


def test_a_restart_that_leaves_the_content_frozen_has_failed() -> None:
    """So it counts as an attempt, and PHM does not restart the container endlessly."""

    class Frozen(Silent):
        def newest(self, unit: str, mono: float) -> api.Result:
            bench = Bench(frozen="60s")
            early = self.started < 60.0
            return bench.see(undecided=("data_frozen",)) if early else bench.see("data_frozen", frozen_s=60.0)

    verification = Verification(UNIT, 0.0, 2.0, 30.0, lambda unit: 10.0)
    assert verification.result(Frozen(59.0), 59.0) is None
    assert verification.result(Frozen(61.0), 61.0) == VerificationResult(missing=UNIT)
