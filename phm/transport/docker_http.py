"""HTTP requests to the Docker Engine, on connections that belong to a call with a deadline, with responses of limited size.

The standard library's `http.client`: docker-py with requests and urllib3 takes 6 MB of memory in the daemon, for a dozen
routes (docs/reference/performance.md).

Each request opens and closes its own connection: a kept one may have died meanwhile, and opening a unix socket costs 0.1 ms.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from phm.transport.call_deadlines import shut_down
from phm.transport.dns import Resolver
from phm.transport.docker_bodies import query
from phm.transport.docker_connect import EngineSocket, connect
from phm.transport.docker_errors import EngineBroken, EngineError, StatusError

MAX_ANSWER_BYTES = 16 << 20
"""Maximum size of a response held in memory; a list of 1000 containers is about 2 MB."""
MAX_LINE_BYTES = 1 << 20
NOT_MODIFIED = 304
"""The engine's status code if a container is already in the requested state."""
_CHUNK = 64 << 10


class Response:
    """The engine's answer. Close it; what is read in one piece is closed already."""

    def __init__(self, raw: http.client.HTTPResponse, sock: socket.socket) -> None:
        self.raw, self.status, self.headers = raw, raw.status, raw.headers
        self.sock = sock

    def close(self) -> None:
        self.raw.close()
        self.sock.close()

    def read(self, size: int) -> bytes:
        """The next `size` bytes of the body; fewer at its end. Raises EOFError if the connection ended before."""
        data = self.raw.read(size)
        if not data and self.raw.length:
            raise EOFError(f"the connection broke: {self.raw.length} bytes of the answer are missing")
        return data

    def pieces(self) -> Iterator[bytes]:
        """The body as it arrives."""
        unknown = self.raw.chunked or self.raw.length is None
        # Where the length is known, `read1` does not count what it read (Python before 3.12.2).
        while piece := self.raw.read1(_CHUNK) if unknown else self.read(_CHUNK):
            yield piece

    def content(self) -> bytes:
        """The entire body. Raises EngineBroken above MAX_ANSWER_BYTES."""
        body = bytearray()
        with contextlib.closing(self):
            while piece := self.read(_CHUNK):
                body += piece
                if len(body) > MAX_ANSWER_BYTES:
                    raise EngineBroken(f"the Docker Engine's answer is longer than {MAX_ANSWER_BYTES >> 20} MiB")
        return bytes(body)

    def json(self) -> Any:
        return json.loads(self.content())


@dataclass(frozen=True, slots=True)
class EngineClient:
    """Sends the requests of one call. api_version: as in the path; empty: without. timeout_s: of connecting and of each read."""

    url: str
    resolver: Resolver | None
    api_version: str
    timeout_s: float

    def get(self, path: str, params: Mapping[str, str] | None = None) -> Any:
        """The JSON of a GET."""
        return self.request("GET", path, params).json()

    def post(self, path: str, params: Mapping[str, str] | None = None, body: str | None = None) -> Response:
        """A POST whose answer has been read, and is not used."""
        response = self.request("POST", path, params, body)
        response.content()
        return response

    def request(
        self,
        method: str,
        path: str,
        params: Mapping[str, str] | None = None,
        body: bytes | str | None = None,
    ) -> Response:
        """The response, whose body is not read yet. body: JSON, or bytes of another kind. Raises StatusError for a failure."""
        prefix = f"/v{self.api_version}" if self.api_version else ""
        headers = {"Connection": "close", "User-Agent": "phm"}
        if isinstance(body, str):
            headers["Content-Type"] = "application/json"
        connection = http.client.HTTPConnection("localhost")
        connection.sock = sock = connect(self.url, self.resolver, self.timeout_s)
        try:
            connection.request(method, f"{prefix}{path}{query(params or {})}", body=body, headers=headers)
            response = Response(connection.getresponse(), sock)
        except BaseException:
            connection.close()
            raise
        if response.status >= 300 and response.status != NOT_MODIFIED:
            raise StatusError(response.status, _explanation(response))
        return response


def _explanation(response: Response) -> str:
    """What the engine says about a failure."""
    text = response.content()
    with contextlib.suppress(ValueError, TypeError, KeyError, RecursionError):
        return str(json.loads(text)["message"])
    return text.decode("utf-8", "replace")


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
        sockets = [sock for sock in self._sockets if isinstance(sock, EngineSocket) and sock.fileno() >= 0]
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
        finally:
            self._response.close()

    def _events(self) -> Iterator[Mapping[str, Any]]:
        rest = b""
        for chunk in self._response.pieces():
            *lines, rest = (rest + chunk).split(b"\n")
            if len(rest) > MAX_LINE_BYTES:
                raise EngineBroken("the Docker Engine sent an event of more than 1 MiB")
            for line in lines:
                event = json.loads(line) if line.strip() else None
                if isinstance(event, dict):
                    yield event
