"""Slot 6: rules of the nodes check."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm.recovery.policy import LADDERS
from phm_checks._graph_evidence import TWICE_S, UNNAMED_S
from phm_checks._liveness import GOODBYE_S, HANG_S, LOST_S
from phm_checks._process_table import BLIND_S, ENDING_S, OLD_S, QUIET_S, SOON_S
from phm_checks.nodes import BUSY_S, Nodes

NODE = "nodes/agent_1/node_1"
NAME = "/agent_1/node_1"
TOPIC = "/agent_1/topic_1"
GRACE_S = 8.0
ONE = api.ProcessFact(71, 1, "S", 5.0, "python -m sitl.application.node --name node_1 --namespace /agent_1")
TWO = api.ProcessFact(72, 1, "S", 5.0, "python -m sitl.application.node --name node_2 --namespace /agent_1")
MAIN = api.ProcessFact(70, 0, "S", 1.0, "python -m sitl.application.app")


def flowing(silent_s: float = 0.0) -> dict[str, api.TopicFact]:
    """The node's topic at 10 Hz, silent for so long."""
    rate = api.RateFact(10.0, silent_s, limit_s=1.0)
    return {TOPIC: api.TopicFact((api.EndpointFact(NAME, "std_msgs/msg/String"),), (), rate)}


def beating(age_s: float = 0.1, late_s: float = 0.0) -> dict[str, api.BeaconFact]:
    return {NAME: api.BeaconFact(age_s, 0.2, late_s, "a", 100, turns=20)}


class Bench:
    """One node in one container, with the fakes at hand. Its process is listed, it has no beacon and no topic."""

    def __init__(
        self, *, nodes: list[dict[str, Any]] | None = None, topics: list[dict[str, Any]] | None = None, **ros: Any
    ) -> None:
        settings = testing.settings(
            containers=[{"name": "ros_app"}],
            ros={"nodes": nodes or [{"name": "agent_1/node_1"}], "topics": topics or [], "grace": GRACE_S, **ros},
        )
        (self.check,) = Nodes.build(settings)
        self.clock, self.ros = testing.FakeClock(), testing.FakeRos(nodes={NAME: 1}, age_s=0.0)
        self.docker = testing.FakeDocker(testing.container("ros_app"))
        self.processes(MAIN, ONE)

    def processes(self, *facts: api.ProcessFact) -> None:
        self.docker.lists["ros_app"] = facts

    def results(self) -> dict[str, api.Result]:
        results = self.check.run(testing.world(clock=self.clock, ros=self.ros, docker=self.docker))
        assert not isinstance(results, api.Result)
        return dict(results)

    def result(self) -> api.Result:
        return self.results()[NODE]

    def after(self, seconds: float, each: Callable[[float], None] = lambda passed: None) -> api.Result:
        """Let time pass as it does, four runs a second; `each` gets how much has passed before each of them."""
        result = self.result()
        for number in range(1, round(seconds / 0.25) + 1):
            self.clock.advance(0.25)
            each(number * 0.25)
            result = self.result()
        return result

    def restart_container(self, *processes: api.ProcessFact) -> None:
        self.docker.change("ros_app", started_at=str(self.clock.mono()))
        self.processes(*processes)


def rated(**more: Any) -> Bench:
    """A node that publishes at 10 Hz."""
    bench = Bench(topics=[{"name": TOPIC, "rate": 10, "publishers": [NAME]}], **more)
    bench.ros.change(topics=flowing())
    return bench


class Contained(Bench):
    """The container's first process is in its lists, as with a real engine."""

    def __init__(self, **ros: Any) -> None:
        super().__init__(**ros)
        self.docker.change("ros_app", pid=MAIN.pid)
        self.result()


# ---------------------------------------------------------------- what is built, and what is well


def test_no_nodes_no_check() -> None:
    """Nothing to judge, nothing built."""
    assert list(Nodes.build(testing.settings())) == []


def test_a_listed_node_is_ok() -> None:
    """Names match with and without their first slash."""
    bench = Bench()
    result = bench.result()
    assert (result.level, result.summary) == (api.Level.OK, "Node agent_1/node_1 is running")
    assert result.values == {"listed": 1, "process": "71 S"}
    (unit,) = bench.check.units
    assert unit == api.Unit(NODE, ("container/ros_app", "network/ros_app"), target="ros_app", grace_s=GRACE_S)


