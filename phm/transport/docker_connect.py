"""Connections to a Docker Engine: a unix socket, TCP, or through ssh. Each belongs to a call with a deadline."""

from __future__ import annotations

import contextlib
import re
import select
import socket
import subprocess
import threading
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from phm.core import threads
from phm.transport.call_deadlines import PendingCall
from phm.transport.dns import Resolver

SSH = ("ssh", "-T", "-o", "BatchMode=yes", "-o", "ConnectTimeout=10", "-o", "ServerAliveInterval=5")
"""A password cannot be asked for; a connection that is silent for 15 s ends."""
_SSH_NAME = re.compile(r"[A-Za-z0-9_.:][A-Za-z0-9_.:-]*")
_current = threading.local()


class EngineSocket(socket.socket):
    """A socket that shows whether its reader waits for more data."""

    waiting = False
    """Whether all data received before has been processed: it was read, and its reader waits for more."""

    def recv_into(self, buffer: Any, nbytes: int = 0, flags: int = 0) -> int:
        """Look before reading: received data stay unread on the socket until `waiting` is False."""
        self.waiting = True
        try:
            self.recv(1, socket.MSG_PEEK)
        finally:
            self.waiting = False
        return super().recv_into(buffer, nbytes, flags)

    def unread(self) -> bool:
        """Whether received data have not been read yet, or the other end has closed."""
        poll = select.poll()
        try:
            poll.register(self, select.POLLIN)
        except ValueError:
            return False  # closed here
        return bool(poll.poll(0))


@contextlib.contextmanager
def using(call: PendingCall) -> Iterator[None]:
    """Connections opened by this thread meanwhile belong to `call`."""
    _current.call = call
    try:
        yield
    finally:
        _current.call = None


def connect(url: str, resolver: Resolver | None, timeout_s: float) -> socket.socket:
    """A connection to the engine at `url`, part of this thread's current call, which also records why it failed. Raises OSError.

    timeout_s: of connecting, and afterwards of each read. resolver: as of `resolver_for`.
    """
    call: PendingCall | None = getattr(_current, "call", None)
    try:
        if url.startswith("ssh://"):
            return _through_ssh(ssh_command(url), timeout_s, call)
        family, address = socket.AF_UNIX, url.removeprefix("unix://")
        if resolver is not None:
            resolver.ask().wait(timeout_s)
            return _open(*resolver.answer(), timeout_s, call)
        return _open(family, address, timeout_s, call)
    except OSError as error:
        if call is not None:
            call.failure = error
        raise


def resolver_for(url: str) -> Resolver | None:
    """The resolver for the engine's host, shared by all clients; None for a unix socket, and for ssh, which resolves it."""
    parts = urlsplit(url)
    return Resolver(parts.hostname or "", parts.port or 2375, socket.SOCK_STREAM) if parts.scheme == "tcp" else None


def ssh_command(url: str) -> tuple[str, ...]:
    """How the engine of ``ssh://[user@]host[:port]`` is reached. Raises ValueError for another form."""
    parts = urlsplit(url)
    for name, word in (("host", parts.hostname or ""), ("user", parts.username or "root")):
        if not _SSH_NAME.fullmatch(word):
            raise ValueError(f"{word!r} is not a {name}")
    if parts.password or parts.path.strip("/") or parts.query or parts.fragment:
        raise ValueError("there is more than ssh://[user@]host[:port]")
    options = [("-l", parts.username), ("-p", parts.port and str(parts.port))]
    given = [word for option, value in options if value for word in (option, str(value))]
    return (*SSH, *given, "--", str(parts.hostname), "docker", "system", "dial-stdio")


def _open(family: int, address: Any, timeout_s: float, call: PendingCall | None) -> socket.socket:
    sock = EngineSocket(family, socket.SOCK_STREAM)
    sock.settimeout(timeout_s)
    if call is not None:
        call.attach(sock)
    try:
        sock.connect(address)
    except BaseException:
        sock.close()
        raise
    return sock


def _through_ssh(command: tuple[str, ...], timeout_s: float, call: PendingCall | None) -> socket.socket:
    """The engine of another computer, through the system's `ssh` and `docker` there, as the Docker command does it."""
    ours, theirs = socket.socketpair()
    sock = EngineSocket(fileno=ours.detach())
    sock.settimeout(timeout_s)
    if call is not None:
        call.attach(sock)
    with theirs:
        try:
            # Its messages, such as a refused key, go to the terminal.
            program = subprocess.Popen(command, stdin=theirs.fileno(), stdout=theirs.fileno(), start_new_session=True)
        except OSError as error:
            sock.close()
            raise OSError(f"{command[0]} cannot be started: {error.strerror}") from error
    # It ends by itself when our end is closed; this only takes note of it.
    threads.start(threading.Thread(target=program.wait, name="phm-docker-ssh", daemon=True))
    return sock
