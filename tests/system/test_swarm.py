"""Removal of a swarm on the real Docker Engine: nothing of it is left, however its start ended, and nothing else is
touched.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from docker import DockerClient
from docker.models.containers import Container

from sitl.swarm import engine
from sitl.swarm.cli import main
from sitl.swarm.swarm import Options, Swarm
from tests.fakes.until import until
from tests.system.conftest import APP_IMAGE, ROOT

STARTED_LIMIT_S = 240.0


@pytest.fixture
def name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("PHM_SITL_DIR", str(tmp_path))
    made = f"phm-t{uuid.uuid4().hex[:6]}"
    yield made
    Swarm(Options(agents=1, name=made)).down()


@pytest.fixture
def stranger(docker_client: DockerClient, name: str) -> Iterator[Container]:
    """A container whose name and Compose labels look like those of the swarm."""
    made = docker_client.containers.run(
        APP_IMAGE,
        ["sleep", "600"],
        entrypoint=[],
        name=f"{name}-1-mine-1",
        labels={"com.docker.compose.project": f"{name}-1", engine.LABEL: f"{name}x"},
        detach=True,
        init=True,
    )
    yield made
    made.remove(force=True)


def left(client: DockerClient, name: str) -> list[str]:
    """Everything of the swarm that remains on the Docker Engine and this machine."""
    named = [thing.name for thing in engine.resources(client, name)]
    networks = [str(one.name) for one in client.networks.list() if str(one.name).startswith(f"{name}-")]
    volumes = [str(one.name) for one in client.volumes.list() if str(one.name).startswith(f"{name}-")]
    return [*named, *networks, *volumes, *map(str, engine.devices(name))]


def test_running_containers_of_others_are_named(docker_client: DockerClient, name: str, stranger: Container) -> None:
    """A swarm whose name is the beginning of another one's is not that one."""
    assert stranger.name in engine.others(docker_client, name)
    assert stranger.name not in engine.others(docker_client, f"{name}x")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL], ids=["interrupted", "killed"])
def test_nothing_is_left_of_a_swarm_whose_start_was_interrupted(
    docker_client: DockerClient, name: str, stranger: Container, tmp_path: Path, number: signal.Signals
) -> None:
    """An interrupted `up` cleans up; after a killed one `down` does, harmlessly also twice. Other containers are not
    touched.
    """
    argv = [sys.executable, "-m", "sitl", "up", "--agents", "2", "--name", name, "--no-build"]
    process = subprocess.Popen(argv, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.DEVNULL)
    try:
        until(
            lambda: any("ros_app" in thing.name for thing in engine.resources(docker_client, name)),
            "the container ros_app",
            limit_s=STARTED_LIMIT_S,
        )
        process.send_signal(number)
        code = process.wait(STARTED_LIMIT_S)
    finally:
        process.kill()
        process.wait()
    if number is signal.SIGINT:
        assert code == 130
    else:
        assert left(docker_client, name)
        assert main(["down", "--name", name]) == 0
    assert left(docker_client, name) == []
    assert [path.name for path in tmp_path.iterdir()] == [f"{name}.lock"]
    assert main(["down", "--name", name]) == 0
    stranger.reload()
    assert stranger.status == "running"
