"""The beacon in real processes, received by the real child: live nodes send, hung ones report it, dead ones are silent."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from phm.facts import BeaconFact, CannotTell, RosFact
from phm.probes.ros.supervisor import RosSupervisor
from tests.fakes.ros_bench import ROOT, Bench, seen, until

A, B, C = "/agent_1/a", "/agent_1/b", "/agent_1/c"
SCRIPT = "ros_beaconed.py"
HUNG_S = 1.5
NODES = [{"name": f"/agent_1/{name}"} for name in ("a", "b", "c", "d", *(f"n{number}" for number in range(10)))]


def all_alive(fact: RosFact, *names: str) -> bool:
    """Whether all of them send beacons and their executors run."""
    return all(name in fact.beacons and fact.beacons[name].missed < 2 and fact.beacons[name].turns for name in names)


def all_see_each_other(fact: RosFact, *names: str) -> bool:
    """Whether each of them receives all others."""
    return all(
        fact.beacons[name].views.get(other) is not None and fact.beacons[name].views[other].alive
        for name in names
        for other in names
        if name in fact.beacons and name != other
    ) and all_alive(fact, *names)


def recorded(
    probe: RosSupervisor, name: str, value: Callable[[BeaconFact], float], into: list[float]
) -> Callable[[], None]:
    """For `Bench.on_change`: records a value of its beacon. A moment in which the probe cannot tell has none, as in `seen`: raised
    here, in the probe's thread, it would end the child.
    """

    def record() -> None:
        with contextlib.suppress(CannotTell):
            fact = probe.snapshot().beacons.get(name)
            if fact is not None:
                into.append(value(fact))

    return record


def test_nodes_with_a_beacon_are_received_by_phm_and_each_other(bench: Bench) -> None:
    """One line in each node: PHM receives all, each receives the others, and only a hidden node is added to the graph."""
    for name in ("a", "b", "c"):
        bench.script(SCRIPT, name)
    probe = bench.probe(nodes=NODES)
    seen(probe, lambda fact: all_see_each_other(fact, A, B, C), "three nodes that receive each other")
    fact = seen(
        probe, lambda fact: set(fact.nodes) >= {A, B, C} and len(fact.beacons) >= 3 and fact, "their names in the graph"
    )
    assert set(fact.nodes) == {A, B, C}
    assert "/phm/beacon" not in fact.others and fact.refused == 0
    assert {beacon.period_s for beacon in fact.beacons.values()} == {0.2}
    assert len({beacon.witness for beacon in fact.beacons.values()}) == 3
    seen(  # a starved executor is late for a while; one that works is punctual again
        probe,
        lambda fact: all_alive(fact, A, B, C) and not any(beacon.late_s for beacon in fact.beacons.values()),
        "three punctual executors",
    )


@pytest.mark.one_distribution
def test_a_killed_node_falls_silent_and_checks_are_woken(bench: Bench) -> None:
    """SIGKILL: no more beacons arrive; the probe reports it without being polled, and the neighbour reports it too."""
    node = bench.script(SCRIPT, "a")
    bench.script(SCRIPT, "b")
    probe = bench.probe(nodes=NODES)
    seen(probe, lambda fact: all_see_each_other(fact, A, B), "both nodes")
    doubts: list[float] = []
    bench.on_change = recorded(probe, A, lambda fact: fact.missed, doubts)
    node.kill()
    until(lambda: any(missed > 3 for missed in doubts), "a wake-up for its silence")
    seen(probe, lambda fact: not fact.beacons[B].views[A].alive, "its neighbour's word")
    seen(probe, lambda fact: all_alive(fact, B), "the neighbour's own beacons")


@pytest.mark.one_distribution
def test_a_stopped_node_is_silent_and_resumes_with_its_identity(bench: Bench) -> None:
    """SIGSTOP and SIGCONT: silence, then the same life; the suspended time does not count as executor lateness."""
    node = bench.script(SCRIPT, "a")
    probe = bench.probe(nodes=NODES)
    before = seen(probe, lambda fact: all_alive(fact, A) and fact.beacons[A], "the node")
    node.send_signal(signal.SIGSTOP)
    seen(probe, lambda fact: A in fact.beacons and fact.beacons[A].age_s > 8.0, "its silence")
    lateness: list[float] = []
    changes = bench.changes
    bench.on_change = recorded(probe, A, lambda fact: fact.late_s, lateness)
    node.send_signal(signal.SIGCONT)
    after = seen(probe, lambda fact: all_alive(fact, A) and fact.beacons[A], "its return")
    assert after.birth == before.birth
    until(lambda: bench.changes > changes, "a wake-up for its return")
    assert max([after.late_s, *lateness]) < 5.0, "the suspended time, which would be at least 6 s late, counts"
    seen(probe, lambda fact: all_alive(fact, A) and fact.beacons[A].late_s < 1.0, "its punctual executor")


@pytest.mark.parametrize("executor", ["single", "multi"])
def test_a_deadlocked_executor_is_reported_by_its_live_process(bench: Bench, executor: str) -> None:
    """A callback that never returns: beacons continue, lateness grows, and the neighbour forwards it; also with several
    threads.
    """
    node = bench.script(SCRIPT, "a", "--executor", executor)
    bench.script(SCRIPT, "b")
    probe = bench.probe(nodes=NODES)
    seen(probe, lambda fact: all_see_each_other(fact, A, B), "both nodes")
    node.send_signal(signal.SIGUSR1)
    fact = seen(probe, lambda fact: fact.beacons[A].late_s > HUNG_S and fact, "its lateness")
    more_s = fact.beacons[A].late_s + HUNG_S
    seen(
        probe, lambda fact: fact.beacons[A].late_s > more_s and fact.beacons[A].missed < 3, "its beacons that continue"
    )
    seen(probe, lambda fact: fact.beacons[B].views[A].late_s > HUNG_S, "its neighbour's word")
    seen(probe, lambda fact: all_alive(fact, B) and fact.beacons[B].late_s == 0.0, "the neighbour's own executor")


@pytest.mark.one_distribution
def test_a_separate_hanging_callback_group_does_not_hang_the_executor(bench: Bench) -> None:
    """With several threads, a hanging callback in a separate group blocks no other callback of the node."""
    node = bench.script(SCRIPT, "a", "--executor", "multi", "--hang", "own")
    probe = bench.probe(nodes=NODES)
    seen(probe, lambda fact: all_alive(fact, A), "the node")
    node.send_signal(signal.SIGUSR1)
    turns = seen(probe, lambda fact: fact.beacons[A].turns, "its turns")
    seen(
        probe, lambda fact: fact.beacons[A].turns > turns + 4 and fact.beacons[A].late_s == 0.0, "the turns that go on"
    )


@pytest.mark.one_distribution
def test_a_restarted_node_has_another_birth(bench: Bench) -> None:
    """As a process, and as a node that is recreated in the same process: one more life, reported by the same process
    there.
    """
    process = bench.script(SCRIPT, "a")
    bench.script(SCRIPT, "b", "c")
    probe = bench.probe(nodes=NODES)
    before = seen(probe, lambda fact: all_see_each_other(fact, A, B) and dict(fact.beacons), "both processes")
    process.kill()
    began_s = time.monotonic()
    bench.script(SCRIPT, "a")
    after = seen(probe, lambda fact: fact.beacons[A].birth != before[A].birth and fact.beacons[A], "another birth")
    assert after.witness != before[A].witness
    assert after.heartbeats <= (time.monotonic() - began_s) / after.period_s + 2, "its own, counted from its start"


def test_a_destroyed_node_falls_silent_and_its_successor_is_a_new_one(bench: Bench) -> None:
    """destroy_node ends its beacon, while the other node of the process continues."""
    process = bench.script(SCRIPT, "a", "b")
    probe = bench.probe(nodes=NODES)
    before = seen(probe, lambda fact: all_alive(fact, A, B) and dict(fact.beacons), "both nodes")
    assert before[A].witness == before[B].witness and before[A].birth != before[B].birth
    process.send_signal(signal.SIGUSR2)
    after = seen(probe, lambda fact: fact.beacons[A].birth != before[A].birth and dict(fact.beacons), "its successor")
    assert after[A].witness == before[A].witness
    assert after[B].birth == before[B].birth
    seen(probe, lambda fact: all_alive(fact, A, B), "both nodes")


@pytest.mark.one_distribution
def test_a_network_split_is_seen_by_the_separated_nodes(bench: Bench) -> None:
    """Two pairs that do not receive each other, while PHM receives all."""
    for name in ("a", "b"):
        bench.script(SCRIPT, name)
    for name in ("c", "d"):
        bench.script(SCRIPT, name, "--hello", "/elsewhere")
    probe = bench.probe(nodes=NODES)
    names = {A, B, C, "/agent_1/d"}
    fact = seen(
        probe,
        lambda fact: all_see_each_other(fact, A, B) and all_see_each_other(fact, C, "/agent_1/d") and fact,
        "two groups",
    )
    assert set(fact.beacons) == names
    assert set(fact.beacons[A].views) == {B} and set(fact.beacons["/agent_1/d"].views) == {C}


@pytest.mark.one_distribution
def test_ten_nodes_receive_each_other(bench: Bench) -> None:
    """Five processes with two nodes each: every node knows all nodes of other processes."""
    for first in range(0, 10, 2):
        bench.script(SCRIPT, f"n{first}", f"n{first + 1}")
    probe = bench.probe(nodes=NODES)
    names = [f"/agent_1/n{number}" for number in range(10)]

    def complete(fact: RosFact) -> bool:
        if not all_alive(fact, *names):
            return False
        processes = {name: fact.beacons[name].witness for name in names}
        return all(
            {other for other in names if processes[other] != processes[name]}
            == {other for other, view in fact.beacons[name].views.items() if view.alive}
            for name in names
        )

    seen(probe, complete, "ten nodes, each with eight others in its view", limit_s=120.0)


@pytest.mark.parametrize("option", ["--lifecycle", "--sim-time"])
def test_lifecycle_nodes_and_simulated_time_make_no_difference(bench: Bench, option: str) -> None:
    """An inactive lifecycle node is alive and its executor runs; so does a node whose clock is stopped."""
    bench.script(SCRIPT, "a", option)
    seen(
        bench.probe(nodes=NODES),
        lambda fact: all_alive(fact, A) and fact.beacons[A].turns > 2 and fact.beacons[A].late_s == 0,
        option,
    )


@pytest.mark.one_distribution
@pytest.mark.parametrize("option", ["--no-spin", "--no-watch"])
def test_a_node_that_is_never_spun_or_not_watched_never_looks_hung(bench: Bench, option: str) -> None:
    """Its beacon reports only that its process is alive."""
    bench.script(SCRIPT, "a", option)
    fact = seen(
        bench.probe(nodes=NODES), lambda fact: A in fact.beacons and fact.beacons[A].heartbeats > 10 and fact, option
    )
    assert (fact.beacons[A].turns, fact.beacons[A].late_s) == (0, 0.0)


@pytest.mark.one_distribution
def test_other_periods_are_reported_and_respected(bench: Bench) -> None:
    """A slow beacon is not silent between its messages."""
    bench.script(SCRIPT, "a", "--period", "1.0")
    probe = bench.probe(nodes=NODES)
    fact = seen(probe, lambda fact: A in fact.beacons and fact.beacons[A].heartbeats > 3 and fact, "the node")
    assert fact.beacons[A].period_s == 1.0
    seen(probe, lambda fact: fact.beacons[A].age_s > 0.6 and fact.beacons[A].missed < 2, "a pause between its messages")


STANDALONE = """
import sys, time
import rclpy
from beacon import Beacon
for module in sys.modules:
    assert module.partition(".")[0] not in ("phm", "std_msgs", "diagnostic_msgs"), module
