"""Slot 4: discovery works but no data arrives: one fault of the network instead of hung nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm_checks.network import Network
from tests.fakes.data_path_bench import NET, NODES, ROWS, DataPath


@pytest.fixture
def path() -> DataPath:
    return DataPath()


@pytest.mark.parametrize(
    ("observer", "alive", "blocked"), [("/b/far", True, False), ("/b/far", False, True), ("/a/one", True, True)]
)
def test_a_container_whose_nodes_others_receive_is_not_cut_off(
    path: DataPath, observer: str, alive: bool, blocked: bool
) -> None:
    """Its network is intact, and connecting it again would interrupt it; what its own nodes receive does not show that."""
    path.clock.advance(10.0)
    views = {"/a/two": api.NeighbourFact(alive, 0.5)}
    silent = {name: api.BeaconFact(4.0, 0.2, witness=name) for name in NODES}
    far = api.BeaconFact(4.0 if observer in NODES else 0.1, 0.2, views=views, witness=observer)
    path.ros.change(beacons={**silent, observer: far})
    assert (path.observe().condition == "transport_blocked") is blocked


def test_nodes_that_fall_silent_together_are_a_blocked_transport(path: DataPath) -> None:
    """Listed and running, but not received: one fault, without a restart of any node."""
    result = path.later(10.0, 4.0, 4.4)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "transport_blocked", "ros_app")
    assert result.brief == "ros_app transport blocked"
    assert "2 nodes" in result.summary


def test_data_received_earlier_is_part_of_the_evidence(path: DataPath) -> None:
    """A restart may help only if data arrived before; the summary says so."""
    result = path.later(10.0, 4.0, 4.4)
    assert result.evidence.never_ok is False
    assert "Data was received earlier" in result.summary


def test_where_the_address_cannot_be_checked_nothing_is_restarted(path: DataPath) -> None:
    """As without an address check: PHM, on the host's network, does not reach a macvlan reliably."""
    path.docker.drivers[NET] = "macvlan"
    result = path.later(10.0, 4.0, 4.4)
    assert (result.condition, result.target) == ("transport_blocked", "")
    assert "responds" not in result.summary


def test_without_an_address_check_nothing_is_restarted(path: DataPath) -> None:
    """PHM's own connection to a healthy container may be the broken part."""
    made = testing.settings(
        containers=[{"name": "ros_app", "networks": [NET], "address": False}],
        ros={"nodes": [{"name": name} for name in NODES]},
    )
    (path.check,) = Network.build(made)
    path.observe()
    result = path.later(10.0, 4.0, 4.4)
    assert (result.condition, result.target) == ("transport_blocked", "")


def test_after_a_restart_the_path_is_ok_when_data_is_received(path: DataPath) -> None:
    """A reconnected network may be blocked again, which only data from a node can disprove."""
    path.later(10.0, 4.0, 4.4)
    path.docker.change("ros_app", started_at="later")
    assert path.later(1.0, 5.0, 5.4).level is api.Level.STALE
    assert path.later(2.0, 7.0, 7.4).level is api.Level.STALE
    assert path.later(2.0, 0.2).level is api.Level.OK
    assert path.later(5.0, 5.0).level is api.Level.OK, "one node that falls silent is its own fault"


def test_after_a_restart_the_wait_for_data_is_limited(path: DataPath) -> None:
    """Nodes that never appear are reported by the nodes check."""
    path.later(10.0, 4.0, 4.4)
    path.docker.change("ros_app", started_at="later")
    path.ros.change(nodes={}, beacons={})
    assert path.observe().level is api.Level.STALE
    path.clock.advance(17.0)
    assert path.observe().level is api.Level.OK


@pytest.mark.parametrize("ages_s", [(0.1, 5.0), (0.5, 0.6), (4.0, 8.0), (5.0,)])
def test_one_silent_node_is_its_own_fault(path: DataPath, ages_s: tuple[float, ...]) -> None:
    """Another node is received, the silence is short, they fell silent one after the other, or there is only one node."""
    assert path.later(10.0, *ages_s).level is api.Level.OK


