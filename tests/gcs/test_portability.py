"""`phm gcs`, `phm validate`, `phm faults` and `phm report` import and run without what Windows or macOS lack."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import phm
from tests.fakes.until import LIMIT_S

ROOT = Path(phm.__file__).parents[1]

WITHOUT = '''
"""Takes from this Linux what another platform lacks. Libraries of others are imported before: they have their own branches."""
import asyncio, importlib.abc, os, queue, select, selectors, signal, socket, sys, types
import click, docker, psutil, pydantic, pymavlink.dialects.v20.ardupilotmega, rich.live, rich.table, serial, urllib3.connection, yaml
import jinja2, msgspec
import concurrent.futures.process, importlib.metadata, multiprocessing.connection, pathlib, subprocess, sysconfig, tempfile, zoneinfo
from pydantic import BaseModel, BeforeValidator, Field, ValidationError, field_validator
sysconfig.get_config_vars()
import landlock, pyseccomp

PLATFORM = sys.argv[1]
MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty"}
LACKS = {
    "darwin": {
        os: ["O_PATH", "eventfd", "eventfd_read", "eventfd_write", "fdatasync", "pipe2", "sched_getaffinity"],
        select: ["epoll"],
        socket: ["TCP_USER_TIMEOUT", "SOCK_NONBLOCK", "SOCK_CLOEXEC"],
    },
    "win32": {
        os: [
            "EX_SOFTWARE", "O_CLOEXEC", "O_DIRECTORY", "O_NOCTTY", "O_NOFOLLOW", "O_NONBLOCK", "O_PATH", "eventfd", "eventfd_read",
            "eventfd_write", "fdatasync", "fork", "getegid", "geteuid", "getgid", "getloadavg", "getpgrp", "getuid", "killpg",
            "mkfifo", "openpty", "pipe2", "pread", "sched_getaffinity", "setpriority", "setsid", "statvfs", "sysconf", "tcgetpgrp",
        ],
        select: ["epoll", "poll"],
        signal: [
            "SIGALRM", "SIGCHLD", "SIGCONT", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT", "SIGSTOP", "SIGTSTP", "SIGUSR1", "SIGUSR2",
            "pthread_sigmask", "setitimer", "sigwait",
        ],
        socket: ["TCP_USER_TIMEOUT", "SOCK_NONBLOCK", "SOCK_CLOEXEC", "SO_PEERCRED"],
    },
}


class Missing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in MODULES:
            raise ModuleNotFoundError(f"{PLATFORM} has no module {name}", name=name)


if PLATFORM == "win32":
    for name in MODULES:
        sys.modules.pop(name, None)
    sys.meta_path.insert(0, Missing())
    selectors.DefaultSelector = selectors.SelectSelector
    keys = queue.SimpleQueue()
    import ssl

    ssl.enum_certificates = lambda store: []  # there since Python has an ssl module; aiohttp asks for it
    msvcrt = sys.modules["msvcrt"] = types.ModuleType("msvcrt")
    msvcrt.kbhit, msvcrt.getwch = lambda: not keys.empty(), keys.get_nowait
for module, names in LACKS[PLATFORM].items():
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
sys.platform = PLATFORM
'''

GROUND = '''
import contextlib, io, json, threading
from phm.cli import gcs_requests, group
from phm.gcs import operator
from phm.transport.dialect import mavlink

# On a busy machine an answer takes a while.
gcs_requests.FOUND_S, operator.RESEND_S = 60.0, 15.0


def run(*arguments):
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        try:
            code = group.main([*arguments], prog_name="phm", standalone_mode=False)
        except SystemExit as error:
            code = error.code
    return code or 0, output.getvalue()


folder, stop, codec = sys.argv[2], threading.Event(), mavlink.MAVLink(None, srcSystem=7, srcComponent=193)
listener = socket.create_server(("127.0.0.1", 0))
udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
udp.bind(("127.0.0.1", 0))
port = udp.getsockname()[1]
udp.close()


def agent():
    """Agent 7 by UDP and agent 8 by TCP; 7 answers commands."""
    sock, peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), None
    sock.setblocking(False)
    listener.setblocking(False)
    other = mavlink.MAVLink(None, srcSystem=8, srcComponent=193)
    while not stop.wait(0.1):
        with contextlib.suppress(OSError):
            peer = listener.accept()[0]
        beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0x40015555, 4, 3)
        sock.sendto(beat.pack(codec), ("127.0.0.1", port))
        with contextlib.suppress(OSError, AttributeError):
            peer.sendall(beat.pack(other))
        with contextlib.suppress(OSError):
            while True:
                for message in mavlink.MAVLink(None).parse_buffer(sock.recv(4096)) or []:
                    if message.get_type() == "COMMAND_LONG":
                        ack = mavlink.MAVLink_command_ack_message(
                            message.command, 0, 0, 0, message.get_srcSystem(), message.get_srcComponent()
                        )
                        sock.sendto(ack.pack(codec), ("127.0.0.1", port))


thread = threading.Thread(target=agent, daemon=True)
thread.start()
urls = f"udpin:127.0.0.1:{port}", f"tcp:127.0.0.1:{listener.getsockname()[1]}"
record = os.path.join(folder, "flight.jsonl")
for _ in range(10):  # on a busy machine the agents may not have run in these seconds
    with contextlib.suppress(FileNotFoundError):
        os.remove(record)
    code, output = run("gcs", *urls, "--once", "--for", "3", "--json", "--record", record, "--serve", "0")
    snapshot = json.loads(output)
    found = {"gcs": code, "agents": {one["name"]: one["how"] for one in snapshot["agents"]}}
    if list(found["agents"].values()) == ["OK", "OK"]:
        break
code, output = run("gcs", "check", "A07", "--url", urls[0], "--for", "0")
found["check"] = [code, output]
stop.set()
thread.join()
found["validate"] = run("validate", "-c", sys.argv[3])[0]
with open(os.path.join(folder, "phm.jsonl"), "w") as stream:
    stream.write("{}\\n")
found["faults"] = run("faults", "--log-dir", folder, "--run-dir", folder, "--json")[0]
page = os.path.join(folder, "flight.html")
code, output = run("report", record, "--html", page, "--json")
found["report"] = [code, sorted(one["agent"] for one in json.loads(output)["agents"]) if code == 0 else output, os.path.exists(page)]
if PLATFORM == "win32":
    from phm.core.clock import SystemClock
    from phm.gcs.keyboard import Keyboard

    sys.stdin = types.SimpleNamespace(isatty=lambda: True)
    for key in "\\xe0Hq":
        keys.put(key)
    with Keyboard(SystemClock(), threading.Event()) as keyboard:
        found["keys"] = keyboard.read(60.0)
from phm.wire import json_log
found["recorded"] = [event["event"] for event in json_log.read(record)][-1]
print(json.dumps(found))
'''


@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_the_ground_part_runs_without_what_the_platform_lacks(platform: str, tmp_path: Path) -> None:
    """Agents by UDP and TCP, a request, a record, keys; a configuration is validated, a log is read, and the record is reported."""
    config = str(ROOT / "config" / "phm.yaml")
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT + GROUND, platform, str(tmp_path), config],
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "checks")))},
        capture_output=True,
        text=True,
        timeout=8 * LIMIT_S,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found.pop("keys", ["up", "q"]) == ["up", "q"]
    assert found == {
        "gcs": 0,
        "agents": {"A07": "OK", "A08": "OK"},
        "check": [0, "A07 run all checks: accepted\n"],
        "validate": 0,
        "faults": 0,
        "report": [0, ["A07", "A08"], True],
        "recorded": "snapshot",
    }
