"""Watching containers, folders and autopilots, with a fake engine and a real socket."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.core.settings import Settings
from phm.facts import AnswerFact, NameFact, RateFact, RosFact, TopicFact
from phm.facts.ros import EndpointFact
from phm.learn import ros_observer
from phm.learn.agent_observer import AgentObserver, ObservationFailed, ObservationRequest
from phm.learn.observations import Observations
from phm.learn.ros_observer import RosObserver
from phm.probes import file_stamp, file_tree
from phm.probes.docker import Docker
from phm.testing import FakeClock
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Status


class PassingClock(FakeClock):
    """Time passes when the test's own thread waits."""

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        if threading.current_thread() is not threading.main_thread() or timeout_s is None:
            return super().wait(event, timeout_s)
        self.advance(timeout_s)
        return event.is_set()


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[FakeEngine]:
    """ros_app with a folder of the host, PHM's own container, and one that has ended."""
    (tmp_path / "data").mkdir()
    for name in "ab":
        (tmp_path / "data" / name).write_text(name)
    mount = {"Type": "bind", "Source": str(tmp_path / "data"), "Destination": "/data", "RW": True}
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["ros_app"] = container("ros_app", health="healthy", mounts=[mount])
        fake.containers["sidecar"] = container("sidecar")
        fake.containers["sidecar"]["Config"]["Entrypoint"] = ["ros-entrypoint", "/opt/phm/bin/phm"]
        fake.containers["ended"] = container("ended", status="exited")
        yield fake


@pytest.fixture(autouse=True)
def no_ping(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Docker, "reachable", lambda self, address: True)


def watch(engine: FakeEngine, *containers: str, **fields: Any) -> Observations:
    """fields: of the request; `settings`: sections of the configuration."""
    sections = fields.pop("settings", {})
    settings = Settings.model_validate({"docker": {"socket": engine.url, "timeout": 60}, **sections})
    request = replace(ObservationRequest(5.0, containers, ros=False, links=False), **fields)
    return AgentObserver(settings, request, PassingClock()).run()


def test_all_that_run_are_watched_but_phm(engine: FakeEngine) -> None:
    """Without a choice, all running containers are watched except PHM's own."""
    seen = watch(engine)
    assert [(one.key, one.fact.health, one.restarted) for one in seen.containers] == [("ros_app", "healthy", False)]


def test_configured_containers_keep_their_alias(engine: FakeEngine) -> None:
    """And only these are watched; a container is named by alias or name."""
    engine.containers["other"] = container("other")
    configured = {"containers": [{"name": "ros_app", "alias": "app"}]}
    assert [one.key for one in watch(engine, settings=configured).containers] == ["app"]
    assert [one.key for one in watch(engine, "ros_app", "other", settings=configured).containers] == ["app", "other"]


def test_a_container_that_does_not_run_is_refused_by_name(engine: FakeEngine) -> None:
    """The error lists those that run."""
    with pytest.raises(ObservationFailed, match=r"no running container ended; running: ros_app"):
        watch(engine, "ended")


def test_a_configured_container_that_does_not_run_is_a_problem(engine: FakeEngine) -> None:
    """It is named and left out."""
    seen = watch(engine, settings={"containers": [{"name": "ended"}]})
    assert seen.containers == () and "ended is exited" in seen.problems[0]


@pytest.mark.parametrize(("echoes", "responds"), [((False, True), True), ((False, False), False)])
def test_a_single_lost_echo_is_not_a_silent_address(
    engine: FakeEngine, monkeypatch: pytest.MonkeyPatch, echoes: tuple[bool, bool], responds: bool
) -> None:
    """It would be learned as `address: false`, which turns the check of the address off; the check itself pings twice."""
    attached = {"swarm_net": {"NetworkID": "id-1", "IPAddress": "172.20.0.3"}}
    engine.containers["ros_app"]["NetworkSettings"]["Networks"] = attached
    remaining = list(echoes)
    monkeypatch.setattr(Docker, "reachable", lambda self, address: remaining.pop(0))
    assert watch(engine).containers[0].answers == {"swarm_net": responds}


