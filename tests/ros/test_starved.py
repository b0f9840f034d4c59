"""What the ROS child missed because it was starved of CPU is not a fault of nodes or topics, nor of the child."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from phm import api
from phm.core.scheduling_delay import ProcessStallMeter, SchedulingDelay
from phm.probes.ros import supervisor
from phm.probes.ros.graph_snapshot import AGAIN_S, BREAK_S, GraphSnapshot, again_s
from phm.probes.ros.protocol import GraphMessage, SelfReportUpdate, Tick
from phm.probes.ros.rates.estimator import RateEstimator
from phm.probes.ros.rates.publisher_stats import Sample
from phm.probes.ros.supervisor import SupervisorLimits
from phm_checks._ros_facts import beacon_silent
from tests.fakes.ros_bench import Bench, until
from tests.ros.test_supervision import fake

pytestmark = pytest.mark.one_distribution
"""No ROS at all."""

NODE = "/a/n"
PICTURE = GraphMessage(100.0, {NODE: 1}, {"/a/t": api.TopicFact((), (), api.RateFact(10.0, 0.1, limit_s=1.0))}, 1)


class Child:
    """The daemon's view of a child whose messages the test writes."""

    def __init__(self, grace_s: float = 8.0) -> None:
        self.now, self.up_s, self.late = 1000.0, 100.0, SchedulingDelay()
        self.view = GraphSnapshot(again_s=again_s(grace_s)).with_message(PICTURE, self.now)

    def receive(self) -> None:
        self.view = self.view.with_message(SelfReportUpdate({NODE: api.BeaconFact(0.0, 0.2)}), self.now)

    def tick(self, passed_s: float, late_s: float = 0.0) -> api.RosFact:
        self.now += passed_s
        if late_s:
            self.late.add(self.now - late_s, self.now)
        self.view = self.view.with_message(Tick(self.up_s, {"/a/t": 0.1}, 1, late_s), self.now)
        return self.fact()

    def fact(self) -> api.RosFact:
        assert self.view.graph is not None
        return self.view.fact(self.view.graph, self.now, self.late_s)

    def late_s(self, since: float, most_s: float | None = None) -> float:
        return self.late.late_s(since, self.now, most_s)


def test_a_beacon_is_not_silent_while_the_child_does_not_run() -> None:
    """Its silence is its age minus the child's lateness; while the child runs, silence counts in full."""
    child = Child()
    child.receive()
    fact = child.tick(5.0, 4.8)
    assert not beacon_silent(fact.beacons[NODE])
    assert fact.beacons[NODE].age_s == pytest.approx(5.0)
    for _ in range(4):
        fact = child.tick(0.25)
    assert beacon_silent(fact.beacons[NODE])


def test_a_permanently_starved_child_halves_a_silence_at_most() -> None:
    """A dead node is still found."""
    child = Child()
    child.receive()
    for _ in range(20):
        fact = child.tick(0.5, 0.49)
    assert fact.beacons[NODE].silent_s >= 4.5


def test_the_graph_proves_absence_after_a_gap_as_after_a_start() -> None:
    """Leases may have expired meanwhile; but consecutive gaps do not hide a missing node permanently."""
    child = Child()
    assert child.tick(0.25).up_s == pytest.approx(100.0)
    assert child.tick(2.0, BREAK_S).up_s == 0.0
    assert child.tick(3.0, BREAK_S).up_s == pytest.approx(3.0)
    assert child.tick(AGAIN_S, BREAK_S / 2).up_s == pytest.approx(AGAIN_S + 3.0)
    assert child.tick(3.0, BREAK_S).up_s == 0.0


def sample(number: int, at_s: float) -> Sample:
    return Sample(number, int(at_s * 1e9), at_s)


@pytest.mark.parametrize(("gap_s", "most_s"), [(0.9, 7.0), (2.0, 8.5), (5.0, 15.5)])
def test_late_polls_count_half_at_most(gap_s: float, most_s: float) -> None:
    """A topic is not silent because PHM polled late; a silent one is found within twice its limit, the longest pause
    and a poll.
    """
    meter = RateEstimator(10.0, 3.0)
    meter.update(100.0, [sample(1, 100.0)])
    now = 100.0
    while (fact := meter.update(now := now + gap_s, [])).hz != 0.0:
        assert now - 100.0 < most_s
    assert fact.silent_s is not None
    assert fact.silent_s > 2 * 3.0 - gap_s


@pytest.mark.parametrize("gap_s", [0.5, 1.0, 2.0, 5.0])
def test_late_polls_at_most_double_the_silence_limit(gap_s: float) -> None:
    """The check reports a silence within twice its limit, the longest pause and a poll."""
    child, silent_s = Child(), 0.0
    while True:
        silent_s += gap_s
        child.now += gap_s
        child.late.add(child.now - (gap_s - 0.25), child.now)
        child.view = child.view.with_message(Tick(100.0, {"/a/t": silent_s}, 1, gap_s - 0.25), child.now)
        rate = child.fact().topics["/a/t"].rate
        assert rate is not None and rate.silent_s is not None
        if rate.silent_s - rate.not_counted_s > 3.0:
            break
        assert silent_s <= 2 * 3.0 + gap_s