def test_a_node_of_an_unknown_container_needs_none() -> None:
    """With two containers and no word which one, there is nobody to blame or to restart, and no list of processes."""
    settings = testing.settings(containers=[{"name": "a"}, {"name": "b"}], ros={"nodes": [{"name": "/n"}]})
    (check,) = Nodes.build(settings)
    assert check.units == [api.Unit("nodes/n", grace_s=GRACE_S)]
    docker = testing.FakeDocker()
    check.run(testing.world(docker=docker, ros=testing.FakeRos(nodes={"/n": 1})))
    assert docker.calls == docker.listings == 0


def test_each_node_is_judged_for_itself() -> None:
    """One dead node is one fault."""
    bench = Bench(nodes=[{"name": "/agent_1/node_1"}, {"name": "/agent_1/node_2"}])
    levels = {unit: result.level for unit, result in bench.results().items()}
    assert levels == {NODE: api.Level.OK, "nodes/agent_1/node_2": api.Level.ERROR}


# ---------------------------------------------------------------- the graph


def test_a_node_that_vanished_is_dead() -> None:
    """Seen before, gone now, and for long enough that its container is not going with it."""
    bench = Bench()
    bench.processes(MAIN)
    bench.result()
    bench.ros.change(nodes={})
    assert bench.result().level is api.Level.OK
    bench.clock.advance(GOODBYE_S + 0.01)
    result = bench.result()
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "node_missing", "node_1 dead")
    assert result.target == "ros_app"
    assert "Missing node: agent_1/node_1; it is no longer running in ros_app: it is not in the graph" in result.summary


def test_a_node_never_seen_never_started() -> None:
    """The remedy is another: look at names and launch file."""
    bench = Bench()
    bench.processes(MAIN)
    bench.ros.change(nodes={"/agent_1/nod_1": 1})
    result = bench.result()
    assert (result.condition, result.brief) == ("node_missing", "node_1 never started")
    assert "/agent_1/nod_1" in result.summary


def test_a_young_picture_proves_no_absence() -> None:
    """Discovery needs seconds to fill the graph."""
    bench = Bench()
    bench.ros.change(nodes={}, up_s=3.0)
    assert bench.result().level is api.Level.STALE


def test_an_old_picture_proves_nothing() -> None:
    """Neither presence nor absence."""
    bench = Bench()
    bench.ros.change(age_s=30.0)
    result = bench.result()
    assert result.level is api.Level.STALE
    assert "30 s old" in result.summary or "its process 71 is running" in result.summary


def test_no_picture_makes_every_node_stale() -> None:
    """A dead ROS child is PHM's trouble."""
    bench = Bench(nodes=[{"name": "/agent_1/node_1"}, {"name": "/agent_1/node_2"}])
    bench.processes()
    bench.ros.fail("the ROS child is being replaced")
    for result in bench.results().values():
        assert (result.level, "the ROS child is being replaced" in result.summary) == (api.Level.STALE, True)


def test_without_a_picture_a_process_that_ended_is_still_a_dead_node() -> None:
    """The process list needs no ROS."""
    bench = Bench()
    bench.result()
    bench.ros.fail("the ROS child is being replaced")
    bench.processes(MAIN)
    result = bench.after(1.0)
    assert result.brief == "node_1 dead"
    assert "its process 71 has ended" in result.summary


def test_a_node_that_a_young_picture_had_and_lost_is_dead() -> None:
    """The warm-up protects nodes that were not found yet, not nodes that were found and are gone."""
    bench = Bench()
    bench.processes()
    bench.ros.change(up_s=2.0)
    bench.result()
    bench.ros.change(nodes={}, up_s=3.0)
    assert bench.after(0.5).level is api.Level.ERROR
    bench.ros.change(up_s=0.5)
    assert bench.result().level is api.Level.STALE


def test_after_a_restart_of_the_ros_child_nothing_is_told_until_it_has_looked() -> None:
    """Its picture is empty at first: neither the names nor the beacons of before count."""
    bench = rated()
    bench.ros.change(beacons=beating())
    bench.after(3.0)
    levels = set()

    def child(passed: float) -> None:
        if passed <= 1.0:
            bench.ros.fail("the ROS child is being replaced")
        else:
            bench.ros.work()
            bench.ros.change(up_s=passed - 1.0, nodes={}, topics={}, beacons={})
            if passed > 5.0:
                bench.ros.change(nodes={NAME: 1}, topics=flowing(), beacons=beating())
        levels.add(bench.result().level)

    assert bench.after(8.0, child).level is api.Level.OK
    assert levels == {api.Level.OK, api.Level.STALE}


