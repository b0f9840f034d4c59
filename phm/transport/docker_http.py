"""docker-py's client on connections that belong to a call with a deadline, with responses of limited size.

Each call opens and closes its own connection: a kept one may have died meanwhile, and opening a unix socket costs 0.1
ms.
"""

from __future__ import annotations

import contextlib
import json
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any
from urllib.parse import urlsplit

import requests
import requests.adapters
import urllib3
import urllib3.connection
import urllib3.connectionpool
from docker import APIClient
from requests.models import PreparedRequest, Response

from phm.core import polling, threads
from phm.transport.call_deadlines import PendingCall, shut_down
from phm.transport.dns import Address, Resolver
from phm.transport.docker_errors import EngineBroken, EngineError

MAX_ANSWER_BYTES = 16 << 20
"""Maximum size of a response held in memory; a list of 1000 containers is about 2 MB."""
MAX_LINE_BYTES = 1 << 20
_CHUNK = 64 << 10
_LEAST_S = 0.01
SSH = ("ssh", "-T", "-o", "BatchMode=yes", "-o", "ConnectTimeout=10", "-o", "ServerAliveInterval=5")
"""A password cannot be asked for; a connection that is silent for 15 s ends."""
_SSH_NAME = re.compile(r"[A-Za-z0-9_.:][A-Za-z0-9_.:-]*")
_current = threading.local()


@contextlib.contextmanager
def using(call: PendingCall) -> Iterator[None]:
    """Connections opened by this thread meanwhile belong to `call`."""
    _current.call = call
    try:
        yield
    finally:
        _current.call = None


def current_call() -> PendingCall | None:
    """The call to which connections of this thread belong."""
    call: PendingCall | None = getattr(_current, "call", None)
    return call


def _open(sock: socket.socket, address: Any) -> socket.socket:
    """Connect `sock` as part of the current call, which also records why that failed."""
    call = current_call()
    if call is not None:
        call.attach(sock)
    try:
        sock.connect(address)
    except OSError as error:
        sock.close()
        if call is not None:
            call.failure = error
        raise
    return sock


class _Socket(socket.socket):
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
        try:
            return bool(polling.wait([(self.fileno(), polling.READ)], 0.0))
        except ValueError:
            return False  # closed here


class _UnixConnection(urllib3.connection.HTTPConnection):
    socket_path = ""

    def connect(self) -> None:
        if sys.platform == "win32":
            raise OSError("Python has no Unix sockets on Windows: reach the Docker Engine by tcp://HOST:PORT")
        sock = _Socket(socket.AF_UNIX, socket.SOCK_STREAM)
        sock.settimeout(_seconds(self.timeout))
        self.sock = _open(sock, self.socket_path)


class _TcpConnection(urllib3.connection.HTTPConnection):
    resolver: Resolver

    def connect(self) -> None:
        limit_s, call = _seconds(self.timeout), current_call()
        end_s = None if limit_s is None else time.monotonic() + limit_s
        try:
            looked_up = self.resolver.ask()
            if not self.resolver.newest():  # else a name server that hangs would delay each call
                looked_up.wait(limit_s)
            addresses = self.resolver.answers()
        except OSError as error:
            if call is not None:
                call.failure = error
            raise
        try:
            self.sock = _first_open(addresses, end_s)
        except OSError:
            # The engine may have another address by now. Only a call that fails otherwise waits for that.
            looked_up.wait(None if end_s is None else max(0.0, end_s - time.monotonic()))
            newer = [each for each in self.resolver.newest() if each not in addresses]
            if not newer or (call is not None and call.expired):
                raise
            self.sock = _first_open(newer, end_s)
        if call is not None:
            call.failure = None
        self.sock.settimeout(limit_s)


def _first_open(addresses: Sequence[Address], end_s: float | None) -> socket.socket:
    """Connected to the first of them that answers; one that does not leaves time for the others. Raises the last one's OSError."""
    call = current_call()
    *others, last = addresses
    for untried, address in zip(range(len(addresses), 1, -1), others, strict=True):
        try:
            return _connected(address, end_s, untried)
        except OSError:
            if call is not None and call.expired:
                raise
    return _connected(last, end_s, 1)


def _connected(to: Address, end_s: float | None, untried: int) -> socket.socket:
    family, address = to
    sock = _Socket(family, socket.SOCK_STREAM)
    sock.settimeout(None if end_s is None else max(_LEAST_S, (end_s - time.monotonic()) / untried))
    return _open(sock, address)


class SshConnection(urllib3.connection.HTTPConnection):
    """The engine of another computer, through the system's `ssh` and `docker` there, as the Docker command does it."""

    command: tuple[str, ...]

    def connect(self) -> None:
        ours, theirs = socket.socketpair()
        sock, call = _Socket(fileno=ours.detach()), current_call()
        sock.settimeout(_seconds(self.timeout))
        if call is not None:
            call.attach(sock)
        with theirs:
            try:
                # Its messages, such as a refused key, go to the terminal.
                program = subprocess.Popen(
                    self.command, stdin=theirs.fileno(), stdout=theirs.fileno(), start_new_session=True
                )
            except OSError as error:
                sock.close()
                if call is not None:
                    call.failure = OSError(f"{self.command[0]} cannot be started: {error.strerror}")
                raise
        # It ends by itself when our end is closed; this only takes note of it.
        threads.start(threading.Thread(target=program.wait, name="phm-docker-ssh", daemon=True))
        self.sock = sock


