"""When a topic counts as silent: the rule, and its result on recorded traces."""

from __future__ import annotations

import pytest

from phm.core.settings import RosSettings
from phm.probes.ros.rates import silence
from phm.probes.ros.rates.estimator import RateEstimator
from phm.probes.ros.rates.silence import LEAST, LOST_MOST_S, SilenceTimeout, WindowedMax
from phm.probes.ros.wanted import wanted
from phm_checks import rates
from tests.fakes.ros_flow import TICK_S, Publication, even, polls, silent_from, trace

CONFIGURED_S = 3.0
SETTLE_S = 2.0
"""`settle_s` of the rates check: a shorter silence is not published."""
PHASES = (0.0, 0.06, 0.12, 0.19)
"""Polls may fall anywhere between two publications."""


def silences(name: str, phase_s: float) -> tuple[list[float], float]:
    """For the trace followed by silence: when silence was reported during the trace, and how long after its last
    publication.
    """
    recorded = trace(name)
    meter = RateEstimator(round(recorded.hz, 1), CONFIGURED_S)
    began = silent_from(meter, recorded.publications, phase_s - 1.0, recorded.end_s + 5.0)
    early = [at_s for at_s in began if at_s <= recorded.end_s]
    (detected_s,) = [at_s for at_s in began if at_s > recorded.end_s]
    return early, detected_s - recorded.publications[-1].published_s


@pytest.mark.parametrize("phase_s", PHASES)
def test_a_steady_topic_of_1_hz_is_silent_within_2_seconds(phase_s: float) -> None:
    """45 minutes of a real 1 Hz timer: no false alarm, and its end is detected a second before the configured 3 s."""
    early, after_s = silences("steady", phase_s)
    assert early == []
    assert after_s <= 2.0


@pytest.mark.parametrize("phase_s", PHASES)
@pytest.mark.parametrize("name", ["lognormal", "bursty"])
def test_an_uneven_topic_gets_a_longer_timeout(name: str, phase_s: float) -> None:
    """45 minutes of pauses of up to 2.7 s: no false alarm; its end is detected after the configured 3 s and one poll."""
    early, after_s = silences(name, phase_s)
    assert early == []
    assert after_s <= CONFIGURED_S + 2 * TICK_S


@pytest.mark.parametrize("phase_s", PHASES)
def test_a_first_stall_is_not_published(phase_s: float) -> None:
    """A steady topic pauses for up to 2.7 s once in a while: the first pause may count as silence, for less than
    settle_s, and from then on the timeout covers such pauses.
    """
    recorded = trace("stalling")
    meter = RateEstimator(1.0, CONFIGURED_S)
    silent_s, spans = 0.0, []
    for now_s, samples in polls(recorded.publications, phase_s - 1.0, recorded.end_s):
        if meter.update(now_s, samples).hz == 0.0:
            silent_s += TICK_S
        elif silent_s:
            spans.append(silent_s)
            silent_s = 0.0
    assert len(spans) <= 3
    assert all(span_s < SETTLE_S for span_s in spans)


@pytest.mark.parametrize("phase_s", PHASES)
def test_a_fast_topic_on_a_busy_machine_is_silent_after_a_second_or_two(phase_s: float) -> None:
    """10 Hz while other processes use all cores: no false alarm, and no need for 3 s."""
    early, after_s = silences("fast", phase_s)
    assert early == []
    assert after_s <= 2.0


@pytest.mark.parametrize("phase_s", PHASES)
@pytest.mark.parametrize("late_s", [0.0, 0.4])
@pytest.mark.parametrize("period_s", [2.0, 3.0, 4.0, 5.0, 10.0, 30.0, 60.0])
def test_one_missing_message_of_a_slow_topic_is_not_published(period_s: float, late_s: float, phase_s: float) -> None:
    """After 40 regular ones, some of them late: it may count as silence, for less than settle_s."""
    times = [number * period_s + (late_s if number % 5 == 0 else 0.0) for number in range(44) if number != 41]
    publications = [Publication(at_s, at_s, number) for number, at_s in enumerate(times)]
    meter = RateEstimator(1 / period_s, CONFIGURED_S)
    silent_s = 0.0
    for now_s, samples in polls(publications, phase_s - 1.0, times[-1] + 1.0):
        silent_s = silent_s + TICK_S if meter.update(now_s, samples).hz == 0.0 else 0.0
        assert silent_s < SETTLE_S


def test_the_end_of_a_slow_topic_is_reported_before_three_periods() -> None:
    """A message may be missing, not two: the configured limit alone would be three periods."""
    for period_s in (5.0, 10.0, 60.0):
        limit_s = fed(1 / period_s, [period_s] * 100, 3 * period_s).limit_s
        assert limit_s + SETTLE_S == pytest.approx(2 * period_s + 0.5)


@pytest.mark.parametrize(("least_s", "limit_s"), [(0.0, 1.5), (60.0, 60.0), (3.0, 3.0), (1.0, 1.5)])
def test_the_silence_of_a_topic_is_never_lowered(least_s: float, limit_s: float) -> None:
    """A user who sets `silence: 60s` for one topic expects pauses that it has not made yet."""
    timeout = SilenceTimeout(1.0, max(3.0, least_s), least_s)
    for second in range(100):
        timeout.ended(1.0, float(second))
    assert timeout.limit_s == pytest.approx(limit_s)


def test_the_sampler_knows_which_silence_is_a_topics_own() -> None:
    """`ros.silence` holds for all topics and may be lowered."""
    topics = [{"name": "/a/photo", "rate": 1, "silence": "60s"}, {"name": "/a/scan", "rate": 10}]
    found = wanted(RosSettings.model_validate({"silence": "5s", "topics": topics}), "agent_1").topics
    assert [(topic.silence_s, topic.least_silence_s) for topic in found] == [(60.0, 60.0), (5.0, 0.0)]


