"""PHM's container behind the shipped proxy, started as an operator does: with one additional compose file."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from sitl.harness.compose_stack import ROOT, SOCKET
from tests.system.conftest import AppContainer, poll

LIMIT_S = 180.0
FILES = ("docker/compose.yaml", "docker/compose.proxy.yaml")


class Stack:
    """PHM, the proxy and the writer of its rules, for one application container."""

    def __init__(self, app: AppContainer) -> None:
        self.app, self.me = app, f"{app.name}-phm"
        self.words = ["--project-name", f"{app.name}-proxy", *(word for name in FILES for word in ("--file", name))]
        gid = str(SOCKET.stat().st_gid)
        self.environment = {
            **os.environ,
            "PHM_APP": app.name,
            "PHM_NETWORK": app.name,
            "PHM_CONTAINER": self.me,
            "DOCKER_GID": gid,
            "PHM_DEVICE": "/dev/null",
            "PHM_INTERVAL": "3s",
            "ROS_DOMAIN_ID": str(app.domain),
            "PHM_APP_VOLUME": self.me,
        }

    def compose(self, *words: str) -> str:
        done = subprocess.run(
            ["docker", "compose", *self.words, *words],
            cwd=ROOT,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        assert done.returncode == 0, f"{words}: {done.stderr}"
        return done.stdout

    def level(self, unit: str) -> str:
        """Empty while PHM has no status yet."""
        _, output = self.app.client.containers.get(self.me).exec_run(["phm", "status", "--json"])
        units = json.loads(output).get("checks", []) if output.startswith(b"{") else []
        return next((str(entry["level"]) for entry in units if entry["id"] == unit), "")

    def show(self) -> None:
        """Print what PHM has logged: pytest shows it when the test has failed."""
        log = self.app.client.containers.get(self.me).exec_run(
            ["sh", "-c", "grep -v -e SUCCESS -e REPORT /var/log/phm/phm.log"]
        )
        print(log.output.decode(errors="replace"))  # noqa: T201

    def service(self, name: str) -> Any:
        (found,) = self.compose("ps", "--all", "--quiet", name).split()
        return self.app.client.containers.get(found)


@pytest.fixture
def stack(app: AppContainer) -> Iterator[Stack]:
    made = Stack(app)
    try:
        made.compose("up", "--detach", "--no-build")
        yield made
    finally:
        made.show()
        made.compose("down", "--volumes", "--timeout", "3")


@pytest.mark.long
def test_phm_recovers_through_the_proxy_without_the_engines_socket(app: AppContainer, stack: Stack) -> None:
    """It joins the network, sees files and nodes, restarts a killed container and reconnects a disconnected one."""
    for unit in ("container/ros_app", "files/ros_app", "network/ros_app", "nodes/agent_1/node_1"):
        poll(lambda unit=unit: stack.level(unit) == "OK", f"{unit} to be OK", LIMIT_S)  # type: ignore[misc]
    app.container.kill()
    poll(lambda: app.identity()[2] == "running", "the container to run again", LIMIT_S)
    app.network.disconnect(app.container, force=True)
    poll(lambda: app.identity()[3] == (app.name,), "the network to be there again", LIMIT_S)
    refused = [line for line in stack.service("proxy").logs().decode().splitlines() if line.startswith("403")]
    # On a busy machine PHM queries unknown container names, and continues without an answer.
    assert all("/containers/json?" in line for line in refused), refused
    seen = app.client.containers.get(stack.me)
    assert seen.exec_run(["test", "-S", "/var/run/docker.sock"])[0] == 1
    assert seen.exec_run(["sh", "-c", ": > /run/phm-engine/docker.sock2"])[0] != 0


def test_the_proxy_has_least_privilege(stack: Stack) -> None:
    """Not root, the group of the engine's socket, nothing writable but its own socket's folder, no capabilities, no
    network.
    """
    seen = stack.service("proxy").attrs
    host = seen["HostConfig"]
    assert seen["Config"]["User"] == "10002:10001"
    assert host["GroupAdd"] == [str(SOCKET.stat().st_gid)]
    assert (host["ReadonlyRootfs"], host["CapDrop"], host["NetworkMode"]) == (True, ["ALL"], "none")
    assert host["SecurityOpt"] == ["no-new-privileges:true"]
    writable = {mount["Destination"] for mount in seen["Mounts"] if mount["RW"]}
    assert writable == {"/run/phm-engine", str(SOCKET)}
    rules = stack.service("proxy_rules")
    assert rules.attrs["State"]["ExitCode"] == 0
    assert str(SOCKET) not in {mount["Source"] for mount in rules.attrs["Mounts"]}