class SlowTopics(DataPath):
    """The same with a topic of 0.1 Hz for each node, a rate that the sampler has not learned yet, and no beacons."""

    def __init__(self) -> None:
        super().__init__()
        made = testing.settings(
            containers=[{"name": "ros_app", "networks": [NET], "address": True}],
            ros={
                "nodes": [{"name": name} for name in NODES],
                "topics": [{"name": f"{name}_out", "rate": 0.1, "publishers": [name]} for name in NODES],
            },
        )
        (self.check,) = Network.build(made)
        assert self.observe().level is api.Level.OK

    def receive(self, *ages_s: float) -> None:
        topics = {
            f"{name}_out": api.TopicFact(rate=api.RateFact(0.1, age_s, limit_s=15.0))
            for name, age_s in zip(NODES, ages_s, strict=True)
        }
        self.ros.change(nodes=dict.fromkeys(NODES, 1), beacons={}, topics=topics)


def test_between_two_messages_of_slow_topics_nothing_is_cut_off() -> None:
    """Nothing is due from any node yet, listed or not; a restart would interrupt healthy nodes."""
    path = SlowTopics()
    assert path.later(30.0, 4.0, 4.4).level is api.Level.OK
    assert path.later(10.0, 14.0, 14.4).level is api.Level.OK
    path.ros.change(nodes={})
    assert path.observe().level is api.Level.OK
    assert path.later(2.0, 16.0, 16.4).condition == "transport_blocked"
    path.ros.change(nodes={})
    assert path.observe().condition == "nodes_unreachable"


def test_slow_beacons_get_their_periods(path: DataPath) -> None:
    """A beacon may have a period of 10 s."""
    path.clock.advance(60.0)
    path.ros.change(beacons={name: api.BeaconFact(4.0, 10.0) for name in NODES})
    assert path.observe().level is api.Level.OK
    path.ros.change(beacons={name: api.BeaconFact(31.0, 10.0) for name in NODES})
    assert path.observe().condition == "transport_blocked"


@pytest.mark.parametrize(("beacon_s", "blocked"), [(4.2, True), (60.0, False)])
def test_only_a_sign_of_life_that_has_just_ended_shows_that_the_next_is_late(beacon_s: float, blocked: bool) -> None:
    """A beacon that was closed long ago says nothing about the pause of a slow topic."""
    path = SlowTopics()
    path.later(100.0, 4.0, 4.0)
    path.ros.change(beacons={name: api.BeaconFact(beacon_s, 0.2) for name in NODES})
    assert (path.observe().condition == "transport_blocked") is blocked


@pytest.mark.parametrize("rows", [ROWS[:1], (ROWS[0], replace(ROWS[1], state="T"))])
def test_processes_that_terminated_or_stopped_explain_the_silence(path: DataPath, rows: tuple[Any, ...]) -> None:
    """Then the network is not the cause."""
    path.docker.lists["ros_app"] = rows
    assert path.later(10.0, 4.0, 4.0).level is api.Level.OK


@pytest.mark.parametrize(
    ("state", "soon_s", "blocked"), [("S", 0.9, True), ("R", 4.0, True), ("R", 0.9, False), ("T", 4.0, False)]
)
def test_a_node_that_runs_twice_does_not_hide_a_blocked_transport(
    path: DataPath, state: str, soon_s: float, blocked: bool
) -> None:
    """Found in a campaign: a blocked transport was reported as two hung nodes beside the duplicate."""
    path.docker.lists["ros_app"] = (*ROWS, replace(ROWS[1], pid=19, state=state))
    result = silent(path, soon_s, soon_s + 0.1)
    assert (result.condition == "transport_blocked") is blocked


def test_a_second_process_of_one_node_does_not_replace_another_node(path: DataPath) -> None:
    """A second process must not count for a node that has none."""
    path.docker.lists["ros_app"] = (ROWS[0], replace(ROWS[0], pid=19))
    assert path.later(10.0, 4.0, 4.0).level is api.Level.OK


def test_processes_of_other_nodes_that_name_a_node_do_not_run_it(path: DataPath) -> None:
    """Two processes fit node `one`, and both belong to others: it may have ended."""
    words = "node --name {} --follow one"
    made = testing.settings(
        containers=[{"name": "ros_app", "networks": [NET]}],
        ros={"nodes": [{"name": f"/a/{k}"} for k in ("one", "two", "six")]},
    )
    (path.check,) = Network.build(made)
    path.docker.lists["ros_app"] = (
        *(api.ProcessFact(k, 1, "S", 1.0, words.format(name)) for k, name in ((11, "two"), (12, "six"))),
    )
    path.observe()
    path.clock.advance(10.0)
    beacons = {f"/a/{name}": api.BeaconFact(4.0, 0.2) for name in ("one", "two", "six")}
    path.ros.change(nodes=dict.fromkeys(beacons, 1), beacons=beacons)
    assert path.observe().level is api.Level.OK
    twice = (api.ProcessFact(pid, 1, "S", 1.0, "node --name one") for pid in (10, 13))
    path.docker.lists["ros_app"] += tuple(twice)
    assert path.observe().condition == "transport_blocked"