rclpy.init(args=[])
node = rclpy.create_node("alone")
for wrong in (0.0, 11.0, float("nan")):
    try:
        Beacon(node, period_s=wrong)
    except ValueError:
        continue
    raise AssertionError(wrong)
beacon = Beacon(node)
end = time.monotonic() + 180
print("up", flush=True)
while sys.argv[1] == "wait" and time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
if sys.argv[1] == "close":
    beacon.close()
    beacon.close()
if sys.argv[1] in ("destroy", "all"):
    node.destroy_node()
if sys.argv[1] in ("shutdown", "all"):
    rclpy.shutdown()
if sys.argv[1] == "again":
    for _ in range(3):
        rclpy.shutdown()
        rclpy.init(args=[])
        other = rclpy.create_node("alone")
        Beacon(other)
        for _ in range(3):
            rclpy.spin_once(other, timeout_sec=0.1)
if sys.argv[1] == "broken":
    Beacon(object())
if sys.argv[1] == "late":
    Beacon(node)
    rclpy.shutdown()
    Beacon(node)
"""


def alone(bench: Bench, folder: Path, how: str, **environ: str) -> subprocess.Popen[bytes]:
    """A program with only this file beside it, and nothing else of PHM."""
    (folder / "beacon.py").write_bytes((ROOT / "phm" / "beacon.py").read_bytes())
    (folder / "node.py").write_text(STANDALONE, encoding="ascii")
    environ = {**bench.environ, "PYTHONPATH": "", **environ}
    return subprocess.Popen(
        [sys.executable, str(folder / "node.py"), how], env=environ, cwd=folder, stderr=subprocess.PIPE
    )


def test_the_file_works_standalone(bench: Bench, tmp_path: Path) -> None:
    """Copied beside a node it is sufficient: neither PHM nor std_msgs is imported."""
    process = alone(bench, tmp_path, "wait")
    try:
        seen(bench.probe(nodes=NODES), lambda fact: all_alive(fact, "/alone"), "the node")
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("how", ["return", "close", "destroy", "shutdown", "all", "again", "broken", "late"])
def test_programs_end_as_without_a_beacon(bench: Bench, tmp_path: Path, how: str) -> None:
    """However a program ends, with code 0 and no error output; a beacon that cannot be created does not end the
    program.
    """
    _, errors = (process := alone(bench, tmp_path, how)).communicate(timeout=60)
    assert process.returncode == 0, errors.decode()
    assert b"Traceback" not in errors and b"terminate" not in errors, errors.decode()


@pytest.mark.one_distribution
def test_the_environment_turns_it_off(bench: Bench, tmp_path: Path) -> None:
    """PHM_BEACON=off: the node runs without a beacon."""
    process = alone(bench, tmp_path, "wait", PHM_BEACON="off")
    try:
        probe = bench.probe(nodes=NODES)
        fact = seen(probe, lambda fact: "/alone" in fact.nodes and fact.up_s > 5 and fact, "the node")
        assert not fact.beacons
    finally:
        process.kill()
        process.communicate()


def test_a_forked_process_does_not_join_the_parents_beacon(bench: Bench, tmp_path: Path) -> None:
    """The parent's thread does not exist in it, so joining its beacon would be silent."""
    script = tmp_path / "fork.py"
    script.write_text(
        "import os, rclpy\nfrom phm import beacon\nrclpy.init(args=[])\nnode = rclpy.create_node('a')\n"
        "beacon.Beacon(node)\npid = os.fork()\nif pid == 0:\n    os._exit(len(beacon._hubs))\n"
        "raise SystemExit(10 * len(beacon._hubs) + os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))\n",
        encoding="ascii",
    )
    assert subprocess.run([sys.executable, "-W", "ignore", str(script)], env=bench.environ, timeout=60).returncode == 10


