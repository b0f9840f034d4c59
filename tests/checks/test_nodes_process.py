"""Slot 6: what the process of a node and its beacon say about it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm import api
from phm.recovery.policy import LADDERS
from phm_checks._liveness import HANG_S
from phm_checks._process_table import BLIND_S
from phm_checks.nodes import BUSY_S
from tests.fakes.nodes_bench import (
    MAIN,
    NAME,
    ONE,
    TOPIC,
    Bench,
    beating,
    flowing,
    rated,
)


def test_a_killed_node_is_dead_as_soon_as_its_topic_wavers() -> None:
    """Still listed, silent for less than its limit: the list of processes is asked at once, and proves it."""
    bench = rated()
    bench.after(3.0)
    bench.processes(MAIN)
    bench.ros.change(topics=flowing(0.25))
    bench.clock.advance(0.25)
    result = bench.result()
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "node_missing", "node_1 dead")
    assert ": its process 71 has ended; silent for 0.2 s: topic_1; " in result.summary


def test_only_what_its_process_shows_is_conclusive() -> None:
    """That a process has ended or is stopped was seen itself; that a node left the graph may come of lateness."""
    bench = rated()
    bench.after(3.0)
    assert not bench.result().evidence.conclusive
    bench.processes(MAIN, api.ProcessFact(71, 1, "T", 5.0, ONE.command))
    bench.ros.change(topics=flowing(0.5))
    stopped = bench.after(1.0)
    assert (stopped.condition, stopped.evidence.conclusive) == ("node_hung", True)
    bench.processes(MAIN, ONE)
    bench.ros.change(nodes={})
    left = bench.after(8.0)
    assert (left.condition, left.evidence.conclusive) == ("node_missing", False)
    bench.processes(MAIN)
    dead = bench.after(12.0)
    assert (dead.condition, dead.evidence.conclusive) == ("node_missing", True)


def test_a_killed_node_is_dead_as_soon_as_its_beacon_wavers() -> None:
    """Two beats missed: a reason to look, and the look proves it."""
    bench = Bench()
    bench.ros.change(beacons=beating())
    bench.after(3.0)
    bench.processes(MAIN)
    bench.ros.change(beacons=beating(0.55))
    bench.clock.advance(0.25)
    assert bench.result().brief == "node_1 dead"


def test_a_node_without_signs_is_looked_after_all_the_same() -> None:
    """Killed, still listed for 20 s, no beacon, no topic: the list of processes is looked at every BLIND_S."""
    bench = Bench()
    bench.after(3.0)
    bench.processes(MAIN)
    assert bench.after(BLIND_S + 0.25).brief == "node_1 dead"


@pytest.mark.parametrize("state", ["T", "t"])
def test_a_stopped_node_hangs(state: str) -> None:
    """SIGSTOP: the process is there, listed or not, and will not answer."""
    bench = rated()
    bench.after(3.0)
    bench.processes(MAIN, api.ProcessFact(71, 1, state, 5.0, ONE.command))
    bench.ros.change(topics=flowing(0.5))
    bench.clock.advance(0.25)
    result = bench.result()
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "node_hung", "node_1 hung")
    assert result.target == "ros_app"
    assert f"its process 71 is stopped (state {state}" in result.summary
    bench.ros.change(nodes={}, topics={})
    assert bench.after(5.0).condition == "node_hung"
    bench.processes(MAIN, ONE)
    bench.ros.change(nodes={NAME: 1}, topics=flowing())
    assert bench.after(1.5).level is api.Level.OK


@pytest.mark.parametrize("state", ["R", "S"])
def test_a_busy_node_is_not_dead(state: str) -> None:
    """A callback that computes for 5 s, on the main thread or on another: its beacon and its topic fall silent."""
    bench = rated()
    bench.ros.change(beacons=beating())
    bench.after(3.0)
    levels = []

    def busy(passed: float) -> None:
        bench.processes(MAIN, api.ProcessFact(71, 1, state, 5.0 + passed // 1, ONE.command))
        bench.ros.change(topics=flowing(passed), beacons=beating(0.1, late_s=passed))
        levels.append(bench.result().level)

    result = bench.after(5.0, busy)
    assert result.level is api.Level.OK
    assert "its process 71 is using the CPU" in result.summary
    assert api.Level.ERROR not in levels
    assert bench.after(BUSY_S, lambda passed: busy(5.0 + passed)).condition == "node_busy"


def test_an_executor_that_sleeps_hangs() -> None:
    """A deadlock: the beacon beats and says so, the process sleeps. Not known before HANG_S, so that topics wait."""
    bench = rated()
    bench.ros.change(beacons=beating())
    bench.after(3.0)
    levels = []

    def asleep(passed: float) -> None:
        bench.ros.change(topics=flowing(passed), beacons=beating(0.1, late_s=passed))
        levels.append(bench.result().level)

    result = bench.after(HANG_S + 0.5, asleep)
    assert (result.level, result.condition) == (api.Level.ERROR, "node_hung")
    assert "its executor has been blocked for" in result.summary
    known = [level for level in levels if level is not api.Level.STALE]
    assert known == sorted(known, key=lambda level: level is api.Level.ERROR)
    assert levels[int(2.5 * 4)] is api.Level.STALE


def test_a_silent_topic_of_a_living_node_is_not_the_nodes_fault() -> None:
    """Its process runs, it is listed: the topic is told, for itself."""
    bench = rated()
    bench.after(3.0)
    assert bench.after(60.0, lambda passed: bench.ros.change(topics=flowing(passed))).level is api.Level.OK


@pytest.mark.parametrize("figures", ["lost", "never there", "no list"])
def test_a_node_is_not_hung_without_figures_of_its_process(figures: str) -> None:
    """The engine no longer says how much processor time it uses, as after one HTTP 500: it may be busy, and is not restarted."""
    bench = rated()
    bench.ros.change(beacons=beating())
    if figures == "never there":
        bench.processes(MAIN, replace(ONE, cpu_s=None))
    bench.after(12.0)
    if figures == "lost":
        bench.processes(MAIN, replace(ONE, cpu_s=None))
    elif figures == "no list":
        del bench.docker.lists["ros_app"]
    seen: list[str] = []

    def hang(passed: float) -> None:
        bench.ros.change(topics=flowing(passed), beacons=beating(0.1, late_s=passed))
        seen.append(bench.result().condition)

    result = bench.after(60.0, hang)
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "node_unanswering",
        "node_1 does not answer",
    )
    assert set(seen) == {"", "node_unanswering"}
    assert "node_unanswering" not in LADDERS


def test_a_process_that_cannot_be_told_is_no_dead_one() -> None:
    """An engine that lists nothing, refuses or is silent says nothing about nodes."""
    bench = rated()
    bench.after(3.0)
    del bench.docker.lists["ros_app"]
    assert bench.after(5.0, lambda passed: bench.ros.change(topics=flowing(passed))).level is api.Level.OK


@pytest.mark.parametrize("gone", [True, False])
def test_a_silent_engine_does_not_hide_a_dead_node(gone: bool) -> None:
    """Then the graph decides alone."""
    bench = Bench()
    bench.docker.fail()
    bench.result()
    if gone:
        bench.ros.change(nodes={})
    assert bench.after(1.0).level is (api.Level.ERROR if gone else api.Level.OK)


def test_a_beacon_decides_where_the_process_is_not_known() -> None:
    """Silent for three beats: its thread is its own, so the process is dead or stopped."""
    bench = Bench()
    bench.processes(MAIN)
    bench.ros.change(beacons=beating())
    bench.after(3.0)
    bench.ros.change(beacons=beating(0.75))
    result = bench.result()
    assert (result.level, result.condition) == (api.Level.ERROR, "node_missing")
    assert ": its beacon has been silent for 0.8 s; it is listed in the graph" in result.summary


@pytest.mark.parametrize("silent", ["beacon", "topic"])
def test_a_late_child_silences_nobody(silent: str) -> None:
    """When PHM's own child has not spoken for a while, nobody was heard: that is no silence of theirs, and costs no list."""
    bench = rated()
    bench.processes(MAIN)
    bench.ros.change(beacons=beating() if silent == "beacon" else {}, topics=flowing() if silent == "topic" else {})
    bench.after(20.0)
    before = bench.docker.listings
    bench.ros.change(age_s=2.0)
    if silent == "beacon":
        bench.ros.change(beacons=beating(2.2))
    else:
        bench.ros.change(topics=flowing(2.0))
    assert bench.result().level is api.Level.OK
    assert bench.docker.listings == before


