"""The clients of the control socket: few connections, small requests, short deadlines.

A client that sends something else, or nothing, gets an error and is disconnected. The kernel reports the user id of each.
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
from phm.core.stream_server import run, serving
from phm.wire.control import DEADLINE_S, MAX_REQUEST

MAX_CONNECTIONS = 4
_CREDENTIALS = struct.Struct("3i")


class ControlClients:
    """Serves clients in the calling thread. execute: executes a request of an operator; never raises."""

    def __init__(self, execute: Callable[[OperatorRequest, str], Reply]) -> None:
        self._execute = execute
        self._connections = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closed = asyncio.Event()

    def serve(self, listener: socket.socket, closing: threading.Event) -> None:
        """Until `close`; returns immediately if `closing` is set by now."""
        run(self._serve(listener, closing))

    def close(self) -> None:
        """End `serve`, from any thread."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # ended before
                self._loop.call_soon_threadsafe(self._closed.set)

    async def _serve(self, listener: socket.socket, closing: threading.Event) -> None:
        self._loop = asyncio.get_running_loop()
        async with serving(listener, self._converse, MAX_REQUEST - 1):
            if not closing.is_set():  # it may have been set before there was a loop
                await self._closed.wait()

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
                reply = self._execute(_request(line), f"operator (uid {uid})")
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
