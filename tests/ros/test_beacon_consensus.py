"""The consensus of real nodes: the check's result while they run, die, stop, hang, are split and return."""

from __future__ import annotations

import signal
import subprocess
from dataclasses import replace
from typing import Any

import pytest

from phm import api, testing
from phm.core.clock import SystemClock
from phm.core.settings import Settings
from phm.facts.ros import CONSENSUS
from phm.probes.ros.supervisor import RosSupervisor
from phm.reporters.consensus import ConsensusReporter
from phm_checks import _lost_publishers, _quorum
from phm_checks.consensus import Consensus
from tests.fakes.records import context
from tests.fakes.ros_bench import Bench, Listener, seen, until

pytestmark = pytest.mark.one_distribution
"""Decisions on beacons: test_beacon.py receives them on both distributions."""

NAMES = ("a", "b", "c")
SCRIPT = "ros_beaconed.py"


class Scene:
    """Three nodes, the probe, and the check that uses it."""

    def __init__(self, bench: Bench, *extra: str) -> None:
        nodes = [{"name": f"/agent_1/{name}"} for name in (*NAMES, *extra)]
        (self._check,) = Consensus.build(testing.settings(ros={"nodes": nodes}))
        self.nodes = {name: bench.script(SCRIPT, name) for name in NAMES}
        self.probe: RosSupervisor = bench.probe(nodes=nodes)
        self._world = testing.world(clock=SystemClock(), ros=self.probe)

    def run(self) -> api.Result:
        result = self._check.run(self._world)
        assert isinstance(result, api.Result)
        return result

    def wait(self, alive: int, condition: str = "", observers: int = 0) -> api.Result:
        """Wait until `alive` nodes are alive, seen by `observers` observers, with this condition."""

        def matches() -> api.Result | None:
            result = self.run()
            values = result.values
            fits = values.get("alive") == alive and (not observers or values.get("observers") == observers)
            return result if fits and result.condition == condition else None

        try:
            found = until(matches, f"{alive} alive, {condition or 'no trouble'}", limit_s=120.0)
        except AssertionError as error:
            raise AssertionError(f"{error}; newest result: {self.run()}") from error
        assert isinstance(found, api.Result)
        return found


@pytest.fixture
def scene(bench: Bench) -> Scene:
    made = Scene(bench)
    made.wait(3, observers=4)
    seen(made.probe, lambda fact: all(len(beacon.views) == 2 for beacon in fact.beacons.values()), "that they met")
    return made


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_stopped_node_is_dead_by_consensus(scene: Scene, number: signal.Signals) -> None:
    """The others agree eventually; only the check of nodes publishes it."""
    scene.nodes["c"].send_signal(number)
    result = scene.wait(2, observers=3)
    assert result.level is api.Level.OK
    seen(scene.probe, lambda fact: not fact.beacons["/agent_1/a"].views["/agent_1/c"].alive, "its neighbour's word")
    assert scene.wait(2, observers=3).level is api.Level.OK


def test_a_restarted_node_rejoins(scene: Scene, bench: Bench) -> None:
    """It has the same name but a new identity, and all receive it."""
    scene.nodes["c"].kill()
    scene.wait(2, observers=3)
    bench.script(SCRIPT, "c")
    result = scene.wait(3, observers=4)
    assert result.level is api.Level.OK


def test_a_hung_executor_is_reported_without_breaking_consensus(scene: Scene) -> None:
    """All nodes report it alive, and its executor is blocked."""
    scene.nodes["b"].send_signal(signal.SIGUSR1)
    # A starved executor of another node is blocked, too, for a while.
    blocked = "; the executor of agent_1/b is blocked"
    result = until(
        lambda: (found := scene.run()).values.get("hung") == 1 and found.summary.endswith(blocked) and found,
        "the hung executor",
    )
    assert result.level is api.Level.OK


