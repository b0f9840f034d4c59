"""The ROS child loads foreign code and reads hostile samples: it can access only what its work requires."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pyseccomp
import pytest
from landlock import landlock_abi_version

from phm.core.settings import RosSettings
from phm.probes.ros import sandbox
from phm.probes.ros.child_environment import child_environ
from tests.fakes.ros_bench import ROOT, Bench, seen, stale, until

ALLOWED = {
    "send a datagram",
    "list the interfaces",
    "make a pair of streams",
    "read the application's packages",
    "signal itself",
    "set its own priority",
    "start a thread",
}
FILES = {
    "read a key",
    "list a folder of PHM",
    "write to a folder of PHM",
    "write to the application's packages",
    "read another process's environment",
}
"""What Landlock alone refuses."""
SIGNALS = {
    "signal another process",
    "signal a thread of another process",
    "signal a thread of another process by its id",
    "queue a signal",
    "queue a signal to a thread",
}
"""What Landlock of Linux 6.12 refuses, too. It lets a pipe have any owner, but sends it no signal."""
REFUSED_TEXT = "rclpy cannot be loaded here"
IPC_PRIVATE, IPC_RMID = 0, 0


@pytest.fixture
def victim() -> Iterator[subprocess.Popen[bytes]]:
    """Another process of the same user, alone in its group."""
    process = subprocess.Popen(["sleep", "600"], start_new_session=True)
    yield process
    process.kill()
    process.wait()


@pytest.fixture
def targets(tmp_path: Path, victim: subprocess.Popen[bytes]) -> Iterator[dict[str, object]]:
    """PHM's and the machine's: local sockets, port, key, state directory, another process and its shared memory; and the
    application's packages.
    """
    for name in ("state", "install"):
        (tmp_path / name).mkdir()
    (tmp_path / "install" / "node.py").touch()
    (tmp_path / "mavlink.key").write_text("00" * 32)
    system = ctypes.CDLL(None)
    memory = system.shmget(IPC_PRIVATE, 4096, 0o600)
    with (
        socket.socket(socket.AF_UNIX) as local,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as datagrams,
        socket.create_server(("127.0.0.1", 0)) as port,
    ):
        local.bind(str(tmp_path / "docker.sock"))
        local.listen()
        datagrams.bind(str(tmp_path / "notify.sock"))
        yield {
            "socket": str(tmp_path / "docker.sock"),
            "datagrams": str(tmp_path / "notify.sock"),
            "port": port.getsockname()[1],
            "key": str(tmp_path / "mavlink.key"),
            "folder": str(tmp_path / "state"),
            "install": str(tmp_path / "install"),
            "pid": victim.pid,
            "memory": memory,
        }
    system.shmctl(memory, IPC_RMID, None)


def reached(targets: dict[str, object], restriction: str = "", **environ: str) -> set[str]:
    """What foreign code can do in a process that has called `restriction` of the sandbox."""
    merged = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join((str(ROOT / "tests" / "fakes" / "intruder"), str(ROOT))),
        "PHM_ROS_TARGETS": json.dumps(targets),
        **environ,
    }
    script = f"import pyseccomp\nfrom phm.probes.ros import sandbox\n{restriction}\ntry: import rclpy\nexcept ImportError as error: print(error)"
    done = subprocess.run([sys.executable, "-c", script], env=merged, capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


@pytest.mark.one_distribution
def test_code_in_the_child_accesses_only_what_it_needs(
    bench: Bench, targets: dict[str, object], victim: subprocess.Popen[bytes]
) -> None:
    """No sockets of the Docker Engine and PHM, keys, state, other processes or programs; only its own work is possible."""
    environ = {
        "PYTHONPATH": os.pathsep.join((str(ROOT / "tests" / "fakes" / "intruder"), str(ROOT))),
        "PHM_ROS_TARGETS": json.dumps(targets),
        "PHM_SIGNING_SECRET": "secret",
    }
    probe = bench.probe(environ=environ, installs=[targets["install"]])
    report = until(lambda: REFUSED_TEXT in (said := stale(probe)) and said, "the intruder's report")
    assert set(json.loads(report.partition("; ")[2])) == ALLOWED
    assert probe.sandbox == ""
    assert victim.poll() is None


@pytest.mark.one_distribution
def test_the_same_code_accesses_everything_without_the_sandbox(
    targets: dict[str, object], victim: subprocess.Popen[bytes]
) -> None:
    """The refusals in the test above come from the sandbox, not from faulty attempts."""
    done = reached(targets, PHM_SIGNING_SECRET="secret")
    assert {"connect to a local socket", "connect to an engine by TCP", "start a program", "start a process"} <= done
    assert {"send a datagram to a local socket", "send a raw datagram to a local socket"} <= done
    assert {"find a secret in the environment", "change the mode of a key", "truncate a key"} <= done
    assert {"make another process the owner of a pipe", "slow another process by its niceness"} <= done
    assert {"slow another process's disk", "limit another process", "attach another process's shared memory"} <= done
    assert done >= FILES | SIGNALS | ALLOWED
    assert victim.wait() == -signal.SIGKILL


@pytest.mark.one_distribution
def test_without_landlock_only_files_are_accessible(
    targets: dict[str, object], victim: subprocess.Popen[bytes]
) -> None:
    """Seccomp alone protects sockets, other processes, modes of files, and files from truncation."""
    assert reached(targets, "sandbox._limit_calls(streams=False)") == ALLOWED | FILES
    assert victim.poll() is None


@pytest.mark.one_distribution
def test_landlock_is_a_second_barrier_before_other_processes(
    targets: dict[str, object], victim: subprocess.Popen[bytes]
) -> None:
    """Without seccomp, Landlock of Linux 6.12 or later refuses files and signals, those by a pipe, too."""
    with_scope = landlock_abi_version() >= 6
    readable = [sys.prefix, sys.base_prefix, str(ROOT), "/usr", "/lib", "/etc", targets["install"]]
    done = reached(targets, f"sandbox._limit_files({readable!r}, [])")
    assert not done & (FILES | SIGNALS if with_scope else FILES)
    assert victim.poll() is None or not with_scope


def test_libseccomp_knows_every_call_of_the_filter() -> None:
    """On x86-64 and arm64 each has a number or does not exist: a name that libseccomp does not know would be left out."""
    names = {*sandbox._FORBIDDEN, *sandbox._IN_MEMORY, *sandbox._SIGNALS, *sandbox._SETTINGS} - set(sandbox._NUMBERS)
    names |= {"socket", "socketpair", "open", "openat", "clone", *(name for name, _, _ in sandbox._COMMANDS)}
    unknown = -1
    for arch in (pyseccomp.Arch.X86_64, pyseccomp.Arch.AARCH64):
        assert [name for name in names if pyseccomp.resolve_syscall(arch, name) == unknown] == []


@pytest.mark.one_distribution
def test_every_forbidden_call_is_refused() -> None:
    """Whatever its arguments, and whether or not libseccomp knows its name."""
    script = (
        "import ctypes, errno, pyseccomp\n"
        "from phm.probes.ros import sandbox\n"
        "sandbox._limit_calls(streams=False)\n"
        "system = ctypes.CDLL(None, use_errno=True)\n"
        "for name in sandbox._FORBIDDEN:\n"
        "    number = sandbox._NUMBERS.get(name, pyseccomp.resolve_syscall(pyseccomp.Arch.NATIVE, name))\n"
        "    if number >= 0 and (system.syscall(number, *[ctypes.c_long(-1)] * 6), ctypes.get_errno()) != (-1, errno.EPERM):\n"
        "        print(name)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == ""


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