def test_a_node_listed_twice_is_told_only_after_the_lease() -> None:
    """A restarted node is listed beside its old self until the lease ends."""
    bench = Bench()
    bench.result()
    bench.ros.change(nodes={NAME: 2})
    levels = [bench.result().level]
    bench.clock.advance(TWICE_S + 1)
    twice = bench.result()
    levels.append(twice.level)
    bench.ros.change(nodes={NAME: 1})
    levels.append(bench.result().level)
    assert levels == [api.Level.OK, api.Level.WARN, api.Level.OK]
    assert (twice.condition, twice.brief) == ("node_duplicate", "node_1 runs twice")


def test_a_node_with_two_processes_runs_twice_whatever_its_lease() -> None:
    """Listed twice and two processes for a moment longer than a restart takes: certain, so it is an error, and the cause."""
    bench = Bench()
    bench.result()
    bench.ros.change(nodes={NAME: 2})
    bench.processes(MAIN, ONE, replace(ONE, pid=99))
    assert bench.result().level is api.Level.OK
    twice = bench.after(4.0)
    assert (twice.level, twice.condition, twice.target) == (api.Level.ERROR, "node_duplicate", "ros_app")
    assert "2 processes" in twice.summary
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(5.0).condition == "node_duplicate", "a graph that is made anew may not list both yet"
    bench.processes(MAIN, ONE)
    assert bench.after(1.0).level is api.Level.OK


def test_two_processes_that_both_beat_are_two_nodes_at_once() -> None:
    """The graph, the list of processes and the beacons agree: no overlap of an old node with a new one looks so."""
    bench = Bench()
    bench.ros.change(beacons=beating())
    bench.after(12.0)
    bench.ros.change(nodes={NAME: 2})
    bench.processes(MAIN, ONE, replace(ONE, pid=99))
    assert bench.after(1.0).level is api.Level.OK
    bench.ros.change(beacons={NAME: replace(beating()[NAME], rivals=1)})
    result = bench.after(0.25)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "node_duplicate", "ros_app")


def test_a_second_beacon_elsewhere_is_told_without_waiting_for_a_lease() -> None:
    """The other one runs in no container of this agent, so nothing here is restarted for it."""
    bench = Bench()
    bench.ros.change(nodes={NAME: 2}, beacons={NAME: replace(beating()[NAME], rivals=1)})
    result = bench.after(0.25)
    assert (result.level, result.condition, result.target) == (api.Level.WARN, "node_duplicate", "")
    assert "two processes send beacons under its name" in result.summary


def test_a_name_that_stays_behind_alone_is_no_second_node() -> None:
    """The middleware never forgets some names; the ends of its topics are there once, and a second node would have them, too."""
    bench = rated()
    bench.ros.change(nodes={NAME: 2})
    assert bench.after(2 * TWICE_S).level is api.Level.OK
    ends = (api.EndpointFact(NAME, "std_msgs/msg/String"),) * 2
    bench.ros.change(topics={TOPIC: replace(flowing()[TOPIC], publishers=ends)})
    assert bench.after(TWICE_S + 0.5).condition == "node_duplicate"


@pytest.mark.parametrize(("listed", "pids"), [(2, (71,)), (1, (71, 99))])
def test_one_sign_of_a_second_node_is_not_enough(listed: int, pids: tuple[int, ...]) -> None:
    """A lease that has not ended, or a process that only looks like the node's."""
    bench = Bench()
    bench.result()
    bench.ros.change(nodes={NAME: listed})
    bench.processes(MAIN, *(replace(ONE, pid=pid) for pid in pids))
    assert bench.after(10.0).level is api.Level.OK