@pytest.mark.one_distribution
def test_foreign_messages_are_rejected_and_counted(bench: Bench) -> None:
    """Other texts, other content types, forged names of live nodes: nothing breaks and no node is displaced."""
    # The name of a node is free after three silent periods; in the default 0.6 s a starved node would lose it.
    bench.script(SCRIPT, "a", "--period", "4.0")
    probe = bench.probe(nodes=NODES)
    before = seen(probe, lambda fact: all_alive(fact, A) and fact.beacons[A], "the node")
    forger = bench.script("ros_forger.py", A)
    fact = seen(probe, lambda fact: fact.refused > 20 and fact, "refused messages")
    assert forger.poll() is None
    assert set(fact.beacons) == {A}
    assert fact.beacons[A].birth == before.birth
    beats = fact.beacons[A].heartbeats
    seen(
        probe,
        lambda fact: (
            all_alive(fact, A) and fact.beacons[A].birth == before.birth and fact.beacons[A].heartbeats > beats
        ),
        "its beacons beside the forger's",
    )


def test_a_copied_identity_is_rejected_and_reported_with_its_publisher(bench: Bench) -> None:
    """The first writer keeps counting while it sends; when it is killed, the copy does not keep it alive."""
    node = bench.script("ros_beaconed.py", "a")
    probe = bench.probe(nodes=[{"name": A}])
    seen(probe, lambda fact: A in fact.beacons and fact.beacons[A].heartbeats > 5, "its beacon")
    bench.script("ros_beacon_replay.py", A, "copy")
    fact = seen(probe, lambda fact: fact.beacons[A].copied_by and fact, "the report")
    assert fact.beacons[A].copied_by.startswith(("/elsewhere/copycat", "writer ")), "until its name is discovered"
    fact = seen(
        probe,
        lambda fact: fact.beacons[A].copied_by == "/elsewhere/copycat" and fact.beacons[A].missed < 3.0 and fact,
        "its name, while the first one sends",
    )
    assert fact.beacons[A].late_s < 99.0
    node.kill()
    seen(probe, lambda fact: fact.beacons[A].missed > 6.0 and fact.beacons[A].late_s < 99.0, "its silence")
    bench.script("ros_beaconed.py", "a")
    seen(probe, lambda fact: fact.beacons[A].missed < 3.0 and fact.beacons[A].birth != "", "the next one of its name")