def test_a_split_names_its_sides(scene: Scene, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """One node returns where the others do not receive it, and it does not receive them; PHM receives all three."""
    # After 10 s the majority declares it dead, which replaces the split: a slow machine could miss that time.
    monkeypatch.setattr(_quorum, "RECEIVED_S", 1000.0)
    scene.nodes["c"].kill()
    bench.script(SCRIPT, "c", "--hello", "/elsewhere")
    # A starved node receives its neighbour late: then there are other sides for a moment.
    result = until(
        lambda: (found := scene.wait(2, "nodes_split", observers=4)).brief == "nodes split 2|1" and found,
        "two sides",
        limit_s=120.0,
    )
    assert result.level is api.Level.WARN
    assert "agent_1/a, agent_1/b | agent_1/c do not receive each other" in result.summary


def test_the_verdict_topic_shows_a_node_that_the_majority_declares_dead(
    scene: Scene, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real subscriber receives verdicts and votes; the check reports the same node, which PHM itself receives, as an error."""
    monkeypatch.setattr(_quorum, "RECEIVED_S", 1.0)
    settings = Settings.model_validate({"ros": {"nodes": [{"name": "/agent_1/a"}]}})
    port = replace(
        context(settings, clock=SystemClock()), ros=scene.probe, newest=lambda unit: scene.run() if unit else None
    )
    reporter, listener = ConsensusReporter.build(port), Listener(bench, CONSENSUS)
    assert reporter is not None

    def received(name: str, verdict: str) -> Any:
        reporter.tick()
        level, message, agent, values = listener.received.get(f"phm/agent_1/consensus: agent_1/{name}", [0, "", "", {}])
        return values.get("verdict") == verdict and (level, message, agent, values)

    for name in NAMES:
        until(lambda name=name: received(name, "alive"), f"the verdict on {name}")
    scene.nodes["c"].kill()
    bench.script(SCRIPT, "c", "--hello", "/elsewhere")
    result = until(
        lambda: (found := scene.wait(2, "quorum_dead", observers=4)).brief == "c dead by majority" and found,
        "the quorum",
        limit_s=120.0,
    )
    assert result.level is api.Level.ERROR
    expected = (
        2,
        "dead: 1 alive, 2 dead",
        "agent_1",
        {"node": "agent_1/c", "verdict": "dead", "alive": "PHM", "dead": "agent_1/a, agent_1/b"},
    )
    # While c is starved, PHM does not receive it either, and votes otherwise.
    until(lambda: received("c", "dead") == expected, f"the verdict {expected}")
    reporter.close()
    until(lambda: listener.received["phm/agent_1/consensus: agent_1/a"][:2] == [3, "PHM has stopped"], "the end")


def test_a_subscriber_that_does_not_receive_its_publisher_is_reported(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two real nodes that met, and one returns where the other does not receive it, while PHM receives both."""
    monkeypatch.setattr(_lost_publishers, "LOST_S", 1.0)
    flow = {"name": "/agent_1/flow", "publishers": ["/agent_1/c"], "subscribers": ["/agent_1/a"]}
    nodes = [{"name": "/agent_1/a"}, {"name": "/agent_1/c"}]
    (check,) = Consensus.build(testing.settings(ros={"nodes": nodes, "topics": [flow]}))
    made = {name: bench.script(SCRIPT, name) for name in ("a", "c")}
    world = testing.world(clock=SystemClock(), ros=bench.probe(nodes=nodes))
    until(lambda: check.run(world).values.get("observers") == 3, "both", limit_s=120.0)
    made["c"].kill()
    bench.script(SCRIPT, "c", "--hello", "/elsewhere")
    result = until(
        lambda: (found := check.run(world)).condition == "publisher_not_received" and found,
        "the loss",
        limit_s=120.0,
    )
    assert result.level is api.Level.ERROR and result.brief == "a does not receive c"


def test_a_node_without_a_beacon_is_observed_by_its_topic(bench: Bench) -> None:
    """The demo's node without its beacon: only PHM observes it."""
    nodes = [{"name": "/agent_1/a"}, {"name": "/agent_1/plain"}]
    (check,) = Consensus.build(testing.settings(ros={"nodes": nodes}))
    bench.script(SCRIPT, "a")
    plain: subprocess.Popen[bytes] = bench.node("plain", "--publish", "topic_1:10", "--no-beacon")
    probe = bench.probe([{"name": "/agent_1/topic_1", "rate": 10}], nodes=nodes)

    def observed() -> bool:
        result = check.run(testing.world(ros=probe))
        assert isinstance(result, api.Result)
        return result.summary.endswith("; agent_1/plain without a beacon, observed by PHM only")

    until(observed, "its observation")
    plain.kill()
    until(lambda: not observed(), "the end of its observation")