@pytest.mark.parametrize("grace_s", [8.0, 60.0, 120.0])
def test_gaps_do_not_hide_a_missing_node_permanently(grace_s: float) -> None:
    """A child that is late every half minute still proves absence, however long the grace is."""
    child = Child(grace_s)
    child.up_s = 10_000.0
    longest_s = 0.0
    for _ in range(40):
        child.tick(1.0, BREAK_S)
        longest_s = max(longest_s, child.tick(30.0).up_s)
    assert 2 * grace_s <= longest_s < child.up_s


def test_a_gap_does_not_reset_the_wait_for_a_slow_topic() -> None:
    """Its three periods may be longer than the time between two gaps."""
    child = Child()
    fact = child.tick(5.0, BREAK_S)
    assert (fact.up_s, fact.listened_s) == (0.0, pytest.approx(100.0))


def test_polls_in_time_count_in_full() -> None:
    """On a machine with spare CPU a silent topic is found as soon as usual."""
    meter = RateEstimator(10.0, 3.0)
    meter.update(100.0, [sample(1, 100.0)])
    found = [step for step in range(1, 20) if meter.update(100.0 + 0.25 * step, []).hz == 0.0]
    assert found[0] == 13


def proc(folder: Path, state: str, ran_s: float, waited_s: float) -> str:
    (folder / "7").mkdir(exist_ok=True)
    (folder / "7" / "stat").write_text(f"7 (a ) b) {state} 1 7 7 0 -1", "ascii")
    (folder / "7" / "schedstat").write_text(f"{int(ran_s * 1e9)} {int(waited_s * 1e9)} 12\n", "ascii")
    return str(folder)


@pytest.mark.parametrize(
    ("state", "ran_s", "waited_s", "held_s"),
    [
        ("S", 0.1, 1.5, 1.5),
        ("R", 0.1, 0.0, 1.9),
        ("D", 0.0, 0.0, 2.0),
        ("S", 0.1, 0.0, 0.0),
        ("R", 2.0, 0.0, 0.0),
        ("T", 0.0, 0.0, 0.0),
    ],
    ids=["it waited", "it waits for a core", "it waits for the disk", "it sleeps", "it computes", "it is stopped"],
)
def test_only_a_runnable_process_counts_as_starved(
    tmp_path: Path, state: str, ran_s: float, waited_s: float, held_s: float
) -> None:
    """By its state and the kernel's counters; a process that sleeps, computes or is stopped does not count as starved."""
    progress = ProcessStallMeter(7, proc(tmp_path, "S", 10.0, 20.0))
    assert progress.measure(100.0) == 0.0
    proc(tmp_path, state, 10.0 + ran_s, 20.0 + waited_s)
    assert progress.measure(102.0) == pytest.approx(held_s)


def test_nothing_counts_as_starved_without_the_kernels_counters(tmp_path: Path) -> None:
    """A kernel without schedstat, and a process that has ended."""
    progress = ProcessStallMeter(7, str(tmp_path))
    assert (progress.measure(1.0), progress.measure(5.0)) == (0.0, 0.0)
    mine = ProcessStallMeter(os.getpid())
    mine.measure(time.monotonic())
    assert mine.measure(time.monotonic()) >= 0.0


@pytest.mark.parametrize(("share", "replaced"), [(1.0, False), (0.0, True)], ids=["starved", "hangs"])
def test_a_child_is_replaced_for_silence_only_if_it_could_run(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, share: float, replaced: bool
) -> None:
    """PHM waits for a starved child up to `starved_s`, since its successor would be starved too; not for one that
    hangs.
    """
    held(monkeypatch, share)
    limits = SupervisorLimits(
        start_s=60.0, silent_s=0.5, memory_period_s=0.1, backoff_s=0.05, exit_s=0.2, starved_s=2.0
    )
    probe = bench.probe(command=fake("mute"), limits=limits)
    until(lambda: probe.restarts >= 1, "a replacement")
    words = bench.notes[0]
    assert "was unresponsive for 0.5 s" in words
    assert ("could not run" in words) is not replaced


def held(monkeypatch: pytest.MonkeyPatch, share: float) -> None:
    class Held(ProcessStallMeter):
        def __init__(self, pid: int) -> None:
            super().__init__(pid)
            self.last: float | None = None

        def measure(self, now: float) -> float:
            passed_s = 0.0 if self.last is None else now - self.last
            self.last = now
            return share * passed_s

    monkeypatch.setattr(supervisor, "ProcessStallMeter", Held)


def test_received_beacons_are_sent_before_the_snapshot(bench: Bench) -> None:
    """So that no silence is judged by a snapshot newer than the latest beacons."""
    from phm.probes.ros.observer import Observer

    order: list[str] = []

    class Looked(Observer):
        def __init__(self) -> None:
            part = type("Part", (), {"poll": lambda self, *_, **__: [SelfReportUpdate()]})()
            self._beacons = self._diagnostics = self._readiness = part
            self._names = type("Names", (), {"observe": lambda self, _: False})()

        def _graph_message(self, *, notified: bool, late_s: float) -> GraphMessage | Tick:
            return Tick(1.0, late_s=late_s)

    order += [type(message).__name__ for message in Looked().poll(late_s=0.5)]
    assert order == ["SelfReportUpdate"] * 3 + ["Tick"]