def test_a_name_that_lost_its_endpoints_is_not_alive() -> None:
    """Where nobody knows the process; a node that never had the endpoints is the topic's affair."""
    bench = Bench(topics=[{"name": TOPIC, "publishers": [NAME]}])
    bench.processes()
    bench.ros.change(topics={TOPIC: api.TopicFact()})
    assert bench.after(20.0).level is api.Level.OK
    bench.ros.change(topics={TOPIC: api.TopicFact((api.EndpointFact(NAME, ""),))})
    assert bench.result().level is api.Level.OK
    bench.ros.change(topics={TOPIC: api.TopicFact()})
    assert bench.after(1.0).level is api.Level.STALE
    result = bench.after(2.0)
    assert (result.level, result.condition) == (api.Level.ERROR, "node_missing")
    assert "none of its endpoints is in the graph" in result.summary


# ---------------------------------------------------------------- the process


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


# ---------------------------------------------------------------- lives


def test_what_was_seen_before_the_container_restarted_does_not_count() -> None:
    """After a restart the node has to start anew; until grace is over nothing is told, then that it never did."""
    bench = Bench()
    bench.after(1.0)
    bench.restart_container(MAIN)
    bench.ros.change(nodes={})
    assert bench.after(GRACE_S - 1.0).level is api.Level.STALE
    assert bench.after(2.0).brief == "node_1 never started"


def test_a_node_that_died_in_a_later_life_is_dead() -> None:
    """It was listed all the time over the restart of its container; it lived in the new life, too."""
    bench = Bench()
    bench.after(1.0)
    bench.restart_container(MAIN, api.ProcessFact(81, 1, "S", 0.0, ONE.command))
    bench.after(QUIET_S)
    bench.ros.change(nodes={NAME: 2})
    bench.after(1.0)
    bench.ros.change(nodes={NAME: 1})
    bench.after(TWICE_S)
    bench.processes(MAIN)
    bench.ros.change(nodes={})
    assert bench.after(1.0).brief == "node_1 dead"


def test_a_stale_graph_after_a_restart_raises_no_alarm() -> None:
    """The old name stays listed, then goes before the new one comes: its process runs, so it is starting."""
    bench = rated()
    bench.after(3.0)
    levels = []

    def restart(passed: float) -> None:
        if passed == 0.25:
            bench.restart_container(MAIN, api.ProcessFact(81, 1, "R", 0.0, ONE.command))
        bench.ros.change(topics=flowing(passed), nodes={NAME: 1} if passed < 1.5 or passed > 4.0 else {})
        if passed > 4.0:
            bench.ros.change(topics=flowing())
        levels.append(bench.result().level)

    assert bench.after(6.0, restart).level is api.Level.OK
    assert api.Level.ERROR not in levels


def test_a_stale_graph_after_a_restart_hides_no_dead_node() -> None:
    """With a lease of 20 s the name stays; the process that was always found is not there."""
    bench = rated()
    bench.after(3.0)
    bench.restart_container(MAIN)
    result = bench.after(GRACE_S + 3.0, lambda passed: bench.ros.change(topics=flowing(passed)))
    assert (result.level, result.condition) == (api.Level.ERROR, "node_missing")
    assert "no process in its container matches it" in result.summary


def test_a_node_started_anew_beside_its_siblings_is_not_dead() -> None:
    """Its process is another: the container goes on, the old name stays until its lease ends."""
    bench = rated()
    bench.after(3.0)
    levels = []

    def relaunched(passed: float) -> None:
        bench.processes(MAIN, api.ProcessFact(95, 1, "S", 0.0, ONE.command))
        bench.ros.change(topics=flowing(passed if passed < 2.0 else 0.0), nodes={} if 0.5 < passed < 2.0 else {NAME: 1})
        levels.append(bench.result().level)

    result = bench.after(5.0, relaunched)
    assert (result.level, result.values["process"]) == (api.Level.OK, "95 S")
    assert api.Level.ERROR not in levels


def test_a_process_that_is_gone_where_two_others_fit_is_no_death() -> None:
    """One of them may be the node; which one is not known, so this evidence is missing."""
    bench = Bench()
    bench.after(3.0)
    bench.processes(MAIN, *(api.ProcessFact(pid, 1, "S", 0.0, ONE.command) for pid in (91, 92)))
    result = bench.after(3.0)
    assert (result.level, result.values["process"]) == (api.Level.OK, "71 ended")


def test_what_is_told_as_bad_is_looked_at_until_it_is_well() -> None:
    """A stopped node without a beacon and without a topic: nothing in the graph tells that it was let go."""
    bench = Bench()
    bench.after(20.0)
    bench.processes(MAIN, api.ProcessFact(71, 1, "T", 5.0, ONE.command))
    bench.after(BLIND_S + 0.25)
    bench.processes(MAIN, ONE)
    assert bench.after(SOON_S).level is api.Level.OK


