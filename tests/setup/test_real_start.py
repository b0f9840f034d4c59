"""`phm init`, then `docker compose up -d` in its folder: PHM monitors the application, on a bridge and on the host's network."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from docker import DockerClient
from docker.errors import APIError, NotFound

from phm.cli import group
from tests.fakes.ground import Ground, ground_station
from tests.fakes.ros_domain import claim_domain
from tests.fakes.until import until

APP_IMAGE = os.environ.get("PHM_TEST_APP_IMAGE", "phm-app:dev")
LIMIT_S = 180.0
Start = Callable[..., str]


def run(*words: str, cwd: Path, check: bool = True) -> str:
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=180, check=False)
    assert not check or done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts the demo's application and returns the container's name; removes it with its network."""
    client, name = DockerClient.from_env(timeout=60), f"phm-init-{uuid.uuid4().hex[:8]}"
    domain, claim = claim_domain()

    def app(network: str) -> str:
        # Loopback alone: on the host's network nothing of this test may reach another machine.
        environment = {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST" if network == "host" else "SUBNET",
        }
        if network != "host":
            client.networks.create(name, labels={"phm.test": "1"})
        client.containers.run(
            APP_IMAGE,
            ["python", "-m", "sitl.application.app", "--nodes", "1"],
            name=name,
            detach=True,
            network="host" if network == "host" else name,
            environment=environment,
            labels={"phm.test": "1"},
            mem_limit="300m",
        )
        return name

    yield app
    with contextlib.suppress(NotFound, APIError):
        client.containers.get(name).remove(force=True)
    with contextlib.suppress(NotFound, APIError):
        client.networks.get(name).remove()
    client.close()
    claim.close()


@pytest.fixture
def ground() -> Iterator[Ground]:
    with ground_station() as station:
        yield station


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """The folder that `phm init` writes; what was started from it is removed."""
    place = tmp_path / f"phm-{uuid.uuid4().hex[:8]}"
    yield place
    if (place / "compose.yaml").exists():
        run("docker", "compose", "down", "--volumes", "--timeout", "3", cwd=place)


def status(folder: Path) -> dict[str, str]:
    """The level of each unit, by id, as the sidecar prints it; empty before it answers."""
    text = run("docker", "compose", "exec", "-T", "phm", "phm", "status", "--json", cwd=folder, check=False)
    try:
        document: dict[str, Any] = json.loads(text)
    except ValueError:
        return {}
    return {unit["id"]: unit["level"] for unit in document.get("checks", ())}


@pytest.mark.parametrize("network", ["bridge", "host"])
def test_the_written_folder_starts_a_sidecar_that_sees_the_application(
    network: str, start: Start, folder: Path, ground: Ground
) -> None:
    """Container, health, network and a ground station of this machine are OK; its ROS settings are the application's."""
    app = start(network)
    host = "127.0.0.1" if network == "host" else "host.docker.internal"
    options = ("--yes", "--no-ros", "--container", app, "--mavlink", f"udpout:{host}:{ground.port}")
    for words in (["init", str(folder), *options], ["validate", str(folder / "phm.yaml")]):
        result = CliRunner().invoke(group, words)
        assert result.exit_code == 0, result.output
    run("docker", "compose", "up", "--detach", cwd=folder)
    wanted = {
        f"container/{app}",
        f"health/{app}",
        "engine",
        "gcs",
        *([f"network/{app}"] if network == "bridge" else []),
    }

    def healthy() -> bool:
        levels = status(folder)
        return all(levels.get(unit) == "OK" for unit in wanted)

    def seen() -> str:
        return f"{status(folder)}\n{run('docker', 'compose', 'logs', cwd=folder)}"

    until(healthy, f"{wanted} to be OK", seen, limit_s=LIMIT_S, poll_s=0.5)
    settings = run("docker", "compose", "exec", "-T", "phm", "env", cwd=folder)
    application = {line for line in client_environment(app) if line.startswith("ROS_")}
    assert {line for line in application if not line.endswith("=SUBNET")} <= set(settings.splitlines())
    assert (folder / "logs" / "phm.jsonl").stat().st_size > 0


def client_environment(name: str) -> list[str]:
    """The configured environment of a container."""
    with contextlib.closing(DockerClient.from_env(timeout=60)) as client:
        found: list[str] = client.containers.get(name).attrs["Config"]["Env"]
    return [line for line in found if not line.startswith("ROS_LOG_DIR")]
