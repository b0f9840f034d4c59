"""A real agent for system tests: the demo application in a container, PHM as a process of this machine.

PHM runs on the host here so that a test can kill, stop and inspect it; the sidecar image itself is tested by the
demonstration (test_demo.py).
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
import yaml
from docker import DockerClient
from docker.errors import APIError, DockerException, ImageNotFound, NotFound
from docker.models.containers import Container

from sitl.harness.log_follower import Event, Record
from tests.fakes.ros_domain import claim_domain
from tests.fakes.until import until

APP_IMAGE = os.environ.get("PHM_TEST_APP_IMAGE", "phm-app:dev")
ROOT = Path(__file__).resolve().parents[2]
START_LIMIT_S = 120.0


@pytest.fixture(scope="session")
def docker_client() -> Iterator[DockerClient]:
    """The Docker Engine of this machine; without one a test fails, it is never skipped."""
    try:
        client = DockerClient.from_env(timeout=60)
        client.ping()
        client.images.get(APP_IMAGE)
    except ImageNotFound:
        pytest.fail(f"there is no image {APP_IMAGE}: run scripts/image")
    except DockerException as error:
        pytest.fail(f"no Docker Engine answers ({error}): run scripts/engine start")
    yield client
    client.close()


class AppContainer:
    """The application container `name` on the network `network`, both created for one test."""

    def __init__(self, client: DockerClient, **more: Any) -> None:
        """more: further arguments of `docker run`."""
        self.client = client
        self.name = f"phm-test-{uuid.uuid4().hex[:8]}"
        self.domain, self._claim = claim_domain()
        self.network = client.networks.create(self.name, labels={"phm.test": "1"})
        self.container: Container = client.containers.run(
            APP_IMAGE,
            name=self.name,
            detach=True,
            network=self.name,
            labels={"phm.test": "1"},
            environment={"ROS_DOMAIN_ID": str(self.domain)},
            mem_limit="500m",
            **more,
        )

    def run(self, *argv: str) -> str:
        code, output = self.container.exec_run(list(argv))
        assert code == 0, output.decode(errors="replace")
        return str(output.decode()).strip()

    def kill_node(self, name: str) -> None:
        self.run("kill", "-KILL", self.run("cat", f"/tmp/nodes/{name}.pid"))

    def identity(self) -> tuple[str, str, str, tuple[str, ...]]:
        """Properties that change when someone else acts on the container."""
        self.container.reload()
        state = self.container.attrs["State"]
        networks = tuple(sorted(self.container.attrs["NetworkSettings"]["Networks"]))
        return self.container.id or "", state["StartedAt"], state["Status"], networks

    def remove(self) -> None:
        with contextlib.suppress(NotFound, APIError):
            self.container.remove(force=True)
        with contextlib.suppress(NotFound, APIError):
            self.network.remove()
        self._claim.close()


class Phm:
    """`phm run` as a process, with its configuration, log and status in one folder."""

    def __init__(self, folder: Path, config: dict[str, Any], domain: int) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        places = {"run_dir": str(folder / "run"), "state_dir": str(folder / "state")}
        config = {**places, "log": {"directory": str(folder / "log")}, **config}
        (folder / "phm.yaml").write_text(yaml.safe_dump(config))
        self.config = folder / "phm.yaml"
        self.environ = {**os.environ, "ROS_DOMAIN_ID": str(domain), "PHM_RUN_DIR": str(folder / "run")}
        self.process: subprocess.Popen[bytes] | None = None
        self.record = Record(folder / "log" / "phm.jsonl")

    def start(self) -> None:
        with (self.folder / "output").open("ab") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "phm.cli", "run", "-c", str(self.config)],
                cwd=ROOT,
                env=self.environ,
                stdout=output,
                stderr=output,
            )

    def cli(self, *words: str, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
        argv = [sys.executable, "-m", "phm.cli", *words]
        return subprocess.run(
            argv, cwd=ROOT, env=self.environ, capture_output=True, text=True, timeout=timeout_s, check=False
        )

    def output(self) -> str:
        return (self.folder / "output").read_text(errors="replace")

    def children(self) -> list[psutil.Process]:
        assert self.process is not None
        return [
            child
            for child in psutil.Process(self.process.pid).children()
            if "phm.probes.ros" in " ".join(_command(child))
        ]

    def wait(self, wanted: Callable[[Event], bool], what: str, limit_s: float = 120.0, since: int = 0) -> Event:
        """Return the first matching event of the JSON log; fail with the end of the text log on timeout."""
        event = self.record.wait(wanted, limit_s, since=since)
        if event is None:
            text = self.folder / "log" / "phm.log"
            tail = "\n".join(text.read_text(errors="replace").splitlines()[-40:]) if text.exists() else self.output()
            pytest.fail(f"{what} did not happen within {limit_s:g} s; the log ends with\n{tail}")
        return event

    def wait_all_ok(self, since: int = 0) -> None:
        self.wait(
            lambda event: event["event"] == "report" and all(digit == 1 for digit in event["status_array"]),
            "a report with everything OK",
            START_LIMIT_S,
            since,
        )

    def mark(self) -> int:
        self.record.update()
        return len(self.record.events)

    def opened(self, since: int) -> list[str]:
        """Units of the faults that were opened, without the load of this machine, which other programs may cause."""
        self.record.update()
        opened = (event["unit"] for event in self.record.events[since:] if event["event"] == "fault_opened")
        return [unit for unit in opened if unit != "host/cpu"]

    def stop(self) -> int:
        """Send SIGTERM, and SIGKILL on timeout; return the exit code."""
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            pytest.fail(f"PHM did not end within 60 s of SIGTERM:\n{self.output()}")


def config_for(app: AppContainer, **more: Any) -> dict[str, Any]:
    """A configuration of the demo application; `more` replaces top-level sections."""
    names = [f"/agent_1/node_{number}" for number in (1, 2, 3)]
    topics = [
        {"name": f"/agent_1/topic_{number}", "rate": "10Hz", "type": "std_msgs/msg/String", "publishers": [name]}
        for number, name in enumerate(names, 1)
    ]
    return {
        "interval": "3s",
        "containers": [
            {
                "name": app.name,
                "recover": True,
                "networks": [app.name],
                "files": [{"path": "/ws/src/critical_file", "executable": True}],
                "devices": [{"path": "/dev/null", "mapped": False}],
            }
        ],
        "ros": {"domain": app.domain, "nodes": [{"name": name} for name in names], "topics": topics},
        # The load of the machine that runs the tests is not under test.
        "checks": {"host": {"enabled": False}},
        **more,
    }


@pytest.fixture
def app(docker_client: DockerClient) -> Iterator[AppContainer]:
    """An application container created for one test."""
    container = AppContainer(docker_client)
    try:
        yield container
    finally:
        container.remove()


@pytest.fixture
def start_phm(tmp_path: Path) -> Iterator[Callable[..., Phm]]:
    """Start PHM daemons with a configuration; end each with the test."""
    running: list[Phm] = []

    def start(config: dict[str, Any], domain: int = 0) -> Phm:
        phm = Phm(tmp_path / f"phm{len(running)}", config, domain)
        running.append(phm)
        phm.start()
        return phm

    yield start
    for phm in running:
        if phm.process is not None and phm.process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                phm.process.send_signal(signal.SIGCONT)
            phm.stop()


def _command(process: psutil.Process) -> list[str]:
    """Empty for a process that has ended and that PHM has not waited for yet."""
    try:
        return process.cmdline()
    except psutil.NoSuchProcess:
        return []


def poll(condition: Callable[[], bool], what: str, limit_s: float = 120.0) -> None:
    """Wait until `condition` is true, with fewer looks than `until`: each may ask the Docker Engine."""
    until(condition, what, limit_s=limit_s, poll_s=0.05)