def test_a_node_that_comes_back_as_an_unknown_process_is_alive() -> None:
    """Started by hand with other words: it is in the graph anew, and what became of its old process is past."""
    bench = Bench()
    bench.after(3.0)
    bench.processes(MAIN)
    assert bench.after(3.0).brief == "node_1 dead"
    bench.ros.change(nodes={})
    bench.after(1.0)
    bench.processes(MAIN, api.ProcessFact(99, 1, "S", 0.0, "gdb /opt/thing"))
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(1.0).level is api.Level.OK


@pytest.mark.parametrize(
    ("status", "condition"), [("exited", "node_missing"), ("paused", "node_hung"), ("restarting", "node_missing")]
)
def test_a_container_that_does_not_run_is_named(status: str, condition: str) -> None:
    """The node needs its container, so this is told at the container; the evidence is in the text all the same."""
    bench = rated()
    bench.after(3.0)
    bench.docker.change("ros_app", status=status)
    bench.ros.change(topics=flowing(0.5))
    bench.clock.advance(0.25)
    result = bench.result()
    assert (result.condition, f"its container is {status}" in result.summary) == (condition, True)
    bench.docker.change("ros_app", status="running", started_at="later")
    bench.ros.change(topics=flowing())
    assert bench.after(1.25).level is api.Level.OK


def test_a_launcher_seen_before_its_nodes_is_not_kept_as_one_of_them() -> None:
    """All there is with the node's name in the first moment; then the node comes, is killed, and the launcher lives on."""
    main = replace(MAIN, command='python -m sitl.application.app --graph [{"name": "node_1"}]')
    bench = rated()
    bench.processes(main)
    bench.after(0.5)
    bench.processes(main, replace(ONE, parent=main.pid))
    assert bench.after(12.0).values["process"] == "71 S"
    bench.processes(main)
    bench.ros.change(topics=flowing(0.25))
    bench.clock.advance(0.25)
    assert bench.result().brief == "node_1 dead"


# ---------------------------------------------------------------- left out of a start


def pair(**more: Any) -> Bench:
    """Two nodes of one container, both listed and both with a process."""
    bench = Bench(nodes=[{"name": "agent_1/node_1"}, {"name": "agent_1/node_2"}], **more)
    bench.ros.change(nodes={NAME: 1, "/agent_1/node_2": 1})
    bench.processes(MAIN, ONE, TWO)
    return bench


def born(bench: Bench, process: api.ProcessFact, ago_s: float) -> api.ProcessFact:
    """The process as `ps` shows it that was started so long before now: its age in whole seconds."""
    return replace(process, age_s=float(int(ago_s)))


def restarted(
    bench: Bench, late_s: float = 0.0, sibling_s: float = 0.0, command: str = TWO.command
) -> Callable[[float], None]:
    """Both nodes have lived, node_1 started `late_s` after node_2; now the container starts again, and node_2 comes after `sibling_s`.

    Returns what is so at each moment of the new life.
    """
    for passed in range(40):
        bench.processes(MAIN, born(bench, ONE, 100 - late_s + passed / 4), born(bench, TWO, 100 + passed / 4))
        bench.result()
        bench.clock.advance(0.25)
    bench.restart_container(MAIN)
    bench.ros.change(nodes={})

    def later(passed: float) -> None:
        came = api.ProcessFact(92, 1, "S", 0.0, command)
        bench.processes(MAIN, *([born(bench, came, passed - sibling_s)] if passed >= sibling_s else []))

    return later


def first_bad(bench: Bench, each: Callable[[float], None], within_s: float = 30.0) -> tuple[float, api.Result]:
    """When node_1 is told as bad, in seconds of the new life, and how."""
    for number in range(1, int(within_s * 4)):
        bench.clock.advance(0.25)
        each(number * 0.25)
        result = bench.result()
        if result.level.bad:
            return number * 0.25, result
    raise AssertionError("it was never told")


def test_a_node_left_out_of_a_start_is_told_before_grace_ends() -> None:
    """Its sibling came as ever and it did not, long after it used to: certain, and told as what it is."""
    bench = pair()
    after_s, result = first_bad(bench, restarted(bench))
    assert 2.0 <= after_s <= 3.5
    assert (result.condition, result.brief, result.evidence.certain) == ("node_missing", "node_1 never started", True)
    assert "it was not started with its container in ros_app: no process" in result.summary


