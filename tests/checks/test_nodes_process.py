"""Slot 6: what the process and the beacon of a node prove."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm import api
from phm.recovery.ladders import LADDERS
from phm_checks._graph_evidence import LATE_S
from phm_checks._liveness import HANG_S, LOST_S
from phm_checks._process_table import BLIND_S, QUIET_S
from phm_checks.nodes import BUSY_S
from tests.fakes.nodes_bench import (
    MAIN,
    NAME,
    ONE,
    TOPIC,
    Bench,
    active_topic,
    live_beacon,
    rated,
)


def test_a_killed_node_is_dead_as_soon_as_its_topic_is_late() -> None:
    """Still listed, silent for less than its limit: the process list is requested immediately and proves it."""
    bench = rated()
    bench.after(3.0)
    bench.processes(MAIN)
    bench.ros.change(topics=active_topic(0.25))
    bench.clock.advance(0.25)
    result = bench.result()
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "node_missing", "node_1 dead")
    assert ": its process 71 has ended; silent for 0.2 s: topic_1; " in result.summary


def test_only_evidence_from_its_process_is_conclusive() -> None:
    """A terminated or stopped process was observed directly; a node may leave the graph because of a delay."""
    bench = rated()
    bench.after(3.0)
    assert not bench.result().evidence.conclusive
    bench.processes(MAIN, api.ProcessFact(71, 1, "T", 5.0, ONE.command))
    bench.ros.change(topics=active_topic(0.5))
    stopped = bench.after(1.0)
    assert (stopped.condition, stopped.evidence.conclusive) == ("node_hung", True)
    bench.processes(MAIN, ONE)
    bench.ros.change(nodes={})
    left = bench.after(LOST_S + 3.0)
    assert (left.condition, left.evidence.conclusive) == ("node_missing", False)
    bench.processes(MAIN)
    dead = bench.after(12.0)
    assert (dead.condition, dead.evidence.conclusive) == ("node_missing", True)


@pytest.mark.parametrize("processes", [(MAIN,), (MAIN, replace(ONE, state="T"))], ids=["ended", "stopped"])
def test_a_process_that_was_lost_after_its_start_does_not_come_back_by_waiting(
    processes: tuple[api.ProcessFact, ...],
) -> None:
    """So it counts during the grace after another recovery. While its container starts, a launcher may replace processes."""
    bench = rated()
    bench.after(3.0)
    bench.processes(*processes)
    bench.ros.change(topics=active_topic(0.5))
    assert bench.after(1.0).evidence.certain
    bench.restart_container(MAIN, ONE)
    bench.ros.change(topics=active_topic())
    bench.after(3.0)
    bench.processes(*processes)
    bench.ros.change(topics=active_topic(0.5))
    lost = bench.after(2.0)
    assert (lost.level, lost.evidence.conclusive, lost.evidence.certain) == (api.Level.ERROR, True, False)


def test_a_node_that_only_left_the_graph_may_come_back_by_waiting() -> None:
    """Its process runs: leases expire on a busy machine."""
    bench = rated()
    bench.after(3.0)
    bench.ros.change(nodes={}, topics=active_topic(9.0))
    left = bench.after(LOST_S + 3.0)
    assert (left.condition, left.evidence.certain) == ("node_missing", False)


def test_a_killed_node_is_dead_as_soon_as_its_beacon_is_late() -> None:
    """Two missed heartbeats trigger a process list, which proves it."""
    bench = Bench()
    bench.ros.change(beacons=live_beacon())
    bench.after(3.0)
    bench.processes(MAIN)
    bench.ros.change(beacons=live_beacon(0.55))
    bench.clock.advance(0.25)
    assert bench.result().brief == "node_1 dead"


def test_a_node_without_signs_of_life_is_polled() -> None:
    """Killed, still listed for 20 s, no beacon, no topic: the process list is requested every BLIND_S."""
    bench = Bench()
    bench.after(3.0)
    bench.processes(MAIN)
    assert bench.after(BLIND_S + 0.25).brief == "node_1 dead"


@pytest.mark.parametrize("state", ["T", "t"])
def test_a_stopped_node_is_hung(state: str) -> None:
    """SIGSTOP: the process exists, listed or not, and does not respond."""
    bench = rated()
    bench.after(3.0)
    bench.processes(MAIN, api.ProcessFact(71, 1, state, 5.0, ONE.command))
    bench.ros.change(topics=active_topic(0.5))
    bench.clock.advance(0.25)
    result = bench.result()
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "node_hung", "node_1 hung")
    assert result.target == "ros_app"
    assert f"its process 71 is stopped (state {state}" in result.summary
    bench.ros.change(nodes={}, topics={})
    assert bench.after(5.0).condition == "node_hung"
    bench.processes(MAIN, ONE)
    bench.ros.change(nodes={NAME: 1}, topics=active_topic())
    assert bench.after(1.5).level is api.Level.OK


@pytest.mark.parametrize("state", ["R", "S"])
def test_a_busy_node_is_not_dead(state: str) -> None:
    """A callback computes for 5 s, on the main thread or another one: its beacon and its topic fall silent."""
    bench = rated()
    bench.ros.change(beacons=live_beacon())
    bench.after(3.0)
    levels = []

    def busy(passed: float) -> None:
        bench.processes(MAIN, api.ProcessFact(71, 1, state, 5.0 + passed // 1, ONE.command))
        bench.ros.change(topics=active_topic(passed), beacons=live_beacon(0.1, late_s=passed))
        levels.append(bench.result().level)

    result = bench.after(5.0, busy)
    assert result.level is api.Level.OK
    assert "its process 71 is using the CPU" in result.summary
    assert api.Level.ERROR not in levels
    assert bench.after(BUSY_S, lambda passed: busy(5.0 + passed)).condition == "node_busy"


def test_a_node_that_waits_for_a_disk_is_not_hung() -> None:
    """State D: it does not use the CPU because it cannot, and a restart would wait for the same disk. So nothing acts on it."""
    bench = rated()
    bench.ros.change(beacons=live_beacon())
    bench.after(3.0)

    def waiting(passed: float) -> None:
        bench.processes(MAIN, api.ProcessFact(71, 1, "D", 5.0, ONE.command))
        bench.ros.change(topics=active_topic(passed), beacons=live_beacon(0.1, late_s=passed))

    result = bench.after(20.0, waiting)
    assert result.condition == "node_unanswering" and not result.evidence.conclusive
    assert "its process 71 waits for a disk or a device (state D)" in result.summary


def test_a_sleeping_executor_is_blocked_and_then_hung() -> None:
    """A deadlock: the beacon reports it, its topic is silent, the process sleeps. It is blocked, for which
    nothing is restarted, when both are late, and hung after HANG_S."""
    bench = rated()
    bench.ros.change(beacons=live_beacon())
    bench.after(3.0)
    found: list[tuple[str, float]] = []

    def asleep(passed: float) -> None:
        bench.ros.change(topics=active_topic(passed), beacons=live_beacon(0.1, late_s=passed))
        result = bench.result()
        word = result.condition or result.level.name
        if not found or found[-1][0] != word:
            found.append((word, passed))

    result = bench.after(HANG_S + 0.5, asleep)
    assert (result.level, result.condition) == (api.Level.ERROR, "node_hung")
    assert "its executor has been blocked for" in result.summary
    assert [word for word, _ in found] == ["OK", "node_blocked", "node_hung"]
    since = dict(found)
    assert LATE_S < since["node_blocked"] <= LATE_S + 0.5 and since["node_hung"] == HANG_S
    assert "node_blocked" not in LADDERS


def test_a_blocked_node_without_topics_waits_until_it_is_hung() -> None:
    """Its beacon alone: nothing shows that a message is missing."""
    bench = Bench()
    bench.ros.change(beacons=live_beacon())
    bench.after(8.0)
    conditions = []

    def asleep(passed: float) -> None:
        bench.ros.change(beacons=live_beacon(0.1, late_s=passed))
        conditions.append(bench.result().condition)

    assert bench.after(HANG_S + 0.5, asleep).condition == "node_hung"
    assert set(conditions) == {"", "node_hung"}


@pytest.mark.parametrize(("late_s", "condition"), [(0.0, ""), (20.0, "node_hung")])
def test_a_node_that_only_phm_does_not_receive_is_judged_by_what_others_receive(late_s: float, condition: str) -> None:
    """PHM's own participant lost it: asleep, silent here, and alive, or hung, according to another node. Later no other node receives it either."""
    bench = rated()
    bench.after(3.0)

    def unreceived(passed: float, *, alive: bool = True) -> None:
        views = {NAME: api.NeighbourFact(alive, 0.5, late_s)}
        own = replace(live_beacon(passed)[NAME], witness="one")
        other = api.BeaconFact(0.1, 0.2, turns=20, views=views, witness="other")
        bench.ros.change(topics=active_topic(passed), beacons={NAME: own, "/agent_1/node_9": other})

    result = bench.after(3 * HANG_S, unreceived)
    assert result.condition == condition
    assert result.level is (api.Level.ERROR if condition else api.Level.OK)
    assert not condition or "PHM does not receive its beacon, but /agent_1/node_9 does" in result.summary
    assert bench.after(0.5, lambda passed: unreceived(3 * HANG_S + passed, alive=False)).condition == "node_hung"