def test_the_check_settles_for_as_long_as_the_limit_assumes() -> None:
    """Both together are longer than two periods."""
    assert SETTLE_S == silence.SETTLE_S == rates.SETTLE_S


def test_the_traces_are_long_and_real() -> None:
    """The tests above are only as good as the recordings."""
    assert all(trace(name).end_s > 2400 for name in ("steady", "lognormal", "bursty", "stalling"))
    assert trace("fast").end_s > 120


def fed(hz: float, pauses: list[float], most_s: float = 3.0, every_s: float | None = None) -> SilenceTimeout:
    timeout = SilenceTimeout(hz, most_s)
    for number, pause_s in enumerate(pauses):
        timeout.ended(pause_s, number * (every_s or 1 / hz))
    return timeout


def test_the_configured_limit_holds_until_enough_was_seen() -> None:
    """Twenty pauses, over at least fifteen seconds."""
    assert fed(1.0, [1.0] * (LEAST - 1)).limit_s == 3.0
    assert fed(1.0, [1.0] * LEAST).limit_s == pytest.approx(1.5)
    assert fed(10.0, [0.0] * LEAST).limit_s == 3.0


@pytest.mark.parametrize(
    ("hz", "pauses", "limit_s"),
    [
        (10.0, [0.0] * 200, 1.0),
        (1.0, [1.0] * 100, 1.5),
        (0.1, [10.0] * 100, 18.5),
        (1.5, [0.67] * 100, 1 / 1.5 + 0.5),
        (1.0, [1.0, 1.4] * 50, 1.4 + 0.5),
        (1.0, [1.0, 1.0, 1.0, 1.5] * 25, 1.5 + 2 * 0.375),
        (1.0, [1.0, 1.0, 2.9] * 50, 3.0),
        (1.0, [2.0] * 100, 2.5),
    ],
)
def test_the_limit_follows_the_longest_pause(hz: float, pauses: list[float], limit_s: float) -> None:
    """The longest pause plus twice its excess over the usual one, plus at least half a second; never below 1 s or 1.5
    periods, never above the configured value. A publisher at half its rate is slow, not silent.
    """
    most_s = max(3.0, 3 / hz)
    assert fed(hz, pauses, most_s).limit_s == pytest.approx(limit_s, rel=0.05)


def test_a_silence_does_not_extend_the_timeout() -> None:
    """A gap longer than the configured limit is not a pause of a working topic."""
    assert fed(1.0, [1.0] * 50 + [60.0] + [1.0] * 5).limit_s == pytest.approx(1.5)


def test_a_pause_is_forgotten_after_ten_minutes() -> None:
    """One stall does not delay detection permanently."""
    assert fed(1.0, [1.0] * 50 + [2.5] + [1.0] * 500).limit_s == 3.0
    assert fed(1.0, [1.0] * 50 + [2.5] + [1.0] * 700).limit_s == pytest.approx(1.5)


LOST_HZ, EVERY = 30.0, 200
"""PHM receives each 200th message: one in 6.7 s."""


def lossy(seconds: float, size: int = 6_200_000) -> list[Publication]:
    return even(LOST_HZ, 0.0, seconds, size=size)[EVERY - 1 :: EVERY]


def test_messages_that_only_phm_misses_are_not_a_silence() -> None:
    """Large ones, of which a packet is lost. The sequence numbers show that the publisher never paused; its end is still found."""
    meter, received = RateEstimator(LOST_HZ, CONFIGURED_S), lossy(120.0)
    third_s, end_s = received[2].received_s, received[-1].received_s
    began = silent_from(meter, received, 0.0, end_s + 20.0)
    assert [at_s for at_s in began if third_s < at_s <= end_s] == []
    assert 12.0 < began[-1] - end_s < 14.0


def test_only_large_messages_are_lost_on_the_way() -> None:
    """After an interruption of the network the numbers of small ones have advanced, too, and an end must be found as before."""
    meter = RateEstimator(LOST_HZ, CONFIGURED_S)
    assert len(silent_from(meter, lossy(120.0, size=1000), 0.0, 120.0)) > 10


def test_a_publisher_that_pauses_is_silent_each_time() -> None:
    """Its numbers have not advanced meanwhile."""
    meter, received = RateEstimator(LOST_HZ, CONFIGURED_S), list[Publication]()
    for start in range(10):
        received += even(LOST_HZ, 10.0 * start, 3.0, first=1 + 90 * start, size=6_200_000)
    assert len(silent_from(meter, received, 0.0, 100.0)) == 10


def test_lost_messages_are_forgotten_and_never_hide_the_end() -> None:
    """Within two minutes; and after a long interruption the end of a publisher is found after 30 s."""
    timeout = SilenceTimeout(LOST_HZ, CONFIGURED_S)
    timeout.disproved(60.0, -20.0)
    assert timeout.limit_s == CONFIGURED_S, "one interruption of the network"
    timeout.disproved(60.0, 0.0)
    assert timeout.limit_s == LOST_MOST_S
    for second in range(1, 140):
        timeout.ended(0.0, float(second))
    assert timeout.limit_s < CONFIGURED_S


def test_a_windowed_maximum_forgets_old_values() -> None:
    """A value is kept for the given time, plus at most a tenth."""
    recent = WindowedMax(10.0)
    assert recent.most is None
    recent.add(5.0, 0.0)
    for second in range(1, 11):
        recent.add(1.0, float(second))
        assert recent.most == 5.0
    recent.add(1.0, 11.0)
    assert recent.most == 1.0
    recent.clear()
    assert recent.most is None
