"""Faults of the demo application, on the real container with its ROS nodes: each breaks it, seen without PHM, and clearing ends that."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator

import pytest
from docker import DockerClient

from sitl.faults import all_faults, healthcheck_hangs, memory_leak, sigterm_ignored
from sitl.faults._application import seen, works
from sitl.faults._node_signal import NodeSignal
from sitl.faults._reading import ReadingFault
from sitl.faults.base import Agent
from tests.fakes.ros_domain import claim_domain
from tests.fakes.until import until

APP_IMAGE = os.environ.get("PHM_TEST_APP_IMAGE", "phm-app:dev")
LEAKS = 3
SIGNALS = [name for name, fault in all_faults().items() if isinstance(fault, NodeSignal)]


@pytest.fixture(scope="module")
def agent() -> Iterator[Agent]:
    """An agent of the application alone. Its tests leave it working."""
    client = DockerClient.from_env(timeout=60)
    project = f"phm-test-{uuid.uuid4().hex[:8]}"
    network = client.networks.create(project, labels={"phm.test": "1"})
    found = Agent(project, "agent_1", client)
    domain, claim = claim_domain()
    try:
        client.containers.run(
            APP_IMAGE,
            ["python", "-m", "sitl.application.app"],
            name=f"{project}-ros_app-1",
            detach=True,
            network=project,
            labels={"com.docker.compose.project": project, "com.docker.compose.service": "ros_app", "phm.test": "1"},
            environment={"ROS_DOMAIN_ID": str(domain)},
            mem_limit="500m",
            memswap_limit="500m",
        )
        until(lambda: works(found), "the application's start")
        yield found
    finally:
        own = {"label": f"com.docker.compose.project={project}"}
        for container in client.containers.list(all=True, filters=own, ignore_removed=True):
            container.remove(force=True)
        network.remove()
        client.close()
        claim.close()


@pytest.mark.parametrize("name", [*SIGNALS, "node_duplicate"])
def test_a_fault_breaks_the_application_and_clearing_ends_that(agent: Agent, name: str) -> None:
    """As the application's own nodes record it."""
    fault = all_faults()[name]
    if isinstance(fault, ReadingFault):
        fault.prepare(agent)
    until(lambda: fault.restored(agent), "the application", lambda: seen(agent))
    fault.inject(agent)
    until(lambda: not fault.restored(agent), "its effect")
    fault.clear(agent)
    until(lambda: fault.restored(agent), "its end", lambda: seen(agent))
    if isinstance(fault, ReadingFault):
        fault.dismantle(agent)


def test_a_leak_ends_one_node_and_not_the_container(agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel ends the node that leaks, since it is the largest process. Until that one is gone, it now and then ends another,
    too (seen once): then the leak is repeated."""
    monkeypatch.setattr(memory_leak, "LASTS_S", 2.0)
    left = [_after_a_leak(agent)]
    while left[-1] < 2 and len(left) < LEAKS:
        left.append(_after_a_leak(agent))
    assert left[-1] == 2, left


def _after_a_leak(agent: Agent) -> int:
    """How many nodes are left after it. The application works again afterwards."""
    fault, generation = memory_leak.Injection(), agent.generation
    leaking = agent.processes(agent.app, "--name node_1")
    try:
        fault.inject(agent)
        until(lambda: not fault.restored(agent), "its effect")
        nodes = agent.processes(agent.app, "sitl.application.node")
        assert (len(leaking), agent.generation) == (1, generation)
        assert leaking[0] not in nodes
        return len(nodes)
    finally:
        fault.clear(agent)
        until(lambda: works(agent), "the application")


def test_an_application_that_ignores_sigterm_is_killed_after_its_timeout(agent: Agent) -> None:
    """The next run obeys again."""
    fault = sigterm_ignored.Injection()
    fault.inject(agent)
    until(lambda: not fault.restored(agent), "its effect")
    assert _stop_code(agent, timeout_s=1) == 137
    agent.app.start()
    until(lambda: works(agent), "the application")
    assert _stop_code(agent, timeout_s=60) == 0
    agent.app.start()
    until(lambda: works(agent), "the application")


def _stop_code(agent: Agent, timeout_s: int) -> int:
    agent.app.stop(timeout=timeout_s)
    return int(agent.app.attrs["State"]["ExitCode"])


def test_a_health_check_hangs_until_the_next_start(agent: Agent) -> None:
    """Its process does not return; the next run of the container has one that does."""
    fault = healthcheck_hangs.Injection()
    fault.inject(agent)
    until(lambda: agent.processes(agent.app, "sleep 3600"), "a health check that hangs")
    agent.app.restart(timeout=3)
    until(lambda: fault.restored(agent), "a health check that returns")
    fault.clear(agent)