def test_a_node_that_comes_late_as_ever_gets_its_time() -> None:
    """Three times what it took before, and a second."""
    bench = pair()
    after_s, _ = first_bad(bench, restarted(bench, late_s=1.5))
    assert 5.5 <= after_s <= 7.0


def test_the_clock_runs_from_the_first_node() -> None:
    """What a container does before it starts any node takes as long as it takes."""
    bench = pair()
    after_s, _ = first_bad(bench, restarted(bench, sibling_s=3.0))
    assert 5.0 <= after_s <= 6.5


def test_a_slow_start_gives_all_of_them_time() -> None:
    """The loaded machine shows in the others: one comes 2 s after the first, so the third has 4 s, but for half a second
    between two looks."""
    names = ("agent_1/node_1", "agent_1/node_2", "agent_1/node_3")
    three = api.ProcessFact(73, 1, "S", 5.0, ONE.command.replace("node_1", "node_3"))
    bench = Bench(nodes=[{"name": name} for name in names])
    bench.processes(MAIN, ONE, TWO, three)
    bench.after(5.0)
    bench.restart_container(MAIN)
    bench.ros.change(nodes={})

    def later(passed: float) -> None:
        third = [replace(three, pid=93)] if passed >= 2.0 else []
        bench.processes(MAIN, replace(TWO, pid=92), *third)

    after_s, _ = first_bad(bench, later)
    assert 3.5 <= after_s <= 5.5


@pytest.mark.parametrize("why", ["the sibling is missing, too", "other commands start other nodes", "nothing is known"])
def test_a_start_that_is_not_as_before_has_its_whole_grace(why: str) -> None:
    """It may be a slow machine, a new version, or a node that was never there."""
    bench = pair()
    if why == "nothing is known":
        bench.processes(MAIN)
        bench.ros.change(nodes={})
        bench.result()
        later = restarted(bench, late_s=90.0)
    elif why == "the sibling is missing, too":
        later = restarted(bench, sibling_s=99.0)
    else:
        later = restarted(bench, command=f"{TWO.command} --other")
    after_s, result = first_bad(bench, later)
    assert after_s >= GRACE_S
    assert not result.evidence.certain


def test_a_node_alone_in_its_container_has_its_whole_grace() -> None:
    """Nobody shows how quick this start is."""
    bench = Bench()
    bench.after(3.0)
    bench.restart_container(MAIN)
    bench.ros.change(nodes={})
    after_s, _ = first_bad(bench, lambda _: None)
    assert after_s >= GRACE_S


def test_a_node_of_the_life_before_that_is_still_heard_was_not_started_in_this_one() -> None:
    """A container takes another's place while that one still runs: its beacon and its topic are of the past."""
    bench = rated(nodes=[{"name": "agent_1/node_1"}, {"name": "agent_1/node_2"}])
    bench.ros.change(nodes={NAME: 1, "/agent_1/node_2": 1}, beacons=beating())
    bench.processes(MAIN, ONE, TWO)
    later = restarted(bench)
    bench.ros.change(nodes={NAME: 1, "/agent_1/node_2": 1})

    def overlapping(passed: float) -> None:
        later(passed)
        silent_s = max(0.0, passed - 0.5)
        bench.ros.change(topics=flowing(silent_s), beacons=beating(0.1 + silent_s))

    _, result = first_bad(bench, overlapping)
    assert result.brief == "node_1 never started"


# ---------------------------------------------------------------- the way to a container


def test_when_no_node_of_a_container_is_heard_though_all_run_nothing_is_restarted() -> None:
    """Discovery between PHM and the container is cut; the nodes themselves may be well."""
    bench = pair()
    bench.after(3.0)
    bench.ros.change(nodes={})
    result = bench.after(LOST_S + 1.0)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "node_unreachable", "")
    assert "or any other node of ros_app" in result.summary and "its process 71 is running" in result.summary
    bench.ros.change(nodes={NAME: 1, "/agent_1/node_2": 1})
    assert bench.after(1.0).level is api.Level.OK


