"""The nodes check against real containers: process lists of nodes that the graph still lists."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm.core.clock import SystemClock
from phm.probes.docker import Docker
from phm.transport.docker import DockerEngine
from phm_checks.nodes import Nodes
from tests.fakes.until import until

FAKE = "bash -c 'while :; do sleep 1; done' fake --name node_{} --namespace /agent_1"


class Agent:
    """Two fake nodes of one real container, with a ROS graph that does not change."""

    def __init__(self, name: str, engine: DockerEngine) -> None:
        nodes = [{"name": f"/agent_1/node_{number}"} for number in (1, 2)]
        settings = testing.settings(
            containers=[{"name": name, "alias": "ros_app"}],
            ros={"nodes": nodes, "grace": "60s"},  # a busy machine may need that long to start both
        )
        (self.check,) = Nodes.build(settings)
        ros = testing.FakeRos(nodes={node["name"]: 1 for node in nodes})
        self.docker = Docker(engine, settings.containers, settings.docker, SystemClock())
        self.world = testing.world(clock=SystemClock(), docker=self.docker, ros=ros)

    def results(self) -> dict[str, api.Result]:
        results = self.check.run(self.world)
        assert not isinstance(results, api.Result)
        return {unit.rpartition("/")[2]: result for unit, result in results.items()}

    def pids(self) -> dict[str, str]:
        """Of the nodes whose process has been found."""
        words = {node: str(result.values["process"]) for node, result in self.results().items()}
        return {node: said.partition(" ")[0] for node, said in words.items() if said != "none found"}

    def shows(self, node: str, condition: str, process: str) -> None:
        """Wait until the node has this condition and process text; the other one is OK all the time."""

        def shown() -> bool:
            results = self.results()
            other = results["node_2" if node == "node_1" else "node_1"]
            assert other.level in (api.Level.OK, api.Level.STALE), other.summary
            return results[node].condition == condition and process in str(results[node].values["process"])

        until(shown, f"{node} as {condition or 'healthy'}, process {process}")


@pytest.fixture
def made(real: Any) -> Any:
    return real.container(f"{FAKE.format(1)} & {FAKE.format(2)} & wait; exec sleep 600")


def test_a_stopped_and_then_killed_process_is_detected(made: Any, engine: DockerEngine) -> None:
    """Hung while it is stopped, OK when it is resumed, dead when it is killed; its name is listed throughout."""
    agent = Agent(made.name, engine)
    agent.shows("node_1", "", " S")
    for signal, condition, process in (
        ("STOP", "node_hung", " T"),
        ("CONT", "", " S"),
        ("KILL", "node_missing", " ended"),
    ):
        made.exec_run(["pkill", f"-{signal}", "-f", "^bash.*node_1"])
        agent.shows("node_1", condition, process)


def test_a_restarted_container_has_other_processes(made: Any, engine: DockerEngine) -> None:
    """The earlier processes are gone: no node is reported dead, and the new processes are found."""
    agent = Agent(made.name, engine)
    before = until(lambda: len(pids := agent.pids()) == 2 and pids, "the processes before the restart")
    made.restart(timeout=0)
    agent.docker.invalidate()  # as the engine's event does

    def others() -> bool:
        pids = agent.pids()
        return len(pids) == 2 and not any(pids[node] == before[node] for node in pids)

    until(others, "the processes after the restart", agent.pids)
    assert {result.level for result in agent.results().values()} == {api.Level.OK}


def test_nodes_of_a_stopped_container_have_its_state_as_evidence(made: Any, engine: DockerEngine) -> None:
    """The tracker then reports it for the container."""
    agent = Agent(made.name, engine)
    agent.shows("node_1", "", " S")
    made.kill()
    agent.docker.invalidate()
    until(lambda: "its container is exited" in agent.results()["node_1"].summary, "the end of the container")