def test_a_large_topic_that_is_listened_to_in_windows_does_not_waver() -> None:
    """Between two windows nothing is heard: that is PHM's own doing and costs no list."""
    bench = rated()
    rate = api.RateFact(10.0, 2.0, limit_s=5.0, sample_bytes=1e6)
    bench.ros.change(topics={TOPIC: api.TopicFact((api.EndpointFact(NAME, ""),), (), rate)})
    bench.after(20.0)
    before = bench.docker.listings
    bench.after(9.0)
    assert bench.docker.listings - before <= 1


def test_an_executor_that_is_not_watched_is_never_late() -> None:
    """A beacon may be told not to watch it; what it says of its lateness then means nothing."""
    bench = Bench()
    bench.ros.change(beacons={NAME: api.BeaconFact(0.1, 0.2, 60.0, "a", 100, turns=0)})
    assert bench.after(3.0).level is api.Level.OK


def test_a_beacon_of_the_node_before_is_none_of_this_one() -> None:
    """The node came into the graph anew, as another program without a beacon: the silence is that of its predecessor."""
    bench = Bench()
    bench.processes(MAIN)
    bench.ros.change(beacons=beating())
    bench.after(3.0)
    silence = 0.0

    def silent(passed: float) -> None:
        bench.ros.change(beacons=beating(silence + passed))

    bench.ros.change(nodes={})
    assert bench.after(2.0, silent).brief == "node_1 dead"
    silence = 2.0
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(2.0, silent).level is api.Level.OK


def test_another_publisher_is_no_sign_of_life() -> None:
    """A topic that flows from elsewhere says nothing about the node."""
    bench = rated()
    bench.processes(MAIN)
    bench.after(1.0)
    other = api.TopicFact((api.EndpointFact("/agent_1/other", ""),), (), api.RateFact(10.0, 0.0))
    bench.ros.change(nodes={}, topics={TOPIC: other})
    assert bench.after(1.0).brief == "node_1 dead"