def test_a_restarted_container_has_other_processes(path: DataPath) -> None:
    """Old names stay listed until their lease expires; nothing was received in this generation yet."""
    path.clock.advance(10.0)
    path.docker.change("ros_app", started_at="later")
    path.receive(4.0, 4.0)
    assert path.observe().level is api.Level.OK


def test_publishers_without_names_are_a_blocked_transport_from_the_start(path: DataPath) -> None:
    """A PHM that starts behind the firewall never receives a node name."""
    made = testing.settings(
        containers=[{"name": "ros_app", "networks": [NET]}],
        ros={
            "nodes": [{"name": name} for name in NODES],
            "topics": [{"name": f"{name}_out", "rate": 1, "publishers": [name]} for name in NODES],
        },
    )
    (path.check,) = Network.build(made)
    topics = {f"{name}_out": api.TopicFact(publishers=(api.EndpointFact("", "std_msgs/msg/String"),)) for name in NODES}
    path.ros.change(nodes={}, beacons={}, topics=topics)
    assert path.observe().level is api.Level.OK
    path.clock.advance(20.0)
    result = path.observe()
    assert (result.condition, result.evidence.never_ok) == ("transport_blocked", True)
    assert "nothing has been received since it was started" in result.summary


def test_without_a_snapshot_the_check_makes_no_statement(path: DataPath) -> None:
    """The ROS child process is being replaced, or the engine lists no processes."""
    path.ros.fail()
    assert path.later(10.0, 4.0, 4.0).level is api.Level.OK
    path.ros.work()
    path.docker.lists.clear()
    assert path.later(1.0, 5.0, 5.0).level is api.Level.OK


# ---------------------------------------------------------------- fast detection


def silent(path: DataPath, *ages_s: float) -> api.Result:
    """Nothing arrives any more: beacons have these ages, which grow with time."""
    path.clock.meanwhile = lambda seconds: path.receive(*(age_s + seconds for age_s in ages_s))
    return path.later(10.0, *ages_s)


def test_a_second_of_silence_of_all_sleeping_nodes_is_enough(path: DataPath) -> None:
    """Beacons have their own threads, and no process waits for a CPU; a second sample confirms it."""
    result = silent(path, 0.9, 1.0)
    assert (result.condition, path.clock.waits) == ("transport_blocked", 1)
    assert "for 1.3 s" in result.summary


def test_a_reported_silence_stays_until_data_is_received(path: DataPath) -> None:
    """Even if a process happens to be running during a check; this needs no second sample."""
    silent(path, 0.9, 1.0)
    path.docker.lists["ros_app"] = (ROWS[0], replace(ROWS[1], state="R"))
    assert path.later(0.5, 1.8, 1.9).condition == "transport_blocked"
    assert path.clock.waits == 1
    assert path.later(0.5, 0.1, 2.4).level is api.Level.OK


@pytest.mark.parametrize(
    "why",
    [
        "one computes",
        "receive again",
        "the child is late",
        "one after the other",
        "no beacons",
        "one left",
        "child lost",
    ],
)
def test_a_silence_with_another_cause_needs_the_full_time(path: DataPath, why: str) -> None:
    """An overloaded machine, a short gap, PHM's own child, terminating nodes, or topics only, which may have one source."""
    if why == "one computes":
        path.docker.lists["ros_app"] = (ROWS[0], replace(ROWS[1], state="R"))
    if why == "one after the other":
        assert silent(path, 0.9, 1.9).level is api.Level.OK
        return
    if why == "the child is late":
        path.ros.change(age_s=0.8)
    path.clock.advance(10.0)
    path.receive(0.9, 1.0)
    if why == "no beacons":
        path.ros.change(beacons={})
    later: dict[str, Callable[[float], None]] = {
        "receive again": lambda _: path.receive(0.1, 0.1),
        "one left": lambda seconds: path.ros.change(nodes={NODES[0]: 1}),
        "child lost": lambda seconds: path.ros.fail(),
    }
    path.clock.meanwhile = later.get(why, lambda seconds: path.receive(0.9 + seconds, 1.0 + seconds))
    assert path.observe().level is api.Level.OK


