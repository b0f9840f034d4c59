"""A large topic, to which PHM subscribes only for a moment: its publisher may publish only while there is a subscription."""

from __future__ import annotations

import random
from typing import Any

import pytest

from phm.facts.ros import EndpointFact, RateFact
from phm.probes.ros.protocol import WantedTopic
from phm.probes.ros.rates import topic_monitor
from phm.probes.ros.rates.publisher_stats import Sample
from phm.probes.ros.rates.topic_monitor import TopicMonitor
from phm.probes.ros.reader import SubscriptionQos

TICK_S, MATCH_S = 0.25, 0.1
EXPECTED_HZ = 30.0


class Camera:
    """A publisher of 6 MB/s. others: whether anyone but PHM subscribes. lazy: it publishes only while anyone does. stalls: it
    publishes nothing for half of the time in which PHM does not subscribe. uneven: its periods differ by up to this share.
    keeps: each new subscription receives its last message."""

    def __init__(
        self, name: str, *, lazy: bool, hz: float = EXPECTED_HZ, uneven: float = 0.0, keeps: bool = False, seed: int = 0
    ) -> None:
        self.name, self.lazy, self.hz, self.others = name, lazy, hz, False
        self.uneven, self.keeps = uneven, keeps
        self.stalls = False
        self.sent: list[tuple[float, int]] = []
        self._due_s, self._count = 100.0, 0
        self._random = random.Random(seed)

    def restart(self) -> None:
        """Its sequence numbers begin again."""
        self._count = 0

    def run(self, now_s: float, subscribed_from_s: float | None) -> None:
        while self._due_s <= now_s:
            subscribed = subscribed_from_s is not None and self._due_s >= subscribed_from_s + MATCH_S
            stalled = self.stalls and subscribed_from_s is None and self._due_s % 1.0 < 0.5
            if not stalled and (not self.lazy or self.others or subscribed):
                self._count += 1
                self.sent.append((self._due_s, self._count))
            self._due_s += (1 + self._random.uniform(-self.uneven, self.uneven)) / self.hz

    def since(self, at_s: float, *, kept: bool) -> list[tuple[float, int]]:
        """What it published after this time. kept: and the last message before it."""
        recent = self.sent[-100:]
        first = next((index for index, (sent_s, _) in enumerate(recent) if sent_s > at_s), len(recent))
        return recent[max(0, first - 1) if kept else first :]


class Bench:
    """The monitor of the topic of these cameras. named: the middleware names the publisher of each sample. rated: whether a rate is
    expected, that of the cameras."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, *cameras: Camera, named: bool = False, rated: bool = True
    ) -> None:
        self.now_s = 100.0
        self.cameras = cameras
        self.open_from_s: float | None = None
        self.open_ticks = 0
        bench = self

        class CameraReader:
            def __init__(self, node: Any, topic: str, type_name: str, qos: SubscriptionQos, *, keep: bool) -> None:
                self.qos, self.matched, self.messages = qos, None, ()
                self._taken_s = bench.open_from_s = bench.now_s
                self._size = int(6e6 / min(camera.hz for camera in bench.cameras))
                self._new = qos.latched

            def take(self, now_s: float) -> list[Sample]:
                since_s = max(self._taken_s, (bench.open_from_s or 0.0) + MATCH_S)
                kept, self._new = self._new, False
                queue = sorted(
                    (at_s, number, camera.name)
                    for camera in bench.cameras
                    for at_s, number in camera.since(since_s, kept=kept and camera.keeps)
                )
                self._taken_s = now_s
                return [
                    Sample(number, int(at_s * 1e9), now_s, name.encode() if named else None, self._size)
                    for at_s, number, name in queue[-self.qos.depth :]
                ]

            def close(self) -> None:
                bench.open_from_s = None

        monkeypatch.setattr(topic_monitor, "Reader", CameraReader)
        expected_hz = sum(camera.hz for camera in cameras) if rated else 0.0
        self.monitor = TopicMonitor(None, WantedTopic("/a/image", expected_hz))

    def run(self, seconds: float) -> list[RateFact]:
        facts = []
        for _ in range(int(seconds / TICK_S)):
            self.now_s += TICK_S
            for camera in self.cameras:
                camera.run(self.now_s, self.open_from_s)
            ends = tuple(map(end, self.cameras))
            facts.append(self.monitor.poll(self.now_s, ends))
            self.open_ticks += self.open_from_s is not None
        return facts


def end(camera: Camera) -> EndpointFact:
    durability = "transient_local" if camera.keeps else "volatile"
    return EndpointFact(camera.name, "sensor_msgs/msg/Image", "reliable", durability)


def all_right(facts: list[RateFact], hz: float) -> bool:
    return all(fact.hz is None or fact.hz == pytest.approx(hz, rel=0.1) for fact in facts)


@pytest.mark.parametrize("hz", [EXPECTED_HZ, 4.7, 2.3, 1.1, 0.7])
def test_a_publisher_that_needs_a_subscription_has_its_rate(monkeypatch: pytest.MonkeyPatch, hz: float) -> None:
    """Its numbers do not advance during the pauses, which once was a low rate."""
    bench = Bench(monkeypatch, Camera("/a/camera", lazy=True, hz=hz))
    facts = bench.run(120.0)
    assert all_right(facts, hz)
    assert all(fact.hz is not None for fact in facts[40:])
    if hz == EXPECTED_HZ:
        assert bench.open_ticks < 0.6 * len(facts)


def test_the_end_of_the_last_other_subscription_is_not_a_low_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """At any time of a pause; and the rate is known as before when there is one again."""
    camera = Camera("/a/camera", lazy=True)
    bench = Bench(monkeypatch, camera)
    for _ in range(12):
        camera.others = True
        facts = bench.run(15.0)
        camera.others = False
        facts += bench.run(13.25)
        assert all_right(facts, EXPECTED_HZ)


@pytest.mark.parametrize("phase", range(12))
def test_a_restarted_publisher_without_an_expected_rate_is_received(
    monkeypatch: pytest.MonkeyPatch, phase: int
) -> None:
    """E.g. a topic of `ready`: after the restart there is neither a measured nor an expected rate to compare a pause with."""
    camera = Camera("/a/camera", lazy=True)
    bench = Bench(monkeypatch, camera, rated=False)
    bench.run(30.0 + phase * TICK_S)
    camera.restart()
    assert_received(bench.run(30.0))


@pytest.mark.parametrize(("hz", "uneven"), [(1.0, 0.3), (0.5, 0.1), (1.0, 0.6), (5.0, 0.5)])
@pytest.mark.parametrize("keeps", [True, False])
def test_an_uneven_topic_without_an_expected_rate_is_received(
    monkeypatch: pytest.MonkeyPatch, hz: float, uneven: float, *, keeps: bool
) -> None:
    """Such as a latched map, whose last message each new subscription receives again."""
    for seed in range(4):
        camera = Camera("/a/slam", lazy=False, hz=hz, uneven=uneven, keeps=keeps, seed=seed)
        assert_received(Bench(monkeypatch, camera, rated=False).run(150.0)[12:])


def assert_received(facts: list[RateFact]) -> None:
    """It is received again after each pause, with at most two periods of a slow one."""
    assert all(fact.silent_s is not None and fact.silent_s < 7.0 and not fact.problem for fact in facts)
    assert facts[-1].samples > facts[0].samples


def test_a_restarted_publisher_does_not_get_a_rate_from_long_ago(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rate that was kept while another one was measured."""
    camera = Camera("/a/camera", lazy=True)
    bench = Bench(monkeypatch, camera)
    bench.run(30.0)
    camera.others, camera.hz = True, EXPECTED_HZ / 2
    facts = bench.run(60.0)[-4:]
    camera.restart()
    assert all_right(facts + bench.run(10.0), EXPECTED_HZ / 2)