def ssh_command(url: str) -> tuple[str, ...]:
    """How the engine of ``ssh://[user@]host[:port]`` is reached. Raises ValueError for another form."""
    parts = urlsplit(url)
    for name, word in (("host", parts.hostname or ""), ("user", parts.username or "root")):
        if not _SSH_NAME.fullmatch(word):
            raise ValueError(f"{word!r} is not a {name}")
    if parts.password or parts.path.strip("/") or parts.query or parts.fragment:
        raise ValueError("only ssh://[user@]host[:port] is supported")
    options = [("-l", parts.username), ("-p", parts.port and str(parts.port))]
    given = [word for option, value in options if value for word in (option, str(value))]
    return (*SSH, *given, "--", str(parts.hostname), "docker", "system", "dial-stdio")


def _seconds(timeout: Any) -> float | None:
    return float(timeout) if isinstance(timeout, (int, float)) else None


class _Pool(urllib3.connectionpool.HTTPConnectionPool):
    """Creates connections of one kind; `more` are attributes that all of them get."""

    def __init__(self, kind: type[urllib3.connection.HTTPConnection], **more: Any) -> None:
        super().__init__("localhost", maxsize=1)
        self.ConnectionCls = type(kind.__name__, (kind,), more)

    def _put_conn(self, conn: Any) -> None:
        """Keep no connection: a response without `Connection: close` would leave it to the next call, closed or not."""
        if conn is not None:
            conn.close()
        super()._put_conn(None)


class _Bounded(requests.adapters.HTTPAdapter):
    """Reads a response that is not streamed up to MAX_ANSWER_BYTES, and rejects a longer one."""

    def send(self, request: PreparedRequest, stream: bool = False, *args: Any, **kwargs: Any) -> Response:
        request.headers["Connection"] = "close"
        response = super().send(request, True, *args, **kwargs)
        if not stream:
            body = bytearray()
            try:
                for chunk in response.iter_content(_CHUNK):
                    body += chunk
                    if len(body) > MAX_ANSWER_BYTES:
                        raise EngineBroken(f"the Docker Engine's answer is longer than {MAX_ANSWER_BYTES >> 20} MiB")
            finally:
                response.close()
            # requests has no public way to pass a body that was read already.
            response._content = bytes(body)
            response._content_consumed = True  # type: ignore[attr-defined]
        return response


class _Adapter(_Bounded):
    """All requests use one pool, regardless of their URL."""

    def __init__(self, pool: _Pool) -> None:
        self._pool = pool
        super().__init__(pool_connections=1, pool_maxsize=1)

    def get_connection_with_tls_context(self, *args: Any, **kwargs: Any) -> Any:
        return self._pool

    def get_connection(self, *args: Any, **kwargs: Any) -> Any:
        return self._pool  # what requests before 2.32 asks for

    def request_url(self, request: PreparedRequest, proxies: Any) -> str:
        return str(request.path_url)

    def close(self) -> None:
        self._pool.close()
        super().close()


def resolver_for(url: str) -> Resolver | None:
    """The resolver for the engine's host, shared by all clients; None for a unix socket, and for ssh, which resolves it."""
    parts = urlsplit(url)
    return Resolver(parts.hostname or "", parts.port or 2375, socket.SOCK_STREAM) if parts.scheme == "tcp" else None


def client_for(url: str, version: str, resolver: Resolver | None) -> APIClient:
    """A docker-py client for the use of one thread; `version` is the API's, so nothing is requested here."""
    client = APIClient(base_url="unix:///ssh" if url.startswith("ssh://") else url, version=version)
    client.trust_env = False  # no HTTP_PROXY and no .netrc between PHM and its own engine
    if url.startswith("ssh://"):
        client.mount("http+docker://", _Adapter(_Pool(SshConnection, command=ssh_command(url))))
    elif resolver is None:
        client.mount("http+docker://", _Adapter(_Pool(_UnixConnection, socket_path=url.removeprefix("unix://"))))
    else:
        client.mount("http://", _Adapter(_Pool(_TcpConnection, resolver=resolver)))
    return client


class EventStream:
    """The engine's events as dictionaries, until the stream ends, breaks, or `close` is called.

    Iterate once, in one thread. `close` may be called from any other and ends the iteration immediately. `failures` are
    the exceptions that reading may raise; `translate` converts them to EngineError.
    """

    def __init__(
        self,
        response: Response,
        sockets: tuple[socket.socket, ...],
        failures: tuple[type[BaseException], ...],
        translate: Callable[[BaseException], EngineError],
    ) -> None:
        self._response, self._sockets = response, sockets
        self._failures, self._translate = failures, translate
        self.closed = False

    def close(self) -> None:
        self.closed = True
        for sock in self._sockets:
            shut_down(sock)

    def caught_up(self) -> bool:
        """Whether each event received before this call has been processed; callable from any thread.

        The order of the two checks matters: an event received after the first may be processed at any time.
        """
        sockets = [sock for sock in self._sockets if isinstance(sock, _Socket) and sock.fileno() >= 0]
        return self.closed or not any(sock.unread() or not sock.waiting for sock in sockets)

    def __enter__(self) -> EventStream:
        return self

    def __exit__(self, *error: object) -> None:
        """For the reading thread only: `response.close` would wait for a read in another one."""
        self.close()
        self._response.close()

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        try:
            yield from self._events()
        except self._failures as error:
            if not self.closed:
                raise self._translate(error) from error

    def _events(self) -> Iterator[Mapping[str, Any]]:
        rest = b""
        for chunk in self._response.iter_content(_CHUNK):
            *lines, rest = (rest + chunk).split(b"\n")
            if len(rest) > MAX_LINE_BYTES:
                raise EngineBroken("the Docker Engine sent an event of more than 1 MiB")
            for line in lines:
                event = json.loads(line) if line.strip() else None
                if isinstance(event, dict):
                    yield event