def test_a_silence_that_ended_by_itself_raises_the_limit(path: DataPath) -> None:
    """This machine stalls at times: the required silence doubles, for ten minutes at most."""
    path.receive(1.0, 1.0)
    path.clock.advance(10.0)
    path.clock.meanwhile = lambda _: path.receive(0.1, 0.1)
    assert path.observe().level is api.Level.OK
    assert silent(path, 1.5, 1.6).level is api.Level.OK
    assert silent(path, 2.5, 2.6).condition == "transport_blocked"
    path.later(600.0, 0.1, 0.1)
    assert silent(path, 1.0, 1.0).condition == "transport_blocked"


# ---------------------------------------------------------------- discovery fails too


def test_nodes_that_are_neither_listed_nor_received_are_one_fault(path: DataPath) -> None:
    """The network reports it before the nodes would; nothing is restarted for it."""
    path.later(20.0, 4.5, 4.6)
    path.ros.change(nodes={})
    result = path.observe()
    assert (result.level, result.condition) == (api.Level.ERROR, "nodes_unreachable")
    assert "is connected and responds, but none of its 2 nodes is listed" in result.summary


@pytest.mark.parametrize(("listed", "blocked_before"), [(False, False), (True, False), (True, True)])
def test_a_pause_of_the_container_is_not_a_silence_of_its_nodes(
    path: DataPath, listed: bool, blocked_before: bool
) -> None:
    """Seen after a `docker pause` of 15 s: nodes are listed and received again some seconds after the unpause."""
    if blocked_before:
        assert path.later(10.0, 4.0, 4.4).condition == "transport_blocked"
        assert path.later(60.0, 0.1, 0.2).level is api.Level.OK
    running = path.docker.containers["ros_app"]
    path.docker.containers["ros_app"] = replace(running, status="paused")
    assert path.later(10.0, 0.1, 0.1).level is api.Level.STALE
    path.clock.advance(15.0)
    path.docker.containers["ros_app"] = running
    nodes = dict.fromkeys(NODES, 1) if listed else {}
    for seconds in (0.1, 3.0, 5.0):
        path.clock.advance(seconds)
        path.ros.change(nodes=nodes, beacons={name: api.BeaconFact(15.0 + seconds, 0.2) for name in NODES})
        assert path.observe().level is api.Level.OK
    assert path.later(2.0, 0.1, 0.2).level is api.Level.OK
    assert path.later(10.0, 4.0, 4.4).condition == "transport_blocked"


def test_a_pause_does_not_end_a_blocked_transport(path: DataPath) -> None:
    """It is over when data is received."""
    assert path.later(10.0, 4.0, 4.4).condition == "transport_blocked"
    running = path.docker.containers["ros_app"]
    path.docker.containers["ros_app"] = replace(running, status="paused")
    assert path.later(5.0, 9.0, 9.4).level is api.Level.STALE
    path.docker.containers["ros_app"] = running
    assert path.later(5.0, 14.0, 14.4).condition == "transport_blocked"


def test_an_address_that_is_not_checked_is_not_said_to_respond() -> None:
    """The text names only what was observed."""
    path = DataPath(address=False)
    path.later(20.0, 4.5, 4.6)
    path.ros.change(nodes={})
    assert "is connected, but none of its 2 nodes is listed" in path.observe().summary


@pytest.mark.parametrize(
    "why", ["one is listed", "not long enough", "one process ended", "one computes", "a young child", "a recent start"]
)
def test_nodes_that_are_missing_for_another_reason_are_their_own_faults(path: DataPath, why: str) -> None:
    """They are starting, have terminated, or come and go."""
    path.clock.advance(1.0 if why == "a recent start" else 20.0)
    path.receive(*((1.0, 1.1) if why == "not long enough" else (4.5, 4.6)))
    path.ros.change(nodes={NODES[1]: 1} if why == "one is listed" else {}, up_s=3.0 if why == "a young child" else 60.0)
    if why in ("one process ended", "one computes"):
        path.docker.lists["ros_app"] = (
            ROWS[:1] if why == "one process ended" else (ROWS[0], replace(ROWS[1], state="R"))
        )
    assert path.observe().level is api.Level.OK