def test_a_silent_topic_of_a_live_node_is_not_a_fault_of_the_node() -> None:
    """Its process runs and it is listed: the topic has its own report."""
    bench = rated()
    bench.after(3.0)
    assert bench.after(60.0, lambda passed: bench.ros.change(topics=active_topic(passed))).level is api.Level.OK


@pytest.mark.parametrize("figures", ["lost", "never there", "no list"])
def test_a_node_without_cpu_figures_of_its_process_is_not_hung(figures: str) -> None:
    """The engine no longer reports the CPU time, as after one HTTP 500: the node may be busy and is not restarted."""
    bench = rated()
    bench.ros.change(beacons=live_beacon())
    if figures == "never there":
        bench.processes(MAIN, replace(ONE, cpu_s=None))
    bench.after(12.0)
    if figures == "lost":
        bench.processes(MAIN, replace(ONE, cpu_s=None))
    elif figures == "no list":
        del bench.docker.lists["ros_app"]
    seen: list[str] = []

    def hang(passed: float) -> None:
        bench.ros.change(topics=active_topic(passed), beacons=live_beacon(0.1, late_s=passed))
        seen.append(bench.result().condition)

    result = bench.after(60.0, hang)
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "node_unanswering",
        "node_1 does not answer",
    )
    assert set(seen) == {"", "node_unanswering"}
    assert "node_unanswering" not in LADDERS


