"""The control socket: its requests, for two users, and robust against any input."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import socket
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.commands.control_clients import MAX_CONNECTIONS
from phm.commands.control_server import ControlServer
from phm.commands.services import NO_HOLDS, HoldController
from phm.wire import control as wire
from tests.fakes.commands import execute
from tests.fakes.until import until


class Daemon:
    """A control socket with the requests it received."""

    def __init__(self, run_dir: Path, holds: HoldController | None = None) -> None:
        self.run_dir = run_dir
        self.notes: list[tuple[str, str]] = []
        self.reload: Callable[[], str] = str
        self.control = ControlServer(
            str(run_dir),
            execute(
                approve=self.approve,
                note=lambda kind, text: self.notes.append((kind, text)),
                holds=holds or NO_HOLDS,
                reload=lambda: self.reload(),
            ),
        )
        self.control.start()
        until(lambda: (run_dir / wire.NAME).exists(), "the socket")

    def approve(self, fault: str) -> str:
        if fault == "ab12-1":
            return "approved: restart app"
        raise LookupError(f"there is no open fault {fault}; open: ab12-1 (health/app)")

    def connect(self) -> socket.socket:
        stream = socket.socket(socket.AF_UNIX)  # blocking: with a full backlog it waits for its turn
        with wire.address(str(self.run_dir)) as path:
            stream.connect(path)
        stream.settimeout(60)
        return stream

    def ping(self) -> str:
        return wire.ask(str(self.run_dir), {"do": "ping"})

    def serves(self) -> bool:
        try:
            return self.ping() == "PHM is running"
        except (wire.NoAnswer, wire.Refused):
            return False

    def phm(self, *words: str) -> tuple[int, str]:
        result = CliRunner().invoke(group, [*words, "--run-dir", str(self.run_dir)])
        return result.exit_code, result.output


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    made = Daemon(tmp_path / ("a-long-name-" * 10))
    yield made
    made.control.close()


def test_the_socket_is_private_and_removed_at_the_end(daemon: Daemon) -> None:
    """Mode 0600, no other name beside it; a leftover socket is replaced."""
    path = daemon.run_dir / wire.NAME
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert [entry.name for entry in daemon.run_dir.iterdir()] == [wire.NAME]
    first = path.stat().st_ino
    second = Daemon(daemon.run_dir)
    until(lambda: path.stat().st_ino != first, "the new socket")
    until(second.serves, "the second server to answer")
    daemon.control.close()
    assert path.exists(), "the socket of another daemon was removed"
    second.control.close()
    assert not path.exists()


def test_the_verbs_send_requests_and_print_the_response(daemon: Daemon) -> None:
    """`phm approve` and `phm note`: exit code 0 with the planned action, 1 with a reason."""
    assert daemon.phm("approve", "ab12-1") == (0, "approved: restart app\n")
    code, said = daemon.phm("approve", "zz")
    assert (code, "open: ab12-1" in said) == (1, True)
    assert daemon.phm("note", "node\x1b[2J killed") == (0, "noted: node\\x1b[2J killed\n")
    assert daemon.notes == [("NOTE", "node\\x1b[2J killed")]


def test_without_a_daemon_the_verbs_say_so(tmp_path: Path, daemon: Daemon) -> None:
    """No directory, no socket, and a socket without a server: one sentence, exit code 1."""
    for run_dir in (tmp_path / "none", tmp_path):
        result = CliRunner().invoke(group, ["approve", "x", "--run-dir", str(run_dir)])
        assert (result.exit_code, "PHM is not running" in result.output) == (1, True)
    dead = socket.socket(socket.AF_UNIX)
    with wire.address(str(tmp_path)) as path:
        dead.bind(path)
    dead.close()
    result = CliRunner().invoke(group, ["approve", "x", "--run-dir", str(tmp_path)])
    assert (result.exit_code, "PHM does not answer" in result.output) == (1, True)


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"\xff\xfe",
        b"[]",
        b"3",
        b"[" * 4000,
        b'{"do": "run"}',
        b'{"do": "ping", "more": 1}',
        b'{"do": "approve"}',
        b'{"do": "approve", "fault": 3}',
        b'{"do": "approve", "fault": {"a": 1}}',
        b'{"do": "note", "kind": "DOCKER", "text": "forged"}',
        b'{"do": "note", "text": null}',
        b"x" * 10_000,
    ],
)
def test_an_invalid_request_gets_an_error_and_is_closed(daemon: Daemon, line: bytes) -> None:
    """One error, the connection closed, and the next one is served."""
    with daemon.connect() as stream:
        data = b""
        try:
            stream.sendall(line + b"\n")
            while chunk := stream.recv(4096):
                data += chunk
        except ConnectionError:
            pass  # closed before it read everything
    assert not data or json.loads(data)["ok"] is False
    assert daemon.notes == []
    until(daemon.serves, "the server to answer")


def test_random_bytes_never_end_the_server(daemon: Daemon) -> None:
    """Truncated, mixed and endless requests: it keeps responding."""
    chance = random.Random(3)
    for _ in range(100):
        with daemon.connect() as stream:
            pieces = [
                b'{"do":',
                b'"ping"}',
                b"\n",
                b"\x00",
                chance.randbytes(chance.randrange(2000)),
                b'{"do":"ping"}\n',
            ]
            try:
                for piece in chance.choices(pieces, k=chance.randrange(8)):
                    stream.sendall(piece)
            except OSError:
                continue  # the server closed early
    until(daemon.serves, "the server to answer")


def test_the_number_of_connections_is_limited(daemon: Daemon) -> None:
    """A connection above the limit gets an error; when one is closed, the next is served."""
    held = [daemon.connect() for _ in range(MAX_CONNECTIONS)]
    for stream in held:
        stream.sendall(b'{"do": "ping"}\n')
        assert json.loads(stream.recv(4096))["ok"] is True
    with daemon.connect() as more:
        assert "at most" in json.loads(more.recv(4096))["error"]
    for stream in held:
        stream.close()
    until(daemon.serves, "the server to answer")


def test_a_client_that_has_just_connected_sees_the_end(daemon: Daemon) -> None:
    """The server closes each connection when it ends, also one that it has not begun to serve."""
    with daemon.connect() as stream:
        daemon.control.close()
        with contextlib.suppress(ConnectionError):
            assert stream.recv(1) == b""


def test_only_root_and_the_own_user_are_accepted(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel identifies the user of the peer."""
    monkeypatch.setattr("phm.commands.control_clients._user", lambda peer: os.geteuid() + 12345)
    with pytest.raises(wire.Refused, match="only root"):
        daemon.ping()


