"""The demonstration as users run it: Compose, the real sidecar image, a simulated autopilot, a ground listener."""

from __future__ import annotations

import io
import socket
import uuid
from collections.abc import Iterator

import pytest
from docker import DockerClient
from rich.console import Console

from sitl.demo import main
from sitl.harness.compose_stack import Stack
from sitl.harness.config_overrides import overridden, write
from sitl.harness.log_follower import Record
from tests.system.conftest import poll


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def stack() -> Iterator[Stack]:
    """One agent for all tests of this file. The load of the machine that runs them is not under test."""
    config = write(overridden({"\nchecks:\n": "\nchecks:\n  host:\n    enabled: false\n"}))
    extra = {"PHM_CONFIG": str(config)}
    stack = Stack(f"phm-test-{uuid.uuid4().hex[:6]}", interval_s=5.0, ground_port=free_port(), extra=extra)
    try:
        stack.up()
        yield stack
    finally:
        stack.down()


def test_the_demonstration_detects_and_recovers_four_faults(
    stack: Stack, docker_client: DockerClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pass without faults, then four faults, each reported once at its cause, recovered, verified and sent to the
    ground: exit 0.
    """
    for limit in ("CLEAN_LIMIT_S", "FAULT_LIMIT_S"):  # those of an idle machine, on which somebody waits
        monkeypatch.setattr(main, limit, 180.0)
    output = io.StringIO()
    code = main.run(stack, Console(file=output, width=200))
    assert code == 0, output.getvalue()
    assert "A01 FAIL 6 node_1 dead" in output.getvalue()


def test_the_sidecar_runs_with_least_privilege_and_is_healthy(stack: Stack, docker_client: DockerClient) -> None:
    """Not root, nothing writable, no capabilities; its own HEALTHCHECK passes; it joined the network without help."""
    phm = stack.agent.container("phm")
    config, host = phm.attrs["Config"], phm.attrs["HostConfig"]
    assert config["User"] == "10001:10001"
    assert host["ReadonlyRootfs"] is True
    assert host["CapDrop"] == ["ALL"]
    assert any(option.startswith("no-new-privileges") for option in host["SecurityOpt"])
    assert host["RestartPolicy"]["Name"] == "unless-stopped"

    def healthy() -> bool:
        phm.reload()
        joined = f"{stack.project}_net" in phm.attrs["NetworkSettings"]["Networks"]
        return joined and bool(phm.attrs["State"]["Health"]["Status"] == "healthy")

    poll(healthy, "a healthy sidecar on the network")


KILL_DAEMON = """
import os
for pid in filter(str.isdigit, os.listdir('/proc')):
    try:
        with open(f'/proc/{pid}/cmdline', 'rb') as stream:
            command = stream.read()
    except OSError:  # it has ended: the health check starts programs, too
        continue
    if command.endswith(b'phm\\0run\\0') and pid != '1':
        os.kill(int(pid), 9)
"""


def test_a_killed_daemon_is_restarted_and_continues_its_log(stack: Stack, docker_client: DockerClient) -> None:
    """SIGKILL to PHM: the Docker Engine restarts it, and the log continues with a new boot."""
    phm = stack.agent.container("phm")
    record = Record(stack.record)

    def boots() -> set[str]:
        record.update()
        return {event["boot_id"] for event in record.events if event["event"] == "report"}

    before = boots()
    # The program itself is killed with its container, or ends first. The engine forgets it with the container, so that it may not
    # know its exit code any more, which is not asked for.
    api = docker_client.api
    assert not api.exec_start(api.exec_create(phm.id, ["python", "-c", KILL_DAEMON])["Id"])
    poll(lambda: bool(boots() - before), f"a report of a boot after {before}", 120.0)
    phm.reload()
    assert phm.attrs["RestartCount"] == 1
