"""Faults on the real Docker Engine: the injector itself observes that the world is broken, and that it is restored."""

from __future__ import annotations

import contextlib
import json
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from docker import DockerClient
from docker.errors import DockerException
from docker.models.containers import Container

from sitl.faults import _world, all_faults, log_read_only, phm_state_noise
from sitl.faults._volumes import behind
from sitl.faults.base import Agent, Fault
from sitl.faults.file_deleted import CRITICAL
from tests.fakes.until import until

JOIN = """
import socket, time
group = socket.inet_aton("239.255.0.1") + socket.inet_aton("0.0.0.0")
member = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
while True:
    try:
        member.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        break
    except OSError:
        time.sleep(0.1)
time.sleep(3600)
"""
"""A member of the group of DDS discovery, as nodes are."""
APP = (
    f"python3 -c '{JOIN}' & "
    "mkdir -p /ws/src; printf '#!/bin/sh\\nexit 0\\n' >/ws/src/critical_file; chmod 755 /ws/src/critical_file; "
    "rm -f /tmp/unhealthy; [ ! -s /tmp/broken_start ] || exit 1; "
    "while :; do sleep 1; done"
)
PHM = "b=bin; sh -c 'while :; do sleep 1; done' $b/phm run"
STATE, LOG = phm_state_noise.FOLDER, log_read_only.FOLDER
RECOVERED_BY_CLEAR = (
    "address_silent", "container_created", "container_killed", "container_paused", "container_stopped", "crash_loop",
    "device_gone", "file_altered", "file_deleted", "file_not_executable", "log_read_only", "network_blocked",
    "network_disconnected", "network_lost_together", "network_recreated", "power_loss", "sidecar_disconnected",
    "unhealthy",
)  # fmt: skip


@pytest.fixture(scope="module")
def agent() -> Iterator[Agent]:
    """Two small containers in the places of the application and of PHM, with what the faults affect."""
    client = DockerClient.from_env(timeout=60)
    project = f"phm-test-{uuid.uuid4().hex[:8]}"
    agent = Agent(project, "agent_1", client)
    network = client.networks.create(f"{project}_net", labels={"phm.test": "1"})
    volumes = [client.volumes.create(f"{project}_{name}", labels={"phm.test": "1"}) for name in ("log", "state")]
    agent.make_device()

    def run(service: str, script: str, *words: str, **options: object) -> Container:
        labels = {"com.docker.compose.project": project, "com.docker.compose.service": service, "phm.test": "1"}
        return client.containers.run(  # type: ignore[call-overload, no-any-return]
            "phm-base:dev",
            ["sh", "-c", script, *words],
            name=f"{project}-{service}-1",
            detach=True,
            init=True,
            labels=labels,
            network=network.name,
            **options,
        )

    try:
        run("ros_app", APP, devices=[f"{agent.device}:{agent.device}:rwm"])
        mounts = {volumes[0].name: {"bind": LOG}, volumes[1].name: {"bind": STATE}}
        run("phm", PHM, restart_policy={"Name": "unless-stopped"}, volumes=mounts)
        for name in log_read_only.FILES:
            (behind(agent.sidecar, LOG) / name).write_text("a line\n")
        until(lambda: agent.app.exec_run(["test", "-x", CRITICAL]).exit_code == 0, "the critical file")
        yield agent
    finally:
        own = {"label": f"com.docker.compose.project={project}"}
        for container in client.containers.list(all=True, filters=own, ignore_removed=True):
            container.remove(force=True, v=True)
        client.networks.get(f"{project}_net").remove()
        for volume in volumes:
            volume.remove(force=True)
        agent.device.unlink(missing_ok=True)
        client.close()