def test_an_unknown_process_is_not_a_dead_node() -> None:
    """An engine that lists nothing, refuses or is silent proves nothing about nodes."""
    bench = rated()
    bench.after(3.0)
    del bench.docker.lists["ros_app"]
    assert bench.after(5.0, lambda passed: bench.ros.change(topics=active_topic(passed))).level is api.Level.OK


@pytest.mark.parametrize("gone", [True, False])
def test_a_silent_engine_does_not_hide_a_dead_node(gone: bool) -> None:
    """Then only the graph decides."""
    bench = Bench()
    bench.docker.fail()
    bench.result()
    if gone:
        bench.ros.change(nodes={})
    assert bench.after(1.0).level is (api.Level.ERROR if gone else api.Level.OK)


def test_without_a_known_process_the_beacon_decides() -> None:
    """Silent for three periods: it has its own thread, so the process is dead or stopped."""
    bench = Bench()
    bench.processes(MAIN)
    bench.ros.change(beacons=live_beacon())
    bench.after(3.0)
    bench.ros.change(beacons=live_beacon(0.75))
    result = bench.result()
    assert (result.level, result.condition) == (api.Level.ERROR, "node_missing")
    assert ": its beacon has been silent for 0.8 s; it is listed in the graph" in result.summary


@pytest.mark.parametrize("silent", ["beacon", "topic"])
def test_a_late_ros_child_makes_no_node_silent(silent: str) -> None:
    """While PHM's own child process is late, no node is received: that is not their silence, and costs no list."""
    bench = rated()
    bench.processes(MAIN)
    bench.ros.change(
        beacons=live_beacon() if silent == "beacon" else {}, topics=active_topic() if silent == "topic" else {}
    )
    bench.after(20.0)
    before = bench.docker.listings
    bench.ros.change(age_s=2.0)
    if silent == "beacon":
        bench.ros.change(beacons=live_beacon(2.2))
    else:
        bench.ros.change(topics=active_topic(2.0))
    assert bench.result().level is api.Level.OK
    assert bench.docker.listings == before


