"""One node in one container for tests of the check `nodes`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from phm import api, testing
from phm_checks.nodes import Nodes

NODE = "nodes/agent_1/node_1"
NAME = "/agent_1/node_1"
TOPIC = "/agent_1/topic_1"
GRACE_S = 8.0
ONE = api.ProcessFact(71, 1, "S", 5.0, "python -m sitl.application.node --name node_1 --namespace /agent_1")
TWO = api.ProcessFact(72, 1, "S", 5.0, "python -m sitl.application.node --name node_2 --namespace /agent_1")
MAIN = api.ProcessFact(70, 0, "S", 1.0, "python -m sitl.application.app")


def active_topic(silent_s: float = 0.0) -> dict[str, api.TopicFact]:
    """The node's topic at 10 Hz, silent for `silent_s`."""
    rate = api.RateFact(10.0, silent_s, limit_s=1.0)
    return {TOPIC: api.TopicFact((api.EndpointFact(NAME, "std_msgs/msg/String"),), (), rate)}


def live_beacon(age_s: float = 0.1, late_s: float = 0.0) -> dict[str, api.BeaconFact]:
    return {NAME: api.BeaconFact(age_s, 0.2, late_s, "a", 100, turns=20)}


class Bench:
    """One node in one container, with its fakes. Its process is listed, it has no beacon and no topic."""

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
        self.environment = testing.FakeEnvironment()
        self.processes(MAIN, ONE)

    def processes(self, *facts: api.ProcessFact) -> None:
        self.docker.lists["ros_app"] = facts

    def results(self) -> dict[str, api.Result]:
        world = testing.world(clock=self.clock, ros=self.ros, docker=self.docker, environment=self.environment)
        results = self.check.run(world)
        assert not isinstance(results, api.Result)
        return dict(results)

    def result(self) -> api.Result:
        return self.results()[NODE]

    def after(self, seconds: float, each: Callable[[float], None] = lambda passed: None) -> api.Result:
        """Advance the time with four runs per second; before each, `each` is called with the elapsed time."""
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
    bench.ros.change(topics=active_topic())
    return bench


class Contained(Bench):
    """The container's first process is in its lists, as with a real engine."""

    def __init__(self, **ros: Any) -> None:
        super().__init__(**ros)
        self.docker.change("ros_app", pid=MAIN.pid)
        self.result()


def pair(**more: Any) -> Bench:
    """Two nodes of one container, both listed and both with a process."""
    bench = Bench(nodes=[{"name": "agent_1/node_1"}, {"name": "agent_1/node_2"}], **more)
    bench.ros.change(nodes={NAME: 1, "/agent_1/node_2": 1})
    bench.processes(MAIN, ONE, TWO)
    return bench