def test_a_rate_that_really_falls_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the rate is reported within two windows, then measured across the pauses again."""
    camera = Camera("/a/camera", lazy=False)
    bench = Bench(monkeypatch, camera)
    bench.run(30.0)
    camera.hz = EXPECTED_HZ / 2
    facts = bench.run(30.0)
    assert all_right(facts[28:], EXPECTED_HZ / 2)
    bench.open_ticks = 0
    facts = bench.run(30.0)
    assert all(fact.hz is not None for fact in facts) and all_right(facts, EXPECTED_HZ / 2)
    assert bench.open_ticks < 0.25 * len(facts)


def test_stalls_during_the_pauses_are_a_low_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even if there is none while PHM subscribes: a publisher that publishes something does not wait for a subscription."""
    camera = Camera("/a/camera", lazy=False)
    bench = Bench(monkeypatch, camera)
    bench.run(30.0)
    camera.stalls = True
    bench.run(15.0)
    assert all(fact.hz is not None and fact.hz < 0.9 * EXPECTED_HZ for fact in bench.run(30.0))


def test_a_low_rate_is_measured_from_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether or not its publisher needs a subscription."""
    for lazy in (False, True):
        camera = Camera("/a/camera", lazy=lazy)
        bench = Bench(monkeypatch, camera)
        camera.hz = EXPECTED_HZ / 2
        facts = bench.run(30.0)
        assert facts[-1].hz is not None and all_right(facts, EXPECTED_HZ / 2)


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("lazy", [(True, True), (True, False), (False, False)])
def test_several_publishers_that_need_a_subscription_have_their_rate(
    monkeypatch: pytest.MonkeyPatch, lazy: tuple[bool, bool], *, named: bool
) -> None:
    """The sum of both, whether the middleware names them or only their numbers distinguish them."""
    cameras = Camera("/a/one", lazy=lazy[0]), Camera("/a/two", lazy=lazy[1], hz=20.0)
    facts = Bench(monkeypatch, *cameras, named=named).run(90.0)
    assert all_right(facts[40:], EXPECTED_HZ + 20.0)
    assert facts[-1].hz is not None and not facts[-1].problem


@pytest.mark.parametrize(("count", "share"), [(2, 0.5), (9, 0.2)])
def test_numbers_that_cannot_be_distinguished_do_not_keep_a_subscription(
    monkeypatch: pytest.MonkeyPatch, count: int, share: float
) -> None:
    """Numbers at random: the messages are counted, or the rate is unknown; most of them are not copied."""
    rnd = random.Random(1)
    cameras = [Camera(f"/a/camera_{number}", lazy=False) for number in range(count)]
    bench = Bench(monkeypatch, *cameras)
    facts = []
    for _ in range(400):
        facts += bench.run(TICK_S)
        for camera in cameras:
            camera.sent = [(at_s, rnd.randint(1, 10**6)) for at_s, _ in camera.sent[-20:]]
    assert all_right(facts, EXPECTED_HZ * count)
    assert bench.open_ticks < share * len(facts)
