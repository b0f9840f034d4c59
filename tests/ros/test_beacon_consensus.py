"""The consensus of real nodes: what the check says while they live, die, stop, hang, fall apart and come back."""

from __future__ import annotations

import signal
import subprocess

import pytest

from phm import api, testing
from phm.probes.ros.supervisor import RosSupervisor
from phm_checks.consensus import Consensus
from tests.fakes.ros_bench import Bench, seen, until

NAMES = ("a", "b", "c")
SCRIPT = "ros_beaconed.py"


class Scene:
    """Three nodes, the probe, and the check over it."""

    def __init__(self, bench: Bench, *extra: str) -> None:
        nodes = [{"name": f"/agent_1/{name}"} for name in (*NAMES, *extra)]
        (self._check,) = Consensus.build(testing.settings(ros={"nodes": nodes}))
        self.nodes = {name: bench.script(SCRIPT, name) for name in NAMES}
        self.probe: RosSupervisor = bench.probe(nodes=nodes)
        self._world = testing.world(ros=self.probe)

    def run(self) -> api.Result:
        result = self._check.run(self._world)
        assert isinstance(result, api.Result)
        return result

    def wait(self, alive: int, condition: str = "", observers: int = 0) -> api.Result:
        """Until so many are alive, by so many observers, and this is what is wrong."""

        def there() -> api.Result | None:
            result = self.run()
            values = result.values
            fits = values.get("alive") == alive and (not observers or values.get("observers") == observers)
            return result if fits and result.condition == condition else None

        found = until(there, f"{alive} alive, {condition or 'no trouble'}: {self.run()}", limit_s=30.0)
        assert isinstance(found, api.Result)
        return found


@pytest.fixture
def scene(bench: Bench) -> Scene:
    made = Scene(bench)
    made.wait(3, observers=4)
    seen(made.probe, lambda fact: all(len(beacon.views) == 2 for beacon in fact.beacons.values()), "that they met")
    return made


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_node_that_is_killed_or_stopped_is_dead_by_all(scene: Scene, number: signal.Signals) -> None:
    """The others agree in the end, and nothing but the check of nodes has to be told."""
    scene.nodes["c"].send_signal(number)
    result = scene.wait(2, observers=3)
    assert result.level is api.Level.OK
    seen(scene.probe, lambda fact: not fact.beacons["/agent_1/a"].views["/agent_1/c"].alive, "its neighbour's word")
    assert scene.run().level is api.Level.OK


def test_a_restarted_node_is_taken_back(scene: Scene, bench: Bench) -> None:
    """Under its name it is another one, and all hear it."""
    scene.nodes["c"].kill()
    scene.wait(2, observers=3)
    bench.script(SCRIPT, "c")
    result = scene.wait(3, observers=4)
    assert result.level is api.Level.OK


def test_a_hung_executor_is_known_and_leaves_the_agreement_whole(scene: Scene) -> None:
    """All nodes report it alive, and its executor is blocked."""
    scene.nodes["b"].send_signal(signal.SIGUSR1)
    result = until(lambda: (found := scene.run()).values.get("hung") == 1 and found, "the hung executor")
    assert result.level is api.Level.OK
    assert result.summary.endswith("; the executor of agent_1/b is blocked")


def test_a_split_names_its_sides(scene: Scene, bench: Bench) -> None:
    """One node comes back where the others do not hear it, nor it them; PHM hears all three."""
    scene.nodes["c"].kill()
    bench.script(SCRIPT, "c", "--hello", "/elsewhere")
    result = scene.wait(2, "split", observers=4)
    assert result.level is api.Level.WARN
    assert result.brief == "nodes split 2|1"
    assert "agent_1/a, agent_1/b | agent_1/c do not receive each other" in result.summary


def test_a_node_without_a_beacon_takes_part_by_its_topic(bench: Bench) -> None:
    """The demo's node without its beacon: PHM's word alone."""
    nodes = [{"name": "/agent_1/a"}, {"name": "/agent_1/plain"}]
    (check,) = Consensus.build(testing.settings(ros={"nodes": nodes}))
    bench.script(SCRIPT, "a")
    plain: subprocess.Popen[bytes] = bench.node("plain", "--publish", "topic_1:10", "--no-beacon")
    probe = bench.probe([{"name": "/agent_1/topic_1", "rate": 10}], nodes=nodes)

    def told() -> bool:
        result = check.run(testing.world(ros=probe))
        assert isinstance(result, api.Result)
        return result.summary.endswith("; agent_1/plain without a beacon, observed by PHM only")

    until(told, "its part")
    plain.kill()
    until(lambda: not told(), "the end of its part")