def test_a_large_topic_that_is_sampled_in_windows_is_not_late() -> None:
    """Between two windows nothing is sampled: that is PHM's own doing and costs no list."""
    bench = rated()
    rate = api.RateFact(10.0, 2.0, limit_s=5.0, sample_bytes=1e6)
    bench.ros.change(topics={TOPIC: api.TopicFact((api.EndpointFact(NAME, ""),), (), rate)})
    bench.after(20.0)
    before = bench.docker.listings
    bench.after(9.0)
    assert bench.docker.listings - before <= 1


def test_an_unwatched_executor_is_never_late() -> None:
    """A beacon may be configured not to watch it; then its lateness is meaningless."""
    bench = Bench()
    bench.ros.change(beacons={NAME: api.BeaconFact(0.1, 0.2, 60.0, "a", 100, turns=0)})
    assert bench.after(3.0).level is api.Level.OK


def test_a_beacon_of_the_previous_node_does_not_count() -> None:
    """The node is in the graph again, as another program without a beacon: the silence is that of its predecessor."""
    bench = Bench()
    bench.processes(MAIN)
    bench.ros.change(beacons=live_beacon())
    bench.after(3.0)
    silence = 0.0

    def silent(passed: float) -> None:
        bench.ros.change(beacons=live_beacon(silence + passed))

    bench.ros.change(nodes={})
    assert bench.after(2.0, silent).brief == "node_1 dead"
    silence = 2.0
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(2.0, silent).level is api.Level.OK


def hung(*, cpu: bool = True) -> Bench:
    """A node with a beacon, hung for 20 s. cpu: whether the CPU time of its process is known."""
    bench = rated()
    bench.processes(MAIN, ONE if cpu else replace(ONE, cpu_s=None))
    bench.ros.change(beacons=live_beacon())
    bench.after(3.0)
    bench.after(20.0, lambda passed: bench.ros.change(topics=active_topic(passed), beacons=live_beacon(passed)))
    return bench


@pytest.mark.parametrize("cpu", [True, False], ids=["hung", "unanswering"])
@pytest.mark.parametrize("sign", ["beacon", "data", "process"])
def test_a_hung_node_is_not_alive_because_a_new_ros_child_lists_it(cpu: bool, sign: str) -> None:
    """The new child never received its beacon, and the threads of the middleware announce the name of a process that hangs. Only the
    node itself shows that it runs, or another process of it."""
    bench = hung(cpu=cpu)
    assert bench.result().condition == ("node_hung" if cpu else "node_unanswering")
    bench.ros.change(up_s=0.5, nodes={}, topics={}, beacons={})
    bench.after(2.0)
    bench.ros.change(up_s=60.0, nodes={NAME: 1})
    levels = set()
    result = bench.after(60.0, lambda passed: levels.add(bench.result().level))
    assert levels == {api.Level.STALE}
    assert "it was hung, and has given no sign of life since" in result.summary
    if sign == "process":
        bench.processes(MAIN, replace(ONE, pid=99))
    else:
        bench.ros.change(**{"beacons": live_beacon()} if sign == "beacon" else {"topics": active_topic()})
    assert bench.after(12.0).level is api.Level.OK


def test_a_hung_node_that_is_listed_again_is_hung() -> None:
    """Its network was interrupted for a moment: the process is the same, so the silence of its beacon continues. A new process may
    have none."""
    bench = hung()
    bench.ros.change(nodes={})
    assert bench.after(0.5).level is api.Level.STALE
    bench.ros.change(nodes={NAME: 1})
    result = bench.after(10.0, lambda passed: bench.ros.change(beacons=live_beacon(20.0 + passed)))
    assert (result.condition, "its beacon has been silent" in result.summary) == ("node_hung", True)
    bench.processes(MAIN, replace(ONE, pid=99))
    bench.ros.change(nodes={NAME: 2})
    assert bench.after(1.0).level is api.Level.OK
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(20.0).level is api.Level.OK


def test_a_resumed_node_that_sends_nothing_is_alive() -> None:
    """It was hung because it was stopped, not according to a beacon, so nothing else can show that it runs."""
    bench = Bench()
    bench.after(3.0)
    bench.processes(MAIN, replace(ONE, state="T"))
    assert bench.after(3.0).condition == "node_hung"
    bench.processes(MAIN, ONE)
    assert bench.after(3.0).level is api.Level.OK


