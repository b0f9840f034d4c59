"""The majority's verdict and PHM's own evidence: one death raises one alarm, whichever of the two finds it, and when.

The real check `consensus`, in the plan of the shipped configuration; the results of `nodes` are drawn.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random

import pytest

from phm import api, testing
from phm.api import Level
from phm.core.model import FaultClosed, FaultOpened, Outcome
from phm.tracker import Effects, Tracker
from phm.tracker.rules import GRACE_ENDS_AFTER_OK_S
from phm_checks.consensus import Consensus
from tests.fakes.agent_world import OK, shipped

NODES = ("/agent_1/node_1", "/agent_1/node_2", "/agent_1/node_3")
DEAD = NODES[0]
NODE_UNIT = "nodes/agent_1/node_1"
STEP_S = 0.25


class Scene:
    """Three nodes with beacons. `silent_since`: of the dead node, for PHM; `unseen_since`: for its neighbours."""

    def __init__(self) -> None:
        self.settings, plan = shipped()
        (self.check,) = Consensus.build(self.settings)
        self.clock, self.ros = testing.FakeClock(mono=1000.0), testing.FakeRos(nodes=dict.fromkeys(NODES, 1))
        self.world = testing.world(clock=self.clock, ros=self.ros)
        self.tracker = Tracker(plan.tracked, plan.graph, self.clock.stamp())
        self.units = [entry.unit.id for entry in plan.tracked]
        self.silent_since: float | None = None
        self.unseen_since: float | None = None
        self.node_result = OK
        self.opened: list[str] = []
        self.closed: list[tuple[str, Outcome]] = []
        for _ in range(3):
            self.step(GRACE_ENDS_AFTER_OK_S + 0.1)

    def step(self, seconds: float = STEP_S) -> None:
        self.clock.advance(seconds)
        now = self.clock.mono()
        self.ros.change(beacons={name: self._beacon(name, now) for name in NODES})
        found = self.check.run(self.world)
        assert isinstance(found, api.Result)
        results = {NODE_UNIT: self.node_result, "consensus": found}
        for unit in self.units:
            self._take(self.tracker.observe(unit, results.get(unit, OK), now, self.clock.stamp()))
        self._take(self.tracker.tick(self.clock.stamp()))

    def run(self, seconds: float) -> None:
        end = self.clock.mono() + seconds
        while self.clock.mono() < end:
            self.step()

    def _beacon(self, name: str, now: float) -> api.BeaconFact:
        unseen = self.unseen_since is not None and now >= self.unseen_since
        views = {other: api.NeighbourFact(other != DEAD or not unseen, 0.3) for other in NODES if other != name}
        silent = name == DEAD and self.silent_since is not None and now >= self.silent_since
        age_s = now - (self.silent_since or now) if silent else 0.1
        return api.BeaconFact(age_s, 0.2, birth=f"{name}.1", heartbeats=900, views=views, turns=100, witness=name)

    def _take(self, effects: Effects) -> None:
        for event in effects.events:
            if isinstance(event, FaultOpened):
                self.opened.append(event.fault.unit)
            elif isinstance(event, FaultClosed):
                self.closed.append((event.fault.unit, event.fault.outcome))


@pytest.mark.parametrize("seed", range(30))
def test_one_death_raises_one_alarm_at_its_node(seed: int) -> None:
    """However late PHM's own evidence is, up to the limit of its rules, the consensus is a consequence."""
    scene, random = Scene(), Random(seed)
    now = scene.clock.mono()
    scene.silent_since, scene.unseen_since = now, now + random.uniform(0.0, 4.0)
    decides_s = random.choice((random.uniform(0.2, 2.0), random.uniform(2.0, 15.5)))
    scene.run(decides_s)
    scene.node_result = api.error("dead", brief="dead", condition="node_missing", target="ros_app")
    scene.run(45.0)
    assert scene.opened == [NODE_UNIT]
    scene.node_result, scene.silent_since = OK, None
    scene.run(random.uniform(0.0, 6.0))  # its neighbours discover the new process later than PHM
    scene.unseen_since = None
    scene.run(20.0)
    assert scene.opened == [NODE_UNIT]
    assert scene.tracker.state("consensus").level is Level.OK


@pytest.mark.parametrize("unknown", [False, True])
@pytest.mark.parametrize("received", [False, True])
def test_a_verdict_of_the_majority_alone_is_one_alarm(unknown: bool, received: bool) -> None:
    """PHM's own evidence says alive or unknown: the fault is the consensus, and it ends with the verdict."""
    scene = Scene()
    now = scene.clock.mono()
    scene.unseen_since, scene.silent_since = now, None if received else now
    scene.node_result = api.stale("not yet known whether it is alive") if unknown else OK
    scene.run(120.0)
    assert scene.opened == ["consensus"] and scene.closed == []
    fault = next(iter(scene.tracker.open_faults()))
    assert (fault.result.condition, fault.result.target) == ("quorum_dead", "ros_app" if received else "")
    scene.unseen_since = scene.silent_since = None
    scene.node_result = OK
    scene.run(5.0)
    assert scene.closed == [("consensus", Outcome.RESOLVED)]


def test_a_death_found_late_replaces_the_alarm_of_the_majority() -> None:
    """Beyond the limit of its rules PHM's evidence is late: the earlier fault is closed as reattributed."""
    scene = Scene()
    scene.silent_since = scene.unseen_since = scene.clock.mono()
    scene.run(40.0)
    assert scene.opened == ["consensus"]
    scene.node_result = api.error("dead", brief="dead", condition="node_missing", target="ros_app")
    scene.run(5.0)
    assert scene.opened == ["consensus", NODE_UNIT]
    assert scene.closed == [("consensus", Outcome.REATTRIBUTED)]


@pytest.mark.parametrize("seconds", [1.0, 5.0, 9.0])
def test_a_short_verdict_opens_no_fault(seconds: float) -> None:
    """A restarted node is discovered by its neighbours within this time."""
    scene = Scene()
    scene.unseen_since = scene.clock.mono()
    scene.run(seconds)
    scene.unseen_since = None
    scene.run(15.0)
    assert scene.opened == []


def test_starvation_explains_the_verdict() -> None:
    """While the machine waits for CPUs, neighbours receive each other late."""
    scene = Scene()
    scene.unseen_since = scene.clock.mono()
    busy = api.error("all cores are busy", brief="cpu 100 %", condition="cpu_high")
    stuck = replace(busy, settle_s=0.0)
    ok = scene.tracker.observe
    for _ in range(100):
        scene.clock.advance(STEP_S)
        now = scene.clock.mono()
        scene.ros.change(beacons={name: scene._beacon(name, now) for name in NODES})
        found = scene.check.run(scene.world)
        assert isinstance(found, api.Result)
        results = {"host/cpu": stuck, "consensus": found}
        for unit in scene.units:
            scene._take(ok(unit, results.get(unit, OK), now, scene.clock.stamp()))
        scene._take(scene.tracker.tick(scene.clock.stamp()))
    assert scene.opened == ["host/cpu"]
    assert scene.tracker.state("consensus").blocked_by == "host/cpu"
