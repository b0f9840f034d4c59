"""The ROS child loads foreign code and reads hostile samples: it can access only what its work requires."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.core.settings import RosSettings
from phm.probes.ros import sandbox
from phm.probes.ros.child_environment import child_environ
from tests.fakes.ros_bench import ROOT, Bench, seen, stale, until

ALLOWED = {"send a datagram", "read the application's packages", "signal itself"}
REFUSED_TEXT = "rclpy cannot be loaded here"


@pytest.fixture
def targets(tmp_path: Path) -> Iterator[dict[str, object]]:
    """PHM's and the machine's: local socket, port, key, state directory, another process; and the application's
    packages.
    """
    for name in ("state", "install"):
        (tmp_path / name).mkdir()
    (tmp_path / "mavlink.key").write_text("00" * 32)
    local = socket.socket(socket.AF_UNIX)
    local.bind(str(tmp_path / "docker.sock"))
    local.listen()
    port = socket.create_server(("127.0.0.1", 0))
    other = subprocess.Popen(["sleep", "600"])
    yield {
        "socket": str(tmp_path / "docker.sock"),
        "port": port.getsockname()[1],
        "key": str(tmp_path / "mavlink.key"),
        "folder": str(tmp_path / "state"),
        "install": str(tmp_path / "install"),
        "pid": other.pid,
    }
    other.kill()
    other.wait()
    local.close()
    port.close()


def test_code_in_the_child_accesses_only_what_it_needs(bench: Bench, targets: dict[str, object]) -> None:
    """No sockets of the Docker Engine and PHM, keys, state, other processes or programs; only its own work is possible."""
    environ = {
        "PYTHONPATH": os.pathsep.join((str(ROOT / "tests" / "fakes" / "intruder"), str(ROOT))),
        "PHM_ROS_TARGETS": json.dumps(targets),
        "PHM_SIGNING_SECRET": "secret",
    }
    probe = bench.probe(environ=environ, installs=[targets["install"]])
    until(lambda: REFUSED_TEXT in stale(probe), "the intruder's report")
    assert set(json.loads(stale(probe).partition("; ")[2])) == ALLOWED
    assert probe.sandbox == ""


def test_the_same_code_accesses_everything_without_the_sandbox(targets: dict[str, object]) -> None:
    """The refusals in the test above come from the sandbox, not from faulty attempts."""
    environ = {
        **os.environ,
        "PYTHONPATH": str(ROOT / "tests" / "fakes" / "intruder"),
        "PHM_ROS_TARGETS": json.dumps(targets),
        "PHM_SIGNING_SECRET": "secret",
    }
    script = "try: import rclpy\nexcept ImportError as error: print(error)"
    done = subprocess.run([sys.executable, "-c", script], env=environ, capture_output=True, text=True, check=True)
    reached = set(json.loads(done.stdout))
    assert {"connect to a local socket", "connect to an engine by TCP", "read a key", "start a program"} <= reached
    assert {"write to a folder of PHM", "find a secret in the environment", "signal another process"} <= reached


def test_the_real_child_is_restricted_and_still_works(bench: Bench) -> None:
    """With real rclpy: nodes and rates are seen, nothing is missing, and the kernel reports an active filter."""
    bench.node("node_1", "--publish", "topic_1:20")
    probe = bench.probe([{"name": "/agent_1/topic_1", "rate": "20Hz"}])
    seen(probe, lambda fact: "/agent_1/node_1" in fact.nodes, "the node")
    seen(probe, lambda fact: (rate := fact.topics["/agent_1/topic_1"].rate) and rate.hz, "the rate")
    status = Path(f"/proc/{probe.pid}/status").read_text(encoding="utf-8")
    assert "Seccomp:\t2" in status
    assert "NoNewPrivs:\t1" in status
    assert probe.sandbox == ""


def test_missing_kernel_features_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel without Landlock or seccomp is reported with the respective reason, and the child continues."""

    def no_landlock(readable: list[str], writable: list[str]) -> None:
        raise OSError(38, "Function not implemented")

    def no_seccomp(*, streams: bool) -> None:
        raise RuntimeError("Unable to find libseccomp")

    monkeypatch.setattr(sandbox, "_limit_files", no_landlock)
    monkeypatch.setattr(sandbox, "_limit_calls", no_seccomp)
    missing = sandbox.enter(environ=lambda name: None)
    assert missing == (
        "sockets and processes: no seccomp (Unable to find libseccomp); files: no Landlock (Function not implemented)"
    )


UDP_ENVIRONMENT = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "PHM_ROS_PROFILE": "/tmp/phm.xml"}


@pytest.mark.parametrize(
    ("variables", "streams"),
    [
        ({"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}, False),
        ({**UDP_ENVIRONMENT, "FASTDDS_DEFAULT_PROFILES_FILE": "/tmp/phm.xml"}, False),
        ({**UDP_ENVIRONMENT, "FASTDDS_DEFAULT_PROFILES_FILE": "/etc/phm/own.xml"}, True),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "FASTDDS_DEFAULT_PROFILES_FILE": "/etc/phm/own.xml"}, True),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"}, True),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}, True),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, False),
    ],
)
def test_tcp_is_open_only_to_a_middleware_that_uses_it(variables: dict[str, str], streams: bool) -> None:
    """A Docker Engine behind a TCP port is unreachable unless the user's choice of transport needs TCP."""
    assert sandbox._needs_streams(variables.get) is streams


def test_the_daemons_environment_is_not_passed_on() -> None:
    """The child gets the variables that ROS and Python read, and no others."""
    environ = {"ROS_DOMAIN_ID": "3", "LD_LIBRARY_PATH": "/opt/ros/lib", "MAVLINK_KEY": "secret", "AWS_TOKEN": "secret"}
    passed = child_environ(RosSettings(), environ)
    assert passed["ROS_DOMAIN_ID"] == "3"
    assert passed["LD_LIBRARY_PATH"] == "/opt/ros/lib"
    assert "secret" not in passed.values()