def test_another_publisher_is_not_a_sign_of_life() -> None:
    """A topic with data from elsewhere proves nothing about the node."""
    bench = rated()
    bench.processes(MAIN)
    bench.after(1.0)
    other = api.TopicFact((api.EndpointFact("/agent_1/other", ""),), (), api.RateFact(10.0, 0.0))
    bench.ros.change(nodes={}, topics={TOPIC: other})
    assert bench.after(1.0).brief == "node_1 dead"


# ---------------------------------------------------------------- processes of others


NAMELESS = api.ProcessFact(71, 1, "S", 5.0, "python -m acme.node", 60.0)


def tool(age_s: float) -> api.ProcessFact:
    """A program with the node's name in its command line, e.g. of `docker exec`."""
    return api.ProcessFact(90, 0, "S", 1.0, "tail -f /logs/node_1/out", age_s)


def never_bad(bench: Bench, seconds: float, silent_s: float = 0.05) -> None:
    """The node's topic flows for so long, and it is OK in each run."""

    def ok(passed: float) -> None:
        if bench.ros.fact.topics:
            bench.ros.change(topics=active_topic(silent_s))
        assert bench.result().level is api.Level.OK, bench.result().summary

    bench.after(seconds, ok)


@pytest.mark.parametrize("flows", [True, False])
def test_a_tool_that_names_the_node_and_ends_does_not_end_the_node(flows: bool) -> None:
    """The node's own command line does not name it: a tool that began after the node had appeared is not its process."""
    bench = rated() if flows else Bench()
    bench.processes(MAIN, NAMELESS)
    never_bad(bench, 20.0)
    bench.processes(MAIN, NAMELESS, tool(1.0))
    never_bad(bench, 20.0)
    assert bench.result().values["process"] == "none found"
    bench.processes(MAIN, NAMELESS)
    never_bad(bench, 30.0)


def test_the_end_of_another_program_is_disproved_by_what_the_node_sends() -> None:
    """The program began before the node, so it is taken for its process. It ends, and the topic flows: it was not, and it is not missing
    from the next start either."""
    bench = rated()
    bench.processes(MAIN, NAMELESS, tool(60.0))
    never_bad(bench, 20.0)
    assert bench.result().values["process"] == "90 S"
    bench.processes(MAIN, NAMELESS)
    never_bad(bench, 20.0)
    assert bench.result().values["process"] == "none found"
    bench.restart_container(MAIN, NAMELESS)
    never_bad(bench, 30.0)


def test_a_duplicate_is_not_missing_after_the_restart_that_ended_it() -> None:
    """It alone had the node's name in its command line, and its restarted original never has: seen in a campaign, where the container
    was restarted again and again."""
    bench = rated()
    bench.processes(MAIN, NAMELESS)
    never_bad(bench, 20.0)
    bench.ros.change(nodes={NAME: 2})
    bench.processes(MAIN, NAMELESS, replace(ONE, pid=95, age_s=0.0))
    bench.after(12.0)
    assert bench.result().values["process"] == "95 S"
    bench.restart_container(MAIN, NAMELESS)
    bench.ros.change(nodes={NAME: 1}, topics=active_topic(0.05))
    never_bad(bench, 40.0)


def test_a_node_without_data_that_appears_after_a_restart_runs_as_another_process() -> None:
    """Nothing matches it in the new container, which may name its processes differently: the graph lists it, so it runs."""
    bench = Bench()
    bench.after(3.0)
    bench.ros.change(nodes={})
    bench.restart_container(MAIN, NAMELESS)
    bench.after(2.0)
    bench.ros.change(nodes={NAME: 1})
    never_bad(bench, 40.0)


def test_a_killed_node_with_a_slow_topic_is_dead_when_its_message_is_late() -> None:
    """Its process is missing from a list that was made for another reason, less than OVERDUE_S after its last message."""
    bench = Bench(topics=[{"name": TOPIC, "rate": 0.2, "publishers": [NAME]}])
    bench.ros.change(topics=active_topic())
    bench.after(3.0)
    bench.processes(MAIN)
    bench.clock.advance(QUIET_S)
    assert bench.after(1.0, lambda passed: bench.ros.change(topics=active_topic(passed))).level is api.Level.OK
    result = bench.after(2.0, lambda passed: bench.ros.change(topics=active_topic(1.0 + passed)))
    assert result.condition == "node_missing" and result.evidence.certain