def test_a_transport_that_hides_names_restarts_no_node() -> None:
    """Names of nodes come as data: publishers are there, nobody is listed, and nobody was ever seen."""
    bench = pair(topics=[{"name": TOPIC, "rate": 10, "publishers": [NAME]}])
    nameless = api.TopicFact((api.EndpointFact("", "std_msgs/msg/String"),), (), api.RateFact(None, None))
    bench.ros.change(nodes={}, topics={TOPIC: nameless})
    result = bench.after(GRACE_S + LOST_S + 1.0)
    assert (result.condition, result.target) == ("node_unreachable", "")


def test_a_node_whose_name_alone_was_lost_is_not_missing() -> None:
    """Its topic has a publisher without a name: PHM has lost names and gets them with a new participant, so it waits for that."""
    bench = Bench(topics=[{"name": TOPIC, "publishers": [NAME]}])
    named, nameless = (api.TopicFact((api.EndpointFact(node, "std_msgs/msg/String"),)) for node in (NAME, ""))
    bench.ros.change(topics={TOPIC: named})
    assert bench.after(GRACE_S).level is api.Level.OK
    levels = []
    bench.ros.change(nodes={}, topics={TOPIC: nameless})
    bench.after(UNNAMED_S - 1.0, lambda _: levels.append(bench.result().level))
    assert api.Level.ERROR not in levels
    bench.ros.change(nodes={NAME: 1}, topics={TOPIC: named})
    assert bench.after(1.0).level is api.Level.OK
    bench.ros.change(nodes={}, topics={TOPIC: nameless})
    assert bench.after(UNNAMED_S + 1.0).condition == "node_missing"


@pytest.mark.parametrize("why", ["one is heard", "one is listed", "one ended", "nobody knows the processes"])
def test_a_node_is_dead_unless_all_of_its_container_run_unheard(why: str) -> None:
    """One sign that the way is open, or one process that nobody knows, and a missing node is a missing node."""
    bench = pair()
    bench.after(3.0)
    bench.ros.change(nodes={"/agent_1/node_2": 1} if why == "one is listed" else {})
    if why == "one is heard":
        bench.after(LOST_S + 1.0, lambda _: bench.ros.change(beacons={"/agent_1/node_2": beating()[NAME]}))
    if why == "one ended":
        bench.processes(MAIN, ONE)
    if why == "nobody knows the processes":
        del bench.docker.lists["ros_app"]
        bench.after(OLD_S)
    result = bench.after(LOST_S + 1.0)
    assert (result.condition, result.target) == ("node_missing", "ros_app")


# ---------------------------------------------------------------- cost


@pytest.mark.parametrize(("made", "period_s"), [(rated, QUIET_S), (Bench, BLIND_S)])
def test_while_all_is_well_the_engine_is_left_alone(made: Callable[[], Bench], period_s: float) -> None:
    """With a topic or a beacon as a quick sign, the list of processes is asked for every QUIET_S alone."""
    bench = made()
    bench.after(20.0)
    before = bench.docker.listings
    bench.after(60.0)
    assert bench.docker.listings - before == 60 // period_s


def test_what_stays_in_doubt_is_asked_about_less_and_less() -> None:
    """A topic that is silent for an hour must not cost a list of processes each second."""
    bench = rated()
    bench.after(3.0)
    before = bench.docker.listings
    bench.after(5.0, lambda passed: bench.ros.change(topics=flowing(passed)))
    assert 6 <= bench.docker.listings - before <= 9
    bench.after(120.0, lambda passed: bench.ros.change(topics=flowing(5.0 + passed)))
    before = bench.docker.listings
    bench.after(100.0, lambda passed: bench.ros.change(topics=flowing(125.0 + passed)))
    assert bench.docker.listings - before == 100 // QUIET_S


def test_a_jittering_topic_does_not_cost_a_list_each_time() -> None:
    """It wavers and flows and wavers: that is one long doubt."""
    bench = rated()
    bench.after(120.0, lambda passed: bench.ros.change(topics=flowing(0.5 if passed % 1.0 else 0.0)))
    before = bench.docker.listings
    bench.after(100.0, lambda passed: bench.ros.change(topics=flowing(0.5 if passed % 1.0 else 0.0)))
    assert bench.docker.listings - before <= 100 // QUIET_S + 1