@pytest.fixture(autouse=True)
def _without_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The small containers have no nodes; tests/sitl/faults/test_application_faults_real.py is about those."""
    monkeypatch.setattr(_world, "works", lambda agent: True)


def observed(fault: Fault, agent: Agent) -> bool | None:
    """None where the engine cannot say, as while a container starts."""
    with contextlib.suppress(DockerException):
        return fault.restored(agent)
    return None


@pytest.mark.parametrize("name", RECOVERED_BY_CLEAR)
def test_the_world_is_observed_to_be_broken_and_restored(agent: Agent, name: str) -> None:
    """Injected: the fault's own observation says that the world is broken. Cleared, twice: that it is restored."""
    fault = all_faults()[name]
    fault.inject(agent)
    until(lambda: observed(fault, agent) is False, "the broken world")
    for _ in range(2):
        fault.clear(agent)
    until(lambda: observed(fault, agent) is True, "the restored world")


def test_a_container_that_is_only_connected_again_is_not_restored(agent: Agent) -> None:
    """Its programs are not members of their multicast groups on the new interface until they are restarted."""
    fault = all_faults()["network_disconnected"]
    # One that starts late would join on the new interface.
    until(lambda: _world.found_by_others(agent.app), "the member of the group")
    fault.inject(agent)
    agent.docker.networks.get(f"{agent.project}_net").connect(agent.app)
    assert _world.attached(agent, agent.app, f"{agent.project}_net")
    assert fault.restored(agent) is False
    fault.clear(agent)
    until(lambda: observed(fault, agent) is True, "the restarted container")


def test_a_killed_phm_is_back_once_another_process_runs(agent: Agent) -> None:
    """The restart policy starts it; the killed process does not count."""
    fault = all_faults()["phm_killed"]
    fault.inject(agent)
    until(lambda: observed(fault, agent) is True, "another process")


def test_a_replugged_device_is_restored_when_the_container_can_open_it(agent: Agent) -> None:
    """The device alone is not enough: the container has the numbers with which it was started."""
    fault = all_faults()["device_replugged"]
    fault.inject(agent)
    assert fault.restored(agent) is False
    agent.app.restart(timeout=1)
    until(lambda: observed(fault, agent) is True, "the device in the container")


def test_noise_fills_every_file_of_the_state(agent: Agent) -> None:
    """Owner and mode stay; the state is restored once it is JSON again and another daemon runs."""
    folder = behind(agent.sidecar, STATE)
    state, other = folder / "state.json", folder / "flight"
    for file in (state, other):
        file.write_text(json.dumps({"v": 4}))
        os.chown(file, 10001, 10001)
    before = _owners(folder)
    fault = all_faults()["phm_state_noise"]
    fault.inject(agent)
    assert _owners(folder) == before
    for file in (state, other):
        assert file.read_bytes()[:7] != b'{"v": 4'
    assert fault.restored(agent) is False
    state.write_text("{}")
    until(lambda: observed(fault, agent) is True, "another process")


def _owners(folder: Path) -> dict[str, tuple[int, int]]:
    return {file.name: (file.stat().st_uid, file.stat().st_mode) for file in folder.iterdir()}


def test_an_immutable_file_refuses_writes_of_those_that_have_it_open(agent: Agent) -> None:
    """As PHM has its log open."""
    fault = all_faults()["log_read_only"]
    with (behind(agent.sidecar, LOG) / log_read_only.FILES[0]).open("ab", buffering=0) as stream:
        fault.inject(agent)
        with pytest.raises(OSError, match="not permitted"):
            stream.write(b"lost\n")
        fault.clear(agent)
        stream.write(b"kept\n")


def test_a_recreated_network_has_another_id_and_the_same_labels(agent: Agent) -> None:
    """So that its project still removes it."""
    name = f"{agent.project}_net"
    before = agent.docker.networks.get(name)
    fault = all_faults()["network_recreated"]
    fault.inject(agent)
    after = agent.docker.networks.get(name)
    assert after.id != before.id
    assert after.attrs["Labels"] == before.attrs["Labels"]
    assert agent.sidecar.status == "running"
    fault.clear(agent)