@pytest.mark.parametrize(
    ("mode", "driver", "responds"),
    [
        ("elsewhere", "bridge", None),
        ("host", "bridge", False),
        ("host", "macvlan", None),
        ("swarm_net", "macvlan", False),
    ],
)
def test_an_address_is_judged_only_from_where_it_must_answer(
    engine: FakeEngine, monkeypatch: pytest.MonkeyPatch, mode: str, driver: str, responds: bool | None
) -> None:
    """On the same network, or from the host's on a bridge: elsewhere an address that works is silent, too."""
    engine.containers["ros_app"] = container("ros_app", networks=["swarm_net"])
    engine.networks["swarm_net"] = {"Id": "id-of-swarm_net", "Driver": driver}
    engine.containers["sidecar"] = container("sidecar", networks=[] if mode == "host" else [mode])
    engine.containers["sidecar"]["HostConfig"]["NetworkMode"] = mode
    monkeypatch.setattr(Docker, "reachable", lambda self, address: False)
    (app,) = watch(engine, "ros_app", settings={"docker": {"socket": engine.url, "container": "sidecar"}}).containers
    assert app.answers == {"swarm_net": responds}


def test_without_an_engine_the_rest_is_watched(tmp_path: Path) -> None:
    """The missing engine is a problem in the result; it is an error only if a container was asked for."""
    settings = Settings.model_validate({"docker": {"socket": f"unix://{tmp_path}/none"}})
    seen = AgentObserver(settings, ObservationRequest(5.0, ros=False, links=False), PassingClock()).run()
    assert "containers were not watched" in seen.problems[0]
    with pytest.raises(ObservationFailed, match="containers cannot be watched"):
        AgentObserver(settings, ObservationRequest(5.0, ("app",), ros=False, links=False), PassingClock()).run()


def test_configured_containers_are_watched_without_the_list_of_all(engine: FakeEngine) -> None:
    """PHM's proxy refuses the list. Only a name that is not configured needs it."""
    engine.fault = Status(403, "no", route="/containers/json")
    configured = {"containers": [{"name": "ros_app", "alias": "app"}]}
    for chosen in ((), ("ros_app",)):
        assert [one.key for one in watch(engine, *chosen, settings=configured).containers] == ["app"]
    with pytest.raises(ObservationFailed, match="containers cannot be watched"):
        watch(engine, "ros_app", "other", settings=configured)
    assert "containers were not watched" in watch(engine).problems[0]


def test_a_folder_has_the_sums_of_its_files(engine: FakeEngine) -> None:
    """With the container, and the path without its last slash."""
    (folder,) = watch(engine, folders=(("ros_app", "/data/"),)).folders
    assert (folder.container, folder.path, sorted(folder.files), folder.unstable) == (
        "ros_app",
        "/data",
        ["a", "b"],
        (),
    )