def test_a_standing_doubt_hides_no_new_one() -> None:
    """The topic has been silent for minutes, for reasons of its own; then the beacon wavers: looked into at once."""
    bench = rated()
    bench.ros.change(beacons=beating())
    bench.after(300.0, lambda passed: bench.ros.change(topics=flowing(passed)))
    bench.processes(MAIN)
    bench.ros.change(beacons=beating(0.5))
    bench.clock.advance(0.25)
    assert bench.result().brief == "node_1 dead"


def test_an_old_name_beside_the_new_one_is_no_standing_doubt() -> None:
    """It stays for a lease of 20 s; a node that dies meanwhile is seen as soon as ever."""
    bench = rated()
    bench.ros.change(nodes={})
    bench.after(GRACE_S)
    bench.ros.change(nodes={NAME: 2})
    assert bench.after(12.0).level is api.Level.OK
    bench.processes(MAIN)
    bench.ros.change(topics=flowing(0.25))
    bench.clock.advance(0.25)
    assert bench.result().brief == "node_1 dead"


def test_an_engine_that_hangs_is_asked_once_a_run() -> None:
    """Each question may take its whole deadline, and the check has one, too."""
    keys = ("one", "two", "three")
    settings = testing.settings(
        containers=[{"name": key} for key in keys],
        ros={"nodes": [{"name": f"/{key}", "container": key} for key in keys]},
    )
    (check,) = Nodes.build(settings)
    clock, asked = testing.FakeClock(), list[str]()

    class Hanging(testing.FakeDocker):
        def container(self, name: str) -> api.ContainerFact | None:
            asked.append(name)
            clock.advance(5.0)
            raise api.CannotTell("the Docker Engine did not answer within 5.0 s")

    world = testing.world(clock=clock, docker=Hanging(), ros=testing.FakeRos(nodes={f"/{key}": 1 for key in keys}))
    for number in range(1, 4):
        results = check.run(world)
        assert len(asked) == number
        assert not isinstance(results, api.Result)
        assert {result.level for result in results.values()} == {api.Level.OK}


def test_a_list_that_grew_old_proves_nothing() -> None:
    """Should the check be held up, what was seen before that does not count."""
    bench = Bench()
    bench.after(3.0)
    bench.processes(MAIN)
    bench.after(BLIND_S)
    bench.docker.fail()
    bench.clock.advance(OLD_S + 1)
    assert bench.result().level is api.Level.OK


# ---------------------------------------------------------------- a container that is ending


@pytest.mark.parametrize("left", [(), (TWO,)])
def test_who_is_missing_in_a_container_that_is_ending_is_not_dead(left: tuple[api.ProcessFact, ...]) -> None:
    """Its first process was killed, the others go one by one, and the engine says that it runs for a second yet."""
    bench = Contained()
    bench.processes(*left)
    bench.ros.change(nodes={})
    result = bench.after(2.0)
    assert (result.level, result.condition) == (api.Level.STALE, "")
    assert "its container is stopping: its first process 70 has ended" in result.summary
    bench.docker.change("ros_app", status="exited")
    assert "its container is exited" in bench.after(2.0).summary


def test_a_dead_node_beside_the_first_process_is_dead() -> None:
    """The container does not end: one look is enough, as ever."""
    bench = Contained()
    bench.processes(MAIN)
    bench.ros.change(nodes={})
    assert bench.after(1.0).condition == "node_missing"


def test_a_new_life_ends_the_ending() -> None:
    """The engine has restarted it: its new first process is another one."""
    bench = Contained()
    bench.processes()
    bench.ros.change(nodes={})
    assert bench.after(1.0).level is api.Level.STALE
    bench.docker.change("ros_app", pid=170)
    bench.restart_container(replace(MAIN, pid=170), replace(ONE, pid=171))
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(1.0).level is api.Level.OK


def test_an_engine_that_never_notices_the_end_hides_no_dead_node() -> None:
    """A container that is said to run without its first process for longer than any end takes: its nodes are dead."""
    bench = Contained()
    bench.processes()
    bench.ros.change(nodes={})
    assert bench.after(ENDING_S - 1.0).level is api.Level.STALE
    assert bench.after(QUIET_S).condition == "node_missing"


def test_lists_that_never_show_the_first_process_prove_no_end() -> None:
    """Where the engine's list has other numbers than its state, a missing process is a dead node."""
    bench = Bench()
    bench.result()
    bench.processes()
    bench.ros.change(nodes={})
    assert bench.after(1.0).condition == "node_missing"
