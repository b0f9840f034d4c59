"""The application's hop of the command path: named by the configuration, or inferred from it."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks._application_hop import POLL_S, ApplicationHop
from phm_checks._command_path import HopState
from tests.fakes.path_world import PathWorld

ROUTER = {"url": "tcp:router:5760", "name": "ground", "leads_to": "router", "container": "router"}
APP, DB = {"name": "app"}, {"name": "db"}


def chosen(*containers: dict[str, Any], **more: Any) -> api.Settings:
    endpoint = more.pop("endpoint", {"url": "udpin:0.0.0.0:14550"})
    mavlink = {"endpoints": [endpoint], **more.pop("mavlink", {})}
    return testing.settings(containers=list(containers), mavlink=mavlink, **more)


INFERRED = [
    ("the only one", [APP], {}, "app"),
    ("not the router's", [APP, {"name": "router"}], {"endpoint": ROUTER}, "app"),
    ("the router alone", [{"name": "router"}], {"endpoint": ROUTER}, ""),
    ("the flight-critical one", [DB, {**APP, "flight_critical": True}], {}, "app"),
    ("the one with nodes", [DB, APP], {"ros": {"nodes": [{"name": "/a", "container": "app"}]}}, "app"),
    (
        "the router's network",
        [{**DB, "networks": ["data"]}, {**APP, "networks": ["air"]}, {"name": "router", "networks": ["air"]}],
        {"endpoint": ROUTER},
        "app",
    ),
    (
        "flight-critical ones are narrowed",
        [{**DB, "flight_critical": True}, {**APP, "flight_critical": True}],
        {"ros": {"nodes": [{"name": "/a", "container": "app"}]}},
        "app",
    ),
    ("two are not decided", [APP, DB], {}, ""),
    ("it is named", [APP, DB], {"mavlink": {"application": "db"}}, "db"),
    ("none", [APP], {"mavlink": {"application": "none"}}, ""),
    ("no container", [], {}, ""),
]


@pytest.mark.parametrize(
    ("containers", "more", "expected"), [one[1:] for one in INFERRED], ids=[i[0] for i in INFERRED]
)
def test_the_container_is_inferred_from_the_configuration(
    containers: list[dict[str, Any]], more: dict[str, Any], expected: str
) -> None:
    """Each rule narrows the candidates unless none would remain; more than one remaining is undecided."""
    settings = chosen(*containers, **dict(more))
    assert settings.command_container == expected
    assert settings.command_path_unclear is (expected == "" and containers == [APP, DB])


def test_named_nodes_replace_the_inference() -> None:
    """The hop needs these nodes, and not the container itself: it is a dependency of the nodes."""
    hop = ApplicationHop(chosen(APP, DB, ros={"nodes": [{"name": "/a", "container": "app", "commands": True}]}))
    assert (hop.container, hop.needs, hop.unclear) == ("", ("nodes/a",), False)


def test_an_inferred_container_is_a_dependency_and_its_only_node_too() -> None:
    """Of several nodes PHM does not know which one passes commands on."""
    nodes = [{"name": "/a"}, {"name": "/b"}]
    assert ApplicationHop(chosen(APP)).needs == ("container/app",)
    assert ApplicationHop(chosen(APP, ros={"nodes": nodes[:1]})).needs == ("container/app", "nodes/a")
    assert ApplicationHop(chosen(APP, ros={"nodes": nodes})).needs == ("container/app",)


def test_nodes_without_a_container_are_the_application_where_no_container_is() -> None:
    """ROS on the host: its only node is a dependency, of several only all of them together are the hop."""
    nodes = [{"name": "/a"}, {"name": "/b"}]
    assert ApplicationHop(chosen(ros={"nodes": nodes[:1]})).needs == ("nodes/a",)
    hop = ApplicationHop(chosen(ros={"nodes": nodes}))
    assert (hop.exists, hop.needs, hop.unclear) == (True, (), False)
    none = ApplicationHop(chosen(ros={"nodes": nodes}, mavlink={"application": "none"}))
    undecided = ApplicationHop(chosen(APP, DB, ros={"nodes": nodes}))
    assert [(hop.exists, hop.unclear) for hop in (none, undecided)] == [(False, False), (False, True)]


def test_nodes_in_the_router_s_container_do_not_decide() -> None:
    """It is the only configured one, so it is theirs unless they name another: no container remains, and that is said."""
    hop = ApplicationHop(chosen({"name": "router"}, endpoint=ROUTER, ros={"nodes": [{"name": "/a"}]}))
    assert (hop.exists, hop.unclear) == (False, True)


class Scene:
    def __init__(self, *nodes: str, host: bool = False) -> None:
        containers = [] if host else [APP]
        self.hop = ApplicationHop(chosen(*containers, ros={"nodes": [{"name": name} for name in nodes]}))
        self.clock, self.docker = testing.FakeClock(), testing.FakeDocker(testing.container("app"))
        self.ros = testing.FakeRos(nodes=dict.fromkeys(nodes, 1))

    def evaluate(self, seconds: float = 0.0) -> tuple[HopState, str]:
        self.clock.advance(seconds)
        hop = self.hop.evaluate(testing.world(clock=self.clock, docker=self.docker, ros=self.ros))
        return hop.state, hop.evidence


def test_a_container_that_does_not_run_breaks_the_path() -> None:
    """It is seen within a few seconds, or as soon as its nodes are missing; a running one is not asked about all the time."""
    scene = Scene("/a", "/b")
    assert scene.evaluate() == (HopState.OK, "")
    scene.docker.change("app", status="exited")
    assert scene.evaluate(1.0)[0] is HopState.OK
    assert scene.evaluate(POLL_S) == (HopState.BROKEN, "app is exited")
    scene.docker.change("app", status="running")
    assert scene.evaluate(0.5) == (HopState.OK, "")
    scene.docker.change("app", status="paused")
    scene.ros.change(nodes={"/a": 1})
    assert scene.evaluate(0.5) == (HopState.BROKEN, "app is paused")
    scene.docker.remove("app")
    assert scene.evaluate(0.5) == (HopState.BROKEN, "app does not exist")
    scene.docker.fail("no answer")
    assert scene.evaluate(0.5) == (HopState.UNKNOWN, "the Docker Engine does not answer")


@pytest.mark.parametrize("host", [False, True])
def test_one_of_several_nodes_makes_the_hop_weak_and_all_of_them_break_it(host: bool) -> None:
    """The text names the first three."""
    scene = Scene("/a", "/b", host=host)
    scene.ros.change(nodes={"/a": 1})
    assert scene.evaluate() == (HopState.WEAK, "b not in the graph")
    scene.ros.change(nodes={})
    assert scene.evaluate() == (HopState.BROKEN, "a, b not in the graph")
    scene.ros.change(up_s=1.0)
    assert scene.evaluate()[0] is HopState.UNKNOWN


def test_the_first_broken_hop_is_the_application_by_default() -> None:
    """Its container exits: that is the one alarm, it names the path, and the path names the application."""
    world = PathWorld(containers=[APP])
    world.docker.put(testing.container("app"))
    world.run(20.0)
    assert "companion ok -> application ok -> autopilot ok" in world.text("path")
    assert world.tracker.graph.upstream("path").count("container/app") == 0, "PathWorld has no check of containers"
    world.docker.change("app", status="exited")
    world.run(10.0)
    assert world.alarms == []
    assert world.text("path").startswith("the command path is broken at application: ")
    assert "application BROKEN (app is exited)" in world.text("path")


def test_an_undecided_application_is_said() -> None:
    """In `phm status`, whose text is that of the unit."""
    world = PathWorld(containers=[APP, DB])
    world.run(20.0)
    assert world.text("path").endswith("; the application is not part of it: set mavlink.application")
    assert "application ok" not in world.text("path")
