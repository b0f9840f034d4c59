"""The daemon's side of the control socket (`phm.wire.control`): approvals, notes, holds and reloads from this machine.

One thread, few connections, small requests, short deadlines: a client that sends something else, or nothing, gets an error and is
disconnected. The socket belongs to PHM's user alone (mode 0600), and the kernel reports the user id of the client.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

from phm.commands.authorization import may_use_socket
from phm.commands.requests import OperatorRequest, Reply, parse
from phm.core import threads
from phm.wire.command import CommandResult
from phm.wire.control import DEADLINE_S, MAX_REQUEST, NAME, address

logger = logging.getLogger(__name__)

MAX_CONNECTIONS = 4
BACKLOG = 16
"""With a full backlog, the kernel refuses further clients."""
RETRY_S = 5.0
CLOSING_S = 2.0
TOO_LONG = f"a request has at most {MAX_REQUEST} bytes"
_POLL_S = 0.5
_CREDENTIALS = struct.Struct("3i")

Execute = Callable[[OperatorRequest, str], Reply]
"""Executes a request of an operator (`phm.commands.handler.CommandHandler.execute`). Never raises."""


def _not_ready(request: OperatorRequest, by: str) -> Reply:
    return Reply(CommandResult.TEMPORARILY_REJECTED, "PHM is starting")


class ControlServer:
    """Serves `run_dir/control.sock` until closed. Requests are executed one at a time."""

    def __init__(self, run_dir: str, execute: Execute = _not_ready) -> None:
        self._run_dir = run_dir
        self.execute = execute
        """Replaced when the configuration is reloaded."""
        self._connections: dict[socket.socket, tuple[bytearray, float]] = {}
        self._listener: socket.socket | None = None
        self._inode = 0
        self._started = False
        self._problem = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="phm-control", daemon=True)

    def start(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._waker, self._woken = socket.socketpair()
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._started = True
        threads.start(self._thread)

    def problem(self) -> str:
        return self._problem

    def close(self) -> None:
        """End the thread and remove the socket; waits at most CLOSING_S."""
        if not self._started:
            return
        self._stop.set()
        with contextlib.suppress(OSError):  # closed before
            self._waker.send(b"x")
        threads.join(self._thread, CLOSING_S)
        self._waker.close()
        path = os.path.join(self._run_dir, NAME)
        with contextlib.suppress(OSError):
            if os.stat(path).st_ino == self._inode:
                os.unlink(path)

    # ------------------------------------------------------------ the thread

    def _serve(self) -> None:
        while not self._stop.is_set() and not self._listen():
            self._stop.wait(RETRY_S)
        while not self._stop.is_set():
            try:
                self._turn()
            except Exception:  # whatever one client does, the next one is served
                logger.exception("serving the control socket failed")
                self._stop.wait(_POLL_S)
        for peer in list(self._connections):
            self._drop(peer)
        if self._listener is not None:
            self._listener.close()
        self._woken.close()
        self._selector.close()

    def _listen(self) -> bool:
        """Bind under another name, restrict its mode, and only then rename it: it is never open to other users."""
        name = f"{NAME}.{os.getpid()}"
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        try:
            os.makedirs(self._run_dir, exist_ok=True)
            with address(self._run_dir, name) as path:
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(path)
                listener.bind(path)
                os.chmod(path, 0o600)
                listener.listen(BACKLOG)
                self._inode = os.stat(path).st_ino
                os.replace(path, os.path.join(os.path.dirname(path), NAME))
        except OSError as error:
            listener.close()
            self._problem = f"cannot create {os.path.join(self._run_dir, NAME)}: {error.strerror or error}; `phm approve` does not work"
            return False
        self._listener, self._problem = listener, ""
        self._selector.register(listener, selectors.EVENT_READ)
        return True

    def _turn(self) -> None:
        for ready, _events in self._selector.select(_POLL_S):
            peer = ready.fileobj
            assert isinstance(peer, socket.socket)
            if peer is self._listener:
                self._accept(peer)
            elif peer in self._connections:
                self._receive(peer)
        now = time.monotonic()
        for peer in [peer for peer, (_data, end) in self._connections.items() if now >= end]:
            self._refuse(peer, f"no complete request within {DEADLINE_S:g} s")

    def _accept(self, listener: socket.socket) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            peer, _address = listener.accept()
            peer.setblocking(False)
            self._connections[peer] = (bytearray(), time.monotonic() + DEADLINE_S)
            self._selector.register(peer, selectors.EVENT_READ)
            if len(self._connections) > MAX_CONNECTIONS:
                self._refuse(peer, f"at most {MAX_CONNECTIONS} connections at a time")
            elif not may_use_socket(_user(peer), os.geteuid()):
                self._refuse(peer, "only root and PHM's own user may use the control socket")

    def _receive(self, peer: socket.socket) -> None:
        data, _end = self._connections[peer]
        try:
            chunk = peer.recv(MAX_REQUEST)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        if not chunk:
            self._drop(peer)
            return
        data += chunk
        while b"\n" in data and peer in self._connections:
            line, _newline, rest = bytes(data).partition(b"\n")
            data[:] = rest
            self._connections[peer] = (data, time.monotonic() + DEADLINE_S)
            if len(line) < MAX_REQUEST:
                self._answer(peer, line)
            else:
                self._refuse(peer, TOO_LONG)
        if peer in self._connections and len(data) >= MAX_REQUEST:
            self._refuse(peer, TOO_LONG)

    def _answer(self, peer: socket.socket, line: bytes) -> None:
        try:
            request = parse(json.loads(line))
        except (ValueError, RecursionError):
            self._refuse(peer, "not a request: write one JSON object a line, with `do`")
            return
        reply = self.execute(request, f"operator (uid {_user(peer)})")
        self._send(
            peer, {"ok": True, "text": reply.text, **reply.data} if reply.ok else {"ok": False, "error": reply.text}
        )

    def _refuse(self, peer: socket.socket, reason: str) -> None:
        self._send(peer, {"ok": False, "error": reason})
        self._drop(peer)

    def _send(self, peer: socket.socket, answer: dict[str, Any]) -> None:
        data = json.dumps(answer).encode("ascii") + b"\n"
        try:
            complete = peer.send(data) == len(data)
        except OSError:
            complete = False
        if not complete:  # a client that does not read its answers
            self._drop(peer)

    def _drop(self, peer: socket.socket) -> None:
        if self._connections.pop(peer, None) is not None:
            self._selector.unregister(peer)
            peer.close()


def _user(peer: socket.socket) -> int:
    """The user id at the other end, from the kernel."""
    credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _pid, uid, _gid = _CREDENTIALS.unpack(credentials)
    return int(uid)
