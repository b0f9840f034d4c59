"""Slot 4: only what was received ends a silence of all nodes that was reported, not that PHM could not look."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm import api, testing
from phm.core.model import Level, Outcome
from phm.tracker.faults import ITSELF
from phm_checks.network import Network
from tests.fakes.data_path_bench import NET, NODES, ROWS, DataPath
from tests.fakes.tracker_bench import Bench, unit

UNIT = "network/ros_app"
DATA = ("data from its nodes",)


@pytest.fixture
def path() -> DataPath:
    return DataPath()


def restarted(path: DataPath) -> None:
    """PHM has been restarted: the check remembers nothing."""
    made = testing.settings(
        containers=[{"name": "ros_app", "networks": [NET]}], ros={"nodes": [{"name": name} for name in NODES]}
    )
    (path.check,) = Network.build(made)


@pytest.mark.parametrize("reported", ["transport_blocked", "nodes_unreachable"])
@pytest.mark.parametrize("why", ["no process list", "an old snapshot", "a young child", "no child", "a pause"])
def test_what_cannot_be_looked_at_does_not_end_a_reported_silence(path: DataPath, reported: str, why: str) -> None:
    """A delay of the engine or of PHM's own child process is not the end of the fault."""
    path.later(20.0, 4.5, 4.6)
    if reported == "nodes_unreachable":
        path.ros.change(nodes={})
    assert path.observe().condition == reported
    if why in ("no process list", "a pause"):
        path.docker.lists.clear()
    elif why == "an old snapshot":
        path.ros.change(age_s=2.5)
    elif why == "a young child":
        path.ros.change(up_s=0.5, nodes={}, beacons={})
    else:
        path.ros.fail()
    result = path.observe()
    assert result.level is api.Level.STALE and "not known whether data arrive again" in result.summary
    if why == "a pause":
        running = path.docker.containers["ros_app"]
        path.docker.containers["ros_app"] = replace(running, status="paused")
        path.observe()
        path.docker.containers["ros_app"] = running
        assert path.observe().level is api.Level.STALE
    path.docker.lists["ros_app"] = ROWS
    path.ros.work()
    path.ros.change(age_s=0.0, up_s=60.0)
    result = path.later(5.0, 0.1, 9.0)
    assert (result.level, result.evidence.unobserved_of) == (api.Level.OK, ())


def test_unreachable_nodes_stay_reported_while_one_computes(path: DataPath) -> None:
    """A process that happens to run during a check does not show that anything arrives."""
    path.later(20.0, 4.5, 4.6)
    path.ros.change(nodes={})
    assert path.observe().condition == "nodes_unreachable"
    path.docker.lists["ros_app"] = (ROWS[0], replace(ROWS[1], state="R"))
    assert path.observe().condition == "nodes_unreachable"


def test_another_cause_ends_a_reported_silence(path: DataPath) -> None:
    """A node that has ended is reported by its own check."""
    assert path.later(20.0, 4.5, 4.6).condition == "transport_blocked"
    path.docker.lists["ros_app"] = ROWS[:1]
    assert path.observe().level is api.Level.OK


def test_names_of_nodes_that_a_new_child_receives_end_a_reported_silence(path: DataPath) -> None:
    """They arrive as data: a container without beacons and topics must not stay unknown."""
    assert path.later(20.0, 4.5, 4.6).condition == "transport_blocked"
    path.ros.change(up_s=0.5, nodes={}, beacons={})
    assert path.observe().level is api.Level.STALE
    path.ros.change(up_s=1.5, nodes={NODES[0]: 1})
    assert path.observe().level is api.Level.OK


@pytest.mark.parametrize("received", ["a beacon", "a name"])
def test_after_a_restart_of_phm_silence_does_not_end_a_fault(path: DataPath, received: str) -> None:
    """A new check does not know that the path was cut off, so it states what its OK does not cover."""
    reported = path.later(20.0, 4.5, 4.6)
    assert reported.evidence.subjects == DATA
    restarted(path)
    path.ros.change(up_s=0.5, nodes={}, beacons={})
    for _ in range(3):
        path.clock.advance(5.0)
        result = path.observe()
        assert (result.level, result.evidence.unobserved_of) == (api.Level.OK, DATA)
    path.clock.advance(5.0)
    path.ros.change(nodes={NODES[0]: 1})
    if received == "a beacon":
        path.receive(0.1, 14.0)
    result = path.observe()
    assert (result.level, result.evidence.unobserved_of) == (api.Level.OK, ())


def test_after_a_reload_old_data_do_not_end_a_fault(path: DataPath) -> None:
    """The ROS child stays, with names and data from before."""
    path.later(20.0, 4.5, 4.6)
    restarted(path)
    assert path.later(5.0, 9.0, 9.0).evidence.unobserved_of == DATA
    assert path.later(5.0, 0.1, 14.0).evidence.unobserved_of == ()


def next_run(path: DataPath, reported: api.Result) -> Bench:
    """PHM is restarted while this is its fault."""
    before = Bench([unit(UNIT)])
    before.all_healthy()
    before.see(UNIT, reported)
    assert before.opened == [UNIT]
    after, tracker = Bench(before.tracked, before.now + 10), before.tracker
    after.take(after.tracker.restore(tracker.open_faults(), (), after.stamp(), tracker.fault_count))
    restarted(path)
    path.ros.change(up_s=0.5, nodes={}, beacons={})
    path.clock.advance(10.0)
    after.later(1)
    return after


def test_a_restored_fault_ends_when_names_are_received(path: DataPath) -> None:
    """A repaired network does not stay unknown because its nodes have no beacons."""
    bench = next_run(path, path.later(20.0, 4.5, 4.6))
    bench.see(UNIT, path.observe())
    assert (bench.level(UNIT), bench.closed) == (Level.STALE, [])
    assert bench.tracker.state(UNIT).result.summary.startswith("data from its nodes not observed since PHM was rest")
    path.ros.change(up_s=2.0, nodes={NODES[0]: 1})
    bench.later(5)
    bench.see(UNIT, path.observe())
    assert (bench.level(UNIT), bench.closed) == (Level.OK, [(UNIT, Outcome.RESOLVED, ITSELF)])


def test_a_restored_fault_of_the_network_itself_ends_without_data(path: DataPath) -> None:
    """The container is connected again: the nodes have nothing to do with it."""
    path.docker.change("ros_app", networks=())
    reported = path.observe()
    assert reported.condition == "disconnected"
    path.docker.change("ros_app", networks=(api.Attachment(NET, "id-1", "172.20.0.3"),))
    bench = next_run(path, reported)
    bench.see(UNIT, path.observe())
    assert (bench.level(UNIT), bench.closed) == (Level.OK, [(UNIT, Outcome.RESOLVED, ITSELF)])
