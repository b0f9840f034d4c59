"""Slot 4: nodes that fall silent together are a blocked transport only if nothing arrives and no common cause explains it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from phm import api, testing
from phm_checks.network import Network
from tests.fakes.data_path_bench import NET, NODES, ROWS, DataPath

ONE, TWO = NODES
THREE = "/b/far"
BLOCKED = "transport_blocked"


def topic(
    publishers: Sequence[str], silent_s: float | None, subscribers: Sequence[str] = (), **rate: Any
) -> api.TopicFact:
    hz = None if silent_s is None else 10.0 if silent_s < 1.0 else 0.0
    ends, intos = (tuple(api.EndpointFact(node, "x/msg/X") for node in nodes) for nodes in (publishers, subscribers))
    return api.TopicFact(ends, intos, api.RateFact(hz, silent_s, limit_s=1.0, **rate))


class Topics(DataPath):
    """The same container, whose nodes have a topic of 10 Hz each and no beacons.

    inputs: by topic or node, which nodes subscribe to it. more: what else the snapshot contains.
    """

    def __init__(self, inputs: dict[str, Sequence[str]] | None = None, node: dict[str, Any] | None = None) -> None:
        self.inputs, self.more, self.beacons = inputs or {}, dict[str, Any](), dict[str, api.BeaconFact]()
        super().__init__()
        made = testing.settings(
            containers=[{"name": "ros_app", "networks": [NET], "ready": {"call": "/a/check"}}],
            ros={
                "nodes": [{"name": name, **(node or {})} for name in NODES],
                "topics": [{"name": f"{name}_out", "rate": 10, "publishers": [name]} for name in NODES],
            },
        )
        (self.check,) = Network.build(made)
        assert self.observe().level is api.Level.OK

    def receive(self, *ages_s: float) -> None:
        topics = {
            f"{name}_out": topic([name], age_s, self.inputs.get(f"{name}_out", ()))
            for name, age_s in zip(NODES, ages_s, strict=True)
        }
        more = dict(self.more)
        topics |= more.pop("topics", {})
        self.ros.change(nodes=dict.fromkeys(NODES, 1), beacons=self.beacons, topics=topics, **more)


def test_topics_of_nodes_that_wait_for_nothing_are_evidence() -> None:
    """Two timers do not stop at the same moment. The source of both may still only pause, so recovery waits."""
    result = Topics().later(10.0, 3.2, 3.3)
    assert (result.condition, result.target, result.evidence.patient) == (BLOCKED, "ros_app", True)


def test_beacons_alone_need_no_patience() -> None:
    """Each has its own thread and timer."""
    assert DataPath().later(10.0, 4.0, 4.4).evidence.patient is False


# ---------------------------------------------------------------- a common cause


@pytest.mark.parametrize("listed_as", ["configured", "others", "through another node"])
def test_a_pipeline_falls_silent_with_its_source(listed_as: str) -> None:
    """A detector that publishes once per image of a camera which has stopped: not a firewall, and no restart without patience."""
    path = Topics({f"{ONE}_out": [TWO]} if listed_as == "configured" else {})
    if listed_as == "others":
        path.more["others"] = {"/a/raw": api.NameFact((ONE,), (TWO,))}
    if listed_as == "through another node":
        path.more["others"] = {"/a/raw": api.NameFact((ONE,), (THREE,)), "/b/out": api.NameFact((THREE,), (TWO,))}
    for _ in range(3):
        assert path.later(10.0, 3.3, 3.2).level is api.Level.OK
    path.receive(4.3, 4.2)
    path.ros.change(nodes={})
    assert path.observe().condition == "nodes_unreachable", "discovery has no such cause"


@pytest.mark.parametrize(("silent_s", "blocked"), [(3.2, False), (0.1, True)])
def test_a_common_input_is_a_cause_while_it_does_not_arrive(silent_s: float, blocked: bool) -> None:
    """Two detectors of one camera elsewhere."""
    path = Topics()
    path.more["topics"] = {"/b/image": topic([THREE], silent_s, NODES)}
    assert (path.later(10.0, 3.2, 3.2).condition == BLOCKED) is blocked


def test_with_simulated_time_all_timers_may_be_paused() -> None:
    """`/clock` has a publisher; which nodes use it is not always known."""
    path = Topics()
    path.more["others"] = {"/clock": api.NameFact(("/gazebo",), ())}
    assert path.later(10.0, 3.2, 3.2).level is api.Level.OK


@pytest.mark.parametrize("beacons", [NODES, NODES[1:], ()])
def test_in_a_ring_of_topics_beacons_are_evidence(beacons: Sequence[str]) -> None:
    """Each node may wait for the other, and no beacon does: that of one node, and the topic of the other, do not stop together."""
    path = Topics({f"{ONE}_out": [TWO], f"{TWO}_out": [ONE]})
    path.beacons = {name: api.BeaconFact(3.3, 0.2) for name in beacons}
    result = path.later(10.0, 3.2, 3.2)
    assert (result.condition == BLOCKED) is (len(beacons) == 2)
    assert result.evidence.patient is False


def test_a_camera_without_a_beacon_does_not_hide_that_of_its_detector() -> None:
    """The detector's beacon does not wait for images."""
    path = Topics({f"{ONE}_out": [TWO]})
    path.beacons = {TWO: api.BeaconFact(3.3, 0.2)}
    result = path.later(10.0, 3.2, 3.2)
    assert (result.condition, result.evidence.patient) == (BLOCKED, True)


