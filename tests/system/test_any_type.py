"""A message package that only the application's container has, and the sidecar's container beside it."""

from __future__ import annotations

import contextlib
import json
import os
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from docker import DockerClient
from docker.errors import APIError, NotFound
from docker.models.containers import Container

from phm.facts import RateFact
from tests.fakes import app_messages
from tests.fakes.ros_domain import claim_domain
from tests.fakes.ros_truth import within_2_percent
from tests.system.conftest import APP_IMAGE, ROOT, poll

SIDECAR_IMAGE = os.environ.get("PHM_TEST_SIDECAR_IMAGE", "phm-sidecar:dev")
HZ = 20
TOPICS = {
    "/agent_1/plain": "sensor_msgs/msg/Range",
    "/agent_1/nested": "sensor_msgs/msg/Imu",
    "/agent_1/unbounded": "sensor_msgs/msg/Image",
}


class Pair:
    """An application's container with sensor_msgs and a sidecar's without, on a network created for one test."""

    def __init__(self, client: DockerClient, folder: Path) -> None:
        self._client = client
        self._folder = folder
        self._made: list[Any] = []
        self._name = f"phm-test-{uuid.uuid4().hex[:8]}"
        domain, self._claim = claim_domain()
        self._domain = str(domain)
        self._made.append(client.networks.create(self._name, labels={"phm.test": "1"}))
        self.sidecar: Container

    def start(self) -> None:
        which = "import sys; print('%d.%d' % sys.version_info[:2])"
        python = self._client.containers.run(APP_IMAGE, ["python", "-c", which], remove=True).decode().strip()
        install = app_messages.install("jazzy", python)
        self._run(
            "app",
            APP_IMAGE,
            ["python", "/ws/source.py", str(HZ), "/ws/out/sent"],
            {
                "PYTHONPATH": f"/ws/install/lib/python{python}/site-packages",
                "LD_LIBRARY_PATH": "/ws/install/lib",
            },
            {
                str(install): "/ws/install:ro",
                str(ROOT / "tests" / "fakes" / "ros_typed_source.py"): "/ws/source.py:ro",
                str(self._folder): "/ws/out:rw",
            },
        )
        topics = [{"name": name, "type": kind, "rate": HZ} for name, kind in TOPICS.items()]
        config = self._folder / "phm.yaml"
        # The load of the machine that runs the tests is not under test.
        config.write_text(yaml.safe_dump({"ros": {"topics": topics}, "checks": {"host": {"enabled": False}}}))
        config.chmod(0o644)
        # With the privileges of docker/compose.yaml: creating types by name inspects this process's own memory.
        own = "uid=10001,gid=10001"
        self.sidecar = self._run(
            "phm",
            SIDECAR_IMAGE,
            ["run"],
            {},
            {str(config): "/etc/phm/phm.yaml:ro"},
            read_only=True,
            cap_drop=["ALL"],
            security_opt=["no-new-privileges:true"],
            tmpfs={"/run/phm": own, "/var/log/phm": own, "/var/lib/phm": own, "/tmp": "mode=1777"},
        )

    def _run(
        self,
        role: str,
        image: str,
        command: list[str],
        environment: dict[str, str],
        mounts: dict[str, str],
        **more: Any,
    ) -> Container:
        container = self._client.containers.run(
            image,
            command,
            name=f"{self._name}-{role}",
            detach=True,
            network=self._name,
            labels={"phm.test": "1"},
            environment={"ROS_DOMAIN_ID": self._domain, **environment},
            mem_limit="400m",
            volumes=[f"{path}:{target}" for path, target in mounts.items()],
            **more,
        )
        self._made.insert(0, container)
        return container

    def python(self, code: str) -> int:
        """The exit code of a line of Python inside the sidecar."""
        return int(self.sidecar.exec_run(["python", "-c", code]).exit_code)

    def units(self) -> dict[str, Any]:
        """The units of `phm status`; empty while it reports none."""
        output = self.sidecar.exec_run(["phm", "status", "--json"], stderr=False).output
        with contextlib.suppress(json.JSONDecodeError):
            return {unit["id"]: unit for unit in json.loads(output).get("checks", [])}
        return {}

    def remove(self) -> None:
        for made in self._made:
            with contextlib.suppress(NotFound, APIError):
                made.remove(**({"force": True, "v": True} if isinstance(made, Container) else {}))
        self._claim.close()


@pytest.fixture
def pair(docker_client: DockerClient, tmp_path: Path) -> Iterator[Pair]:
    made = Pair(docker_client, tmp_path)
    try:
        yield made
    finally:
        made.remove()


def test_rates_of_types_that_only_the_application_has(pair: Pair, tmp_path: Path) -> None:
    """The sidecar cannot import the package; its topics are still OK, each with its real rate."""
    pair.start()
    assert pair.python("import std_msgs") == 0
    assert pair.python("import sensor_msgs") != 0

    def right() -> bool:
        units = pair.units()
        rates = [units.get(f"rates{name}", {}) for name in TOPICS]
        there = all(units.get(f"topics{name}", {}).get("level") == "OK" for name in TOPICS)
        return there and all(
            rate.get("level") == "OK"
            and within_2_percent(RateFact(rate["values"]["hz"], 0.0, rate["values"]["window_s"]), tmp_path / "sent")
            for rate in rates
        )

    poll(right, "three topics with right rates")
