"""Slot 8: rules of the rates check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.rates import CONFIRM_S, Rates

NAME = "/agent_1/topic_1"
UNIT = "rates/agent_1/topic_1"
TALKER = (api.EndpointFact("/agent_1/node_1", "std_msgs/msg/String"),)


class Bench:
    """One topic with a rate, with the fakes at hand."""

    def __init__(self, rate: float | str = 1.0, **topic: Any) -> None:
        settings = testing.settings(
            containers=[{"name": "ros_app"}], ros={"topics": [{"name": NAME, "rate": rate, **topic}]}
        )
        (self.check,) = Rates.build(settings)
        self.clock, self.ros = testing.FakeClock(), testing.FakeRos()

    def judge(self, hz: float | None = None, silent_s: float | None = 0.1, problem: str = "", **ros: Any) -> api.Result:
        rate = api.RateFact(hz, silent_s, window_s=5.0, samples=5, problem=problem)
        return self.see(api.TopicFact(TALKER, (), rate), **ros)

    def see(self, fact: api.TopicFact, **ros: Any) -> api.Result:
        self.ros.change(topics={NAME: fact}, **ros)
        results = self.check.run(testing.world(clock=self.clock, ros=self.ros))
        assert not isinstance(results, api.Result)
        return results[UNIT]

    def twice(self, hz: float) -> api.Result:
        """Two measurements a second apart; the second one decides."""
        self.judge(hz)
        self.clock.advance(CONFIRM_S + 0.1)
        return self.judge(hz)


def test_topics_without_a_rate_have_no_unit() -> None:
    """Their flow is not judged."""
    assert list(Rates.build(testing.settings(ros={"topics": [{"name": NAME}]}))) == []


def test_the_expected_rate_is_ok() -> None:
    """Within the tolerance, limits included, in the manner of the paper's log."""
    bench = Bench()
    assert bench.judge(0.999).summary == "agent_1/topic_1: 0.999"
    assert bench.judge(1.1).level is api.Level.OK
    assert bench.judge(0.9).level is api.Level.OK


@pytest.mark.parametrize(("rate", "limit_s"), [(10.0, 3.0), (0.1, 30.0)])
def test_the_memory_of_a_topic_is_longer_than_its_silence(rate: float, limit_s: float) -> None:
    """A topic that fell silent at a restart is found OK until then, which must not end its grace."""
    bench = Bench(rate)
    assert bench.judge(rate, silent_s=limit_s).level is api.Level.OK
    assert bench.judge(rate, silent_s=limit_s + 0.1).condition == "silent"
    (unit,) = bench.check.units
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
def test_a_rate_outside_the_tolerance_is_told(hz: float, level: api.Level, condition: str) -> None:
    """Off by more than the tolerance is WARN, by more than twice that ERROR."""
    result = Bench().twice(hz)
    assert (result.level, result.condition, result.target) == (level, condition, "ros_app")
    assert result.brief == f"topic_1 {hz:g} Hz, not 1"


def test_one_measurement_outside_is_not_told() -> None:
    """What was told before stands until a second measurement agrees; an early second look is none."""
    bench = Bench()
    bench.judge(1.0)
    assert bench.judge(0.5).level is api.Level.OK
    bench.clock.advance(0.1)
    assert bench.judge(0.5).level is api.Level.OK
    bench.clock.advance(1.0)
    assert bench.judge(1.0).level is api.Level.OK
    assert bench.judge(0.5).level is api.Level.OK


def test_a_first_measurement_outside_is_not_known_yet() -> None:
    """Nothing was told before that could stand."""
    assert Bench().judge(0.5).level is api.Level.STALE


def test_a_rate_at_the_limit_does_not_flap() -> None:
    """A level is left only well inside its limit."""
    bench = Bench()
    assert bench.twice(0.85).level is api.Level.WARN
    levels = [bench.judge(hz).level for hz in (0.905, 0.895, 0.905, 0.895)]
    assert set(levels) == {api.Level.WARN}
    assert bench.judge(0.95).level is api.Level.OK


def test_a_jittering_rate_keeps_its_brief() -> None:
    """The number in the brief changes only when the rate does."""
    bench = Bench()
    bench.twice(0.5)
    assert {bench.judge(hz).brief for hz in (0.51, 0.49, 0.5, 0.53)} == {"topic_1 0.5 Hz, not 1"}


@pytest.mark.parametrize(
    ("rate", "silent_s", "silent"),
    [
        ("1Hz", 2.9, False),
        ("1Hz", 3.1, True),
        ("200Hz", 2.9, False),
        ("200Hz", 3.1, True),
        (0.1, 29.0, False),
        (0.1, 31.0, True),
    ],
)
def test_silence_is_longer_than_three_periods_and_the_configured_least(
    rate: float | str, silent_s: float, silent: bool
) -> None:
    """Slow topics get three periods, fast ones `ros.silence`."""
    bench = Bench(rate)
    result = bench.judge(
        hz=testing.settings(ros={"topics": [{"name": NAME, "rate": rate}]}).ros.topics[0].rate, silent_s=silent_s
    )
    assert (result.condition == "silent") is silent
    if silent:
        assert (result.level, result.brief) == (api.Level.ERROR, "topic_1 silent")


def test_a_topic_never_received_is_an_error() -> None:
    """Listed but not one sample: another fault than silence, often the transport."""
    result = Bench().judge(silent_s=None)
    assert (result.level, result.condition) == (api.Level.ERROR, "not_received")
    assert "FASTDDS_BUILTIN_TRANSPORTS" in result.summary


def test_a_slow_topic_is_waited_for() -> None:
    """Three periods of a 0.1 Hz topic are 30 s."""
    bench = Bench(0.1)
    assert bench.judge(silent_s=None, up_s=20.0).level is api.Level.STALE
    assert bench.judge(silent_s=None, up_s=31.0).condition == "not_received"


@pytest.mark.parametrize("problem", ["type unknown", "ambiguous"])
def test_a_rate_that_cannot_be_told_is_stale(problem: str) -> None:
    """No fault of the topic, and the reason is said."""
    result = Bench().judge(silent_s=None, problem=problem)
    assert result.level is api.Level.STALE
    assert problem in result.summary


def test_a_rate_still_being_measured_is_stale() -> None:
    """Two samples far enough apart have to be seen first."""
    assert Bench().judge(hz=None).level is api.Level.STALE


@pytest.mark.parametrize(
    ("publishers", "up_s", "level"),
    [(TALKER, 60.0, api.Level.OK), ((), 60.0, api.Level.ERROR), ((), 1.0, api.Level.STALE)],
)
def test_a_latched_topic_is_judged_by_its_publisher_alone(
    publishers: tuple[api.EndpointFact, ...], up_s: float, level: api.Level
) -> None:
    """`rate: 0` means published once: silence is normal."""
    assert Bench(0).see(api.TopicFact(publishers), up_s=up_s).level is level


def test_a_topic_without_a_sampler_is_stale() -> None:
    """The child has not got to it yet."""
    assert Bench().see(api.TopicFact(TALKER)).level is api.Level.STALE


def test_no_picture_makes_every_rate_stale() -> None:
    """A dead ROS child is PHM's trouble."""
    bench = Bench()
    bench.ros.fail("the ROS child is silent")
    assert bench.see(api.TopicFact()).level is api.Level.STALE


def test_a_rate_needs_its_topic() -> None:
    """A topic that is not connected is told once."""
    (unit,) = Bench().check.units
    assert unit.needs == ("topics/agent_1/topic_1",)
    assert unit.settle_s == 2.0