def test_nodes_of_one_process_are_one_witness() -> None:
    """A hung component container: its nodes fall silent together, with their beacons, and leave the graph together."""
    for path in (DataPath(), Topics()):
        made = testing.settings(
            containers=[{"name": "ros_app", "networks": [NET]}],
            ros={
                "nodes": [{"name": name, "process": ["component_container"]} for name in NODES],
                "topics": [{"name": f"{name}_out", "rate": 10, "publishers": [name]} for name in NODES],
            },
        )
        (path.check,) = Network.build(made)
        path.docker.lists["ros_app"] = (api.ProcessFact(71, 1, "S", 5.0, "component_container"),)
        path.observe()
        assert path.later(20.0, 4.3, 4.2).level is api.Level.OK
        path.ros.change(nodes={})
        assert path.observe().level is api.Level.OK


def test_two_processes_of_which_one_has_two_nodes_are_two_witnesses() -> None:
    """And the nodes of one process do not count twice beside a node that waits for them."""
    names = (*NODES, "/a/six")
    made = testing.settings(
        containers=[{"name": "ros_app", "networks": [NET]}],
        ros={
            "nodes": [{"name": name, "process": ["container"]} for name in NODES] + [{"name": names[2]}],
            "topics": [{"name": f"{name}_out", "rate": 10, "publishers": [name]} for name in names],
        },
    )
    for intos, blocked in (((), True), (names[2:], False)):
        path = DataPath()
        (path.check,) = Network.build(made)
        path.docker.lists["ros_app"] = (
            api.ProcessFact(71, 1, "S", 5.0, "component_container"),
            api.ProcessFact(72, 1, "S", 5.0, "node --name six"),
        )
        path.observe()
        path.clock.advance(10.0)
        topics = {f"{name}_out": topic([name], 3.2, intos if name == ONE else ()) for name in names}
        path.ros.change(nodes=dict.fromkeys(names, 1), beacons={}, topics=topics)
        assert (path.observe().condition == BLOCKED) is blocked


# ---------------------------------------------------------------- what arrives


ANSWER = api.AnswerFact("active", served=True, unanswered_s=0.2)
STATUS = api.DiagnosticFact(0.4, 0, "ok")
ARRIVING: dict[str, dict[str, Any]] = {
    "a lifecycle state": {"lifecycle": {ONE: ANSWER}},
    "the answer of a service": {"calls": {"/a/check": api.AnswerFact("false", served=True)}},
    "a status": {"diagnostics": {"one: driver": STATUS}},
    "a topic without a rate": {"topics": {"/a/info": topic([ONE], 0.3)}},
}
OLD: dict[str, dict[str, Any]] = {
    "no answer": {"lifecycle": {ONE: api.AnswerFact("active", served=True, unanswered_s=2.0)}},
    "no answer yet": {"lifecycle": {ONE: api.AnswerFact("", served=True)}},
    "a service of another container": {"calls": {"/b/check": ANSWER}},
    "an old status": {"diagnostics": {"one: driver": api.DiagnosticFact(3.4, 0, "ok")}},
    "a status of another node": {"diagnostics": {"six: driver": STATUS}},
    "a status of several": {"diagnostics": {"one: driver": STATUS}, "diagnostic_sources": {"one: driver": (STATUS,)}},
    "an old topic": {"topics": {"/a/info": topic([ONE], 60.0)}},
    "a topic of another node, too": {"topics": {"/a/info": topic([ONE, THREE], 0.3)}},
}


