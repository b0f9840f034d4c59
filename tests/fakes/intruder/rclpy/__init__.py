"""Foreign code in the ROS child that tries what the sandbox should prevent, and reports successes by a failed import.

PHM_ROS_TARGETS: JSON with the paths `socket`, `key`, `folder` and `install`, the process id `pid` and the TCP port `port`.
"""

import ctypes
import json
import os
import pathlib
import signal
import socket
import subprocess
from collections.abc import Callable
from typing import Any

TARGETS = json.loads(os.environ["PHM_ROS_TARGETS"])
PTRACE_ATTACH = 16


def connect(family: int, kind: int, address: Any) -> None:
    with socket.socket(family, kind) as made:
        made.connect(address)


def ptrace() -> None:
    if ctypes.CDLL(None, use_errno=True).ptrace(PTRACE_ATTACH, TARGETS["pid"], None, None) != 0:
        raise PermissionError(ctypes.get_errno(), "ptrace")


ATTEMPTS: dict[str, Callable[[], Any]] = {
    "connect to a local socket": lambda: connect(socket.AF_UNIX, socket.SOCK_STREAM, TARGETS["socket"]),
    "connect to an engine by TCP": lambda: connect(socket.AF_INET, socket.SOCK_STREAM, ("127.0.0.1", TARGETS["port"])),
    "read a key": lambda: pathlib.Path(TARGETS["key"]).read_bytes(),
    "list a folder of PHM": lambda: os.listdir(TARGETS["folder"]),
    "write to a folder of PHM": lambda: pathlib.Path(TARGETS["folder"], "new").write_bytes(b"x"),
    "write to the application's packages": lambda: pathlib.Path(TARGETS["install"], "new").write_bytes(b"x"),
    "read another process's environment": lambda: pathlib.Path(f"/proc/{TARGETS['pid']}/environ").read_bytes(),
    "signal another process": lambda: os.kill(TARGETS["pid"], signal.SIGCONT),
    "signal all processes": lambda: os.kill(-1, 0),
    "trace another process": ptrace,
    "take hold of another process": lambda: os.pidfd_open(TARGETS["pid"]),
    "slow another process": lambda: os.sched_setaffinity(TARGETS["pid"], {0}),
    "start a program": lambda: subprocess.run(["true"], check=False),
    "find a secret in the environment": lambda: os.environ["PHM_SIGNING_SECRET"],
    "send a datagram": lambda: connect(socket.AF_INET, socket.SOCK_DGRAM, ("127.0.0.1", 9)),
    "read the application's packages": lambda: os.listdir(TARGETS["install"]),
    "signal itself": lambda: os.kill(os.getpid(), 0),
}


def succeeded() -> list[str]:
    done = []
    for name, attempt in ATTEMPTS.items():
        try:
            attempt()
        except (OSError, KeyError):
            continue
        done.append(name)
    return done


raise ImportError(json.dumps(succeeded()), name="rclpy.intruder")
