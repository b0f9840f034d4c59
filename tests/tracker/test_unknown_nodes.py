"""A topic whose node is not yet known to be dead waits for that verdict, in whatever phase the two checks run."""

from __future__ import annotations

import pytest

from phm import api, testing
from phm.checking.plan import build_plan
from phm.core.model import FaultOpened
from phm.tracker import Effects, Tracker
from phm_checks.nodes import Nodes
from phm_checks.topics import Topics
from tests.fakes.nodes_bench import MAIN, NAME, ONE, TOPIC

STEP_S = 0.125


class Scene:
    """One node with a topic, its process, and the checks of both on the real tracker. `phase`: whether the nodes run in the even
    or in the odd steps."""

    def __init__(self, phase: int) -> None:
        topics = [{"name": TOPIC, "publishers": [NAME]}]
        settings = testing.settings(
            containers=[{"name": "ros_app"}], ros={"nodes": [{"name": NAME}], "topics": topics, "grace": "8s"}
        )
        plan = build_plan(settings, {"nodes": Nodes, "topics": Topics})
        (self.nodes,), (self.topics,) = Nodes.build(settings), Topics.build(settings)
        self.clock, self.ros = testing.FakeClock(mono=1000.0), testing.FakeRos(nodes={NAME: 1}, age_s=0.0)
        self.docker = testing.FakeDocker(testing.container("ros_app"))
        self.docker.lists["ros_app"] = (MAIN, ONE)
        self.world = testing.world(clock=self.clock, ros=self.ros, docker=self.docker)
        self.tracker = Tracker(plan.tracked, plan.graph, self.clock.stamp())
        self.opened: list[str] = []
        self._phase, self._steps = phase, 0
        self.listed(True)

    def listed(self, there: bool) -> None:
        """Whether the node and its endpoint are in the graph."""
        ends = (api.EndpointFact(NAME, "std_msgs/msg/String"),) if there else ()
        self.ros.change(nodes={NAME: 1} if there else {}, topics={TOPIC: api.TopicFact(ends, ())})

    def run(self, seconds: float) -> None:
        end = self.clock.mono() + seconds
        while self.clock.mono() < end:
            self.clock.advance(STEP_S)
            self._steps += 1
            for check in (self.topics, *((self.nodes,) if self._steps % 2 == self._phase else ())):
                results = check.run(self.world)
                assert not isinstance(results, api.Result)
                for unit, result in results.items():
                    self._take(self.tracker.observe(unit, result, self.clock.mono(), self.clock.stamp()))
            self._take(self.tracker.tick(self.clock.stamp()))

    def _take(self, effects: Effects) -> None:
        self.opened += [event.fault.unit for event in effects.events if isinstance(event, FaultOpened)]


@pytest.mark.parametrize("phase", [0, 1])
def test_a_node_that_is_restarted_and_does_not_return_is_one_fault_at_the_node(phase: int) -> None:
    """Its new process runs, so it is unknown for LOST_S after its name has left the graph."""
    scene = Scene(phase)
    scene.run(15.0)
    scene.listed(False)
    scene.run(30.0)
    assert scene.opened == ["nodes/agent_1/node_1"]
