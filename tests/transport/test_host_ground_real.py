"""A ground station on the host, and PHM in a bridged container: docker/compose.yaml as shipped, but another port."""

from __future__ import annotations

import json
import os
import subprocess
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from sitl.harness.compose_stack import SOCKET
from tests.fakes.ground import Ground, ground_station
from tests.fakes.ros_domain import claim_domain
from tests.fakes.until import until

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 180.0
Compose = Callable[..., str]


@pytest.fixture
def ground() -> Iterator[Ground]:
    with ground_station() as station:
        yield station


@pytest.fixture
def compose(ground: Ground) -> Iterator[Compose]:
    """Runs `docker compose` in a project with PHM alone, which is removed afterwards. Its application does not exist."""
    name = f"phm-host-{uuid.uuid4().hex[:8]}"
    domain, claim = claim_domain()
    environment = {
        **os.environ,
        "PHM_APP": name,
        "PHM_NETWORK": name,
        "PHM_APP_VOLUME": name,
        "PHM_DEVICE": "/dev/null",
        "PHM_MAVLINK": f"udpout:host.docker.internal:{ground.port}",
        "DOCKER_GID": str(SOCKET.stat().st_gid),
        "ROS_DOMAIN_ID": str(domain),
    }

    def run(*words: str) -> str:
        argv = ["docker", "compose", "--project-name", name, "--file", "docker/compose.yaml", *words]
        done = subprocess.run(
            argv, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
        )
        assert done.returncode == 0 or words[0] == "exec", f"{words}: {done.stderr}"
        return done.stdout

    yield run
    run("down", "--volumes", "--timeout", "3")
    claim.close()


def test_a_ground_station_on_the_host_and_a_bridged_phm_receive_each_other(ground: Ground, compose: Compose) -> None:
    """The ground station, which listens on all addresses, receives PHM's HEARTBEAT, and its answer makes `gcs` OK."""
    compose("up", "--detach", "--no-build")
    until(lambda: (1, 193) in ground.heartbeats, "a HEARTBEAT of PHM", lambda: ground.heartbeats, limit_s=LIMIT_S)

    def ground_unit() -> dict[str, str]:
        text = compose("exec", "-T", "phm", "phm", "status", "--json")
        units = json.loads(text).get("checks", []) if text.startswith("{") else []
        return next((unit for unit in units if unit["id"] == "gcs"), {})

    until(lambda: ground_unit().get("level") == "OK", "`gcs` to be OK", ground_unit, limit_s=LIMIT_S, poll_s=0.5)