@pytest.mark.one_distribution
def test_large_foreign_beacons_displace_no_configured_node(bench: Bench) -> None:
    """However large they are, the report fits into messages, and the configured node's beacons are kept."""
    bench.script("ros_beaconed.py", "a")
    probe = bench.probe(nodes=[{"name": A}])
    seen(probe, lambda fact: A in fact.beacons and fact.beacons[A].heartbeats > 5, "its beacon")
    bench.script("ros_beacon_replay.py", A, "crowd")
    began = seen(probe, lambda fact: A in fact.beacons and len(fact.beacons) > 100 and fact, "the crowd")

    def advances(fact: RosFact) -> bool:
        if A not in fact.beacons:
            assert fact.lost_s is not None, "it was displaced"
            return False  # a silence of which nothing is said: more arrived than a starved child can read
        assert fact.beacons[A].missed < 100.0, "it was displaced"  # a starved node is silent for up to 20 s
        later = fact.beacons[A].heartbeats > began.beacons[A].heartbeats
        return later and fact.beacons[A].age_s < 0.6 and fact.listened_s > began.listened_s + 5.0

    seen(probe, advances, "its beacons beside many others", 60.0)
    assert probe.restarts == 0
    assert all(problem.startswith("more messages arrive on") for problem in probe.problems()), "on a busy machine alone"