def test_a_large_file_is_read_for_as_long_as_it_takes(
    engine: FakeEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is not left out while more of it is read each time."""
    for name, value in (("_PIECE", 1), ("FILE_S", -1.0)):
        monkeypatch.setattr(file_tree, name, value)
    monkeypatch.setattr(file_stamp, "COARSEST_S", 0.0)
    (tmp_path / "data" / "a").write_text("x" * 40)
    (folder,) = watch(engine, folders=(("ros_app", "/data"),)).folders
    assert (sorted(folder.files), folder.unreadable) == (["a", "b"], ())


def test_files_that_change_meanwhile_are_left_out(engine: FakeEngine, tmp_path: Path) -> None:
    """They are named as unstable."""

    class Changing(PassingClock):
        def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
            if threading.current_thread() is threading.main_thread():  # whose waits the time passes in
                (tmp_path / "data" / "b").write_text(str(self.mono()))
            return super().wait(event, timeout_s)

    settings = Settings.model_validate({"docker": {"socket": engine.url, "timeout": 60}})
    request = ObservationRequest(5.0, folders=(("ros_app", "/data"),), ros=False, links=False)
    (folder,) = AgentObserver(settings, request, Changing()).run().folders
    assert (list(folder.files), folder.unstable) == (["a"], ("b",))


@pytest.mark.parametrize(
    ("folder", "problem"),
    [
        (("ros_app", "/elsewhere"), "not in a volume"),
        (("ros_app", "/data/a"), "not a folder"),
        (("ros_app", "/data/none"), "does not exist"),
        (("stranger", "/data"), "stranger, which is not watched"),
    ],
)
def test_a_folder_that_cannot_be_read_is_refused(engine: FakeEngine, folder: tuple[str, str], problem: str) -> None:
    """With the reason."""
    with pytest.raises(ObservationFailed, match=problem):
        watch(engine, folders=(folder,))


def test_a_mount_in_a_folder_that_phm_cannot_see_is_left_out(engine: FakeEngine, tmp_path: Path) -> None:
    """PHM may be unable to see it at all, such as a tmpfs. The entry ignores it."""
    (tmp_path / "data" / "run").mkdir()
    (tmp_path / "data" / "run" / "covered").write_text("covered")
    engine.containers["ros_app"]["HostConfig"]["Tmpfs"] = {"/data/run": ""}
    (folder,) = watch(engine, folders=(("ros_app", "/data"),)).folders
    assert (sorted(folder.files), folder.unreadable) == (["a", "b"], ("run",))


class Supervisor:
    """In the place of the ROS child: reports a graph, and rates of the topics that are asked for."""

    graph: RosFact

    def __init__(self, ros: Any, *_: Any) -> None:
        self._topics = [topic.name for topic in ros.topics]
        self._lifecycle = [node.name for node in ros.nodes if node.ready is not None and node.ready.lifecycle]

    def start(self) -> None: ...

    def close(self) -> None: ...

    def snapshot(self) -> RosFact:
        topic = TopicFact(
            (EndpointFact("/a/lidar", "std_msgs/msg/String"),),
            (EndpointFact("/a/planner", "std_msgs/msg/String"), EndpointFact("/_phm_a", "std_msgs/msg/String")),
            RateFact(10.0, 0.1, samples=50),
        )
        others = {name: fact for name, fact in self.graph.others.items() if name not in self._topics}
        states = {name: self.graph.lifecycle.get(name, AnswerFact()) for name in self._lifecycle}
        return replace(self.graph, topics=dict.fromkeys(self._topics, topic), others=others, lifecycle=states)


def test_the_graph_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Topics with a publisher, without those of PHM and of tools; nodes without hidden ones."""
    users = NameFact(("/a/lidar",), ("/a/planner",))
    Supervisor.graph = RosFact(
        0.0,
        60.0,
        nodes={"/a/lidar": 1, "/a/planner": 1, "/_phm_a": 1},
        others={"/a/scan": users, "/diagnostics": users, "/a/unused": NameFact((), ("/a/planner",))},
    )
    monkeypatch.setattr(ros_observer, "RosSupervisor", Supervisor)
    clock = PassingClock()
    seen = RosObserver(testing.settings().ros, "agent_1", clock)
    seen.discover()
    for _ in range(10):
        clock.advance(1.0)
        seen.tick()
    found = seen.into(Observations(10.0))
    assert found.nodes == {"/a/lidar": True, "/a/planner": True}
    (topic,) = found.topics
    assert (topic.name, topic.rates, [end.node for end in topic.subscribers]) == (
        "/a/scan",
        (10.0,) * 10,
        ["/a/planner"],
    )


def test_a_node_that_is_active_all_the_time_is_a_lifecycle_node(monkeypatch: pytest.MonkeyPatch) -> None:
    """By its own answer; one that has no such service, or is in another state at times, is not."""
    active, inactive = AnswerFact("active", served=True), AnswerFact("inactive", served=True)
    nodes = {"/a/amcl": 1, "/a/camera": 1, "/a/planner": 1, "/a/route": 1}
    Supervisor.graph = RosFact(
        0.0, 60.0, nodes=nodes, lifecycle={"/a/amcl": active, "/a/planner": active, "/a/route": inactive}
    )
    monkeypatch.setattr(ros_observer, "RosSupervisor", Supervisor)
    clock = PassingClock()
    seen = RosObserver(testing.settings().ros, "agent_1", clock)
    seen.discover()
    for planner in (active, inactive, active):
        Supervisor.graph = replace(Supervisor.graph, lifecycle={**Supervisor.graph.lifecycle, "/a/planner": planner})
        clock.advance(1.0)
        seen.tick()
    assert seen.into(Observations(10.0)).active_nodes == {"/a/amcl"}


def test_an_empty_graph_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty graph is stable, so it counts as discovered; but the reason may be the domain or the network."""
    Supervisor.graph = RosFact(0.0, 60.0, nodes={"/_phm_a": 1})
    monkeypatch.setattr(ros_observer, "RosSupervisor", Supervisor)
    ros = RosObserver(testing.settings().ros, "agent_1", PassingClock())
    assert not ros.into(Observations(10.0)).ros_watched
    ros.discover()
    found = ros.into(Observations(10.0))
    assert found.ros_watched and "no ROS node was found" in found.problems[0]