def test_clients_that_cannot_be_served_now_are_served_later(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    """What serves them is loaded for the first one, which fails without memory or a free descriptor: a problem, not the end."""
    monkeypatch.setattr("phm.commands.control_server.RETRY_S", 0.02)
    with monkeypatch.context() as broken:
        broken.setitem(sys.modules, "phm.commands.control_clients", None)
        stream = daemon.connect()
        until(daemon.control.problem, "the problem")
    with stream:
        stream.sendall(b'{"do": "ping"}\n')
        assert json.loads(stream.recv(4096))["ok"] is True
    assert daemon.control.problem() == ""


def test_a_run_directory_that_cannot_be_created_is_a_problem(tmp_path: Path) -> None:
    """`phm status` shows it; everything else works."""
    (tmp_path / "file").write_text("")
    control = ControlServer(str(tmp_path / "file" / "run"))
    control.start()
    until(control.problem, "the problem")
    assert "`phm approve` does not work" in control.problem()
    control.close()


def test_without_a_free_descriptor_the_socket_is_created_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread does not end: `phm approve` works as soon as there is one."""
    monkeypatch.setattr("phm.commands.control_server.RETRY_S", 0.02)
    control = ControlServer(str(tmp_path / "run"))
    with monkeypatch.context() as exhausted:
        exhausted.setattr("phm.commands.control_server.socket.socket", _no_descriptor)
        control.start()
        until(control.problem, "the problem")
    until((tmp_path / "run" / wire.NAME).exists, "the socket")
    until(lambda: control.problem() == "", "the end of the problem")
    control.close()


def _no_descriptor(*options: object) -> NoReturn:
    raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
