"""The daemon's side of the control socket (`phm.wire.control`): approvals, notes, holds and reloads from this machine.

One thread with an event loop (`phm.core.stream_server`), few connections, small requests, short deadlines: a client that sends
something else, or nothing, gets an error and is disconnected. The socket belongs to PHM's user alone (mode 0600), and the kernel
reports the user id of the client.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import struct
import threading
from collections.abc import Callable
from typing import Any

from phm.commands.authorization import may_use_socket
from phm.commands.requests import OperatorRequest, Reply, parse
from phm.core import threads
from phm.core.stream_server import run, serving
from phm.wire.command import CommandResult
from phm.wire.control import DEADLINE_S, MAX_REQUEST, NAME, address

MAX_CONNECTIONS = 4
BACKLOG = 16
"""With a full backlog, the kernel refuses further clients."""
RETRY_S = 5.0
CLOSING_S = 2.0
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
        self._connections = self._inode = 0
        self._problem = ""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing, self._closed = threading.Event(), asyncio.Event()
        self._thread = threading.Thread(target=lambda: run(self._serve()), name="phm-control", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def problem(self) -> str:
        return self._problem

    def close(self) -> None:
        """End the thread and remove the socket; waits at most CLOSING_S."""
        self._closing.set()
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # ended before
                self._loop.call_soon_threadsafe(self._closed.set)
        threads.join(self._thread, CLOSING_S)
        path = os.path.join(self._run_dir, NAME)
        with contextlib.suppress(OSError):
            if os.stat(path).st_ino == self._inode:
                os.unlink(path)

    # ------------------------------------------------------------ the thread

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        while (listener := self._listen()) is None and not self._closing.is_set():
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._closed.wait(), RETRY_S)
        if listener is None:
            return
        async with serving(listener, self._converse, MAX_REQUEST - 1):
            if not self._closing.is_set():  # `close` may have been called before there was a loop
                await self._closed.wait()

    def _listen(self) -> socket.socket | None:
        """Bind under another name, restrict its mode, and only then rename it: it is never open to other users."""
        name = f"{NAME}.{os.getpid()}"
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
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
            return None
        self._problem = ""
        return listener

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections += 1
        try:
            await self._answer(reader, writer)
        finally:
            self._connections -= 1

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one request after the other, until the client ends, is refused, or does not read its answers."""
        uid = _user(writer.get_extra_info("socket"))
        if self._connections > MAX_CONNECTIONS:
            _send(writer, _error(f"at most {MAX_CONNECTIONS} connections at a time"))
            return
        if not may_use_socket(uid, os.geteuid()):
            _send(writer, _error("only root and PHM's own user may use the control socket"))
            return
        try:
            while (line := await asyncio.wait_for(reader.readline(), DEADLINE_S)).endswith(b"\n"):
                reply = self.execute(_request(line), f"operator (uid {uid})")
                answer = {"ok": True, "text": reply.text, **reply.data} if reply.ok else _error(reply.text)
                if not _send(writer, answer):
                    return
        except asyncio.TimeoutError:
            _send(writer, _error(f"no complete request within {DEADLINE_S:g} s"))
        except _NotARequest as error:
            _send(writer, _error(str(error)))
        except ValueError:  # of readline
            _send(writer, _error(f"a request has at most {MAX_REQUEST} bytes"))


class _NotARequest(Exception):
    """The message says what a request is."""


def _request(line: bytes) -> OperatorRequest:
    try:
        return parse(json.loads(line))
    except (ValueError, RecursionError):
        raise _NotARequest("not a request: write one JSON object a line, with `do`") from None


def _error(reason: str) -> dict[str, Any]:
    return {"ok": False, "error": reason}


def _send(writer: asyncio.StreamWriter, answer: dict[str, Any]) -> bool:
    """Whether the client took all of it: one that does not read its answers is disconnected."""
    writer.write(json.dumps(answer).encode("ascii") + b"\n")
    return writer.transport.get_write_buffer_size() == 0


def _user(peer: socket.socket) -> int:
    """The user id at the other end, from the kernel."""
    credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _pid, uid, _gid = _CREDENTIALS.unpack(credentials)
    return int(uid)