@pytest.mark.parametrize("what", ARRIVING)
def test_whatever_arrives_from_one_of_the_nodes_disproves_it(what: str) -> None:
    """The path works, and the silence has another cause. Also after it was reported."""
    path = Topics()
    path.more = ARRIVING[what]
    assert path.later(10.0, 3.2, 3.2).level is api.Level.OK
    path = Topics()
    assert path.later(10.0, 3.2, 3.2).condition == BLOCKED
    path.more = ARRIVING[what]
    assert path.later(1.0, 4.2, 4.2).level is api.Level.OK
    path.more = {name: {} for name in path.more}
    assert path.later(9.0, 13.2, 13.2).condition == BLOCKED


@pytest.mark.parametrize("what", OLD)
def test_what_does_not_arrive_from_the_nodes_disproves_nothing(what: str) -> None:
    """Older than the silence, or from elsewhere."""
    path = Topics()
    path.more = OLD[what]
    assert path.later(10.0, 3.2, 3.2).condition == BLOCKED
    assert path.later(1.0, 4.2, 4.2).condition == BLOCKED


def test_a_watched_status_belongs_to_the_node_of_its_entry() -> None:
    """Not to one that its name happens to name."""
    for node, blocked in ((ONE, False), (THREE, True)):
        path = Topics()
        made = testing.settings(
            containers=[{"name": "ros_app", "networks": [NET]}],
            ros={
                "nodes": [{"name": name} for name in NODES],
                "topics": [{"name": f"{name}_out", "rate": 10, "publishers": [name]} for name in NODES],
                "diagnostics": {"watch": [{"name": "one: *", "node": node, "container": "ros_app"}]},
            },
        )
        (path.check,) = Network.build(made)
        path.observe()
        path.more["diagnostics"] = {"one: driver": STATUS}
        assert (path.later(10.0, 3.2, 3.2).condition == BLOCKED) is blocked


def test_what_arrived_after_the_nodes_fell_silent_shows_that_the_path_worked() -> None:
    """A status comes every 10 s: between two of them nothing arrives either."""
    path = Topics()
    path.more["diagnostics"] = {"one: driver": api.DiagnosticFact(4.0, 0)}
    assert path.later(30.0, 14.0, 14.2).level is api.Level.OK


@pytest.mark.parametrize(("age_s", "blocked"), [(0.2, False), (0.9, True)])
def test_beacons_that_all_fell_silent_are_disproved_by_a_status(age_s: float, blocked: bool) -> None:
    """The same rule before the full time. A status that is as old as they are belongs to the time before."""
    path = DataPath()

    def pass_(seconds: float) -> None:
        path.receive(0.9 + seconds, 1.0 + seconds)
        path.ros.change(diagnostics={"one: driver": api.DiagnosticFact(age_s + seconds, 0)})

    path.clock.advance(10.0)
    pass_(0.0)
    path.clock.meanwhile = pass_
    assert (path.observe().condition == BLOCKED) is blocked


@pytest.mark.parametrize("state", ["inactive", "deactivating", "unconfigured"])
def test_topics_of_a_lifecycle_node_are_expected_while_it_is_active(state: str) -> None:
    """Deactivated by a manager, both publish nothing, and their statuses are slow."""
    path = Topics()
    path.more["lifecycle"] = {ONE: api.AnswerFact(state, served=True, unanswered_s=2.0)}
    assert path.later(10.0, 3.2, 3.2).level is api.Level.OK
    path.more["lifecycle"] = {ONE: api.AnswerFact("active", served=True, unanswered_s=2.0)}
    assert path.later(1.0, 4.2, 4.2).condition == BLOCKED


def test_an_inactive_node_does_not_hide_that_the_others_are_cut_off() -> None:
    """It has been silent for a minute."""
    path = Topics()
    path.more |= {
        "lifecycle": {THREE: api.AnswerFact("inactive", served=True, unanswered_s=2.0)},
        "topics": {"/b/out": topic([THREE], 60.0)},
    }
    made = testing.settings(
        containers=[{"name": "ros_app", "networks": [NET]}],
        ros={
            "nodes": [{"name": name} for name in (*NODES, THREE)],
            "topics": [{"name": f"{name}_out", "rate": 10, "publishers": [name]} for name in NODES]
            + [{"name": "/b/out", "rate": 10, "publishers": [THREE]}],
        },
    )
    (path.check,) = Network.build(made)
    path.docker.lists["ros_app"] = (*ROWS, api.ProcessFact(19, 1, "S", 1.0, "node --name far"))
    path.observe()
    path.clock.advance(10.0)
    path.receive(3.2, 3.2)
    path.ros.change(nodes=dict.fromkeys((*NODES, THREE), 1))
    assert path.observe().condition == BLOCKED
