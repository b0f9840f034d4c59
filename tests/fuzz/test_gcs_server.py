"""The port of `phm gcs --serve`: after any data, in any fragments, the next client gets its snapshot."""

from __future__ import annotations

import contextlib
import json
import socket
from functools import cache
from itertools import pairwise
from typing import Any, cast

from hypothesis import strategies as st

from phm.core.clock import SystemClock
from phm.gcs.web import stream
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.server import WebServer
from tests.fakes.until import until
from tests.fuzz.hostile import corrupted
from tests.fuzz.targets import fuzzed
from tests.gcs.bench import Source

LIMIT_S = 60.0
ASKED = [
    b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /snapshot HTTP/1.1\r\nHost: 127.0.0.1:80\r\n\r\n",
    b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\n\r\nabc",
    b"GET /snapshot?x=1 HTTP/1.0\n\n",
    b"GET /snapshot HTTP/1.1\r\nHost: " + b"x" * 8192 + b"\r\n\r\n",
    b"GET /x HTTP/1.1\r\nHost: [::1]:80\r\n\r\n",
]
STATUSES = (b"200", b"400", b"403", b"404", b"405", b"408", b"413", b"414", b"417", b"431", b"503")


@cache
def _server() -> WebServer:
    made = stream.serve(cast(Any, Source()), ListenOptions(port=0), SystemClock())
    made.start()
    until(lambda: made._loop, "the server")
    return made


def _read(server: WebServer, pieces: list[bytes], *, ends: bool = True) -> bytes:
    """All data until the server closes the connection or has sent its first line. ends: nothing more follows, which a server may
    take for the end of the client.
    """
    answer = b""
    with socket.create_connection(server.address, LIMIT_S) as client, contextlib.suppress(OSError):
        for piece in pieces:
            client.sendall(piece)
        if ends:
            client.shutdown(socket.SHUT_WR)
        while b"\n{" not in answer and not answer.startswith(b"{") and (got := client.recv(65536)):
            answer += got
    return answer


@fuzzed(
    "HTTP of --serve",
    asked=st.sampled_from(ASKED).flatmap(corrupted) | st.sampled_from(ASKED) | st.binary(max_size=300),
    cuts=st.lists(st.integers(0, 300), max_size=4),
)
def test_any_request_gets_an_answer_and_the_next_client_its_snapshot(asked: bytes, cuts: list[int]) -> None:
    """A known status, the events, or the end of the connection."""
    server, ends = _server(), sorted({*cuts, 0, len(asked)})
    pieces = [asked[start:end] for start, end in pairwise(ends)]
    answer = _read(server, pieces)
    if answer.startswith(b"HTTP/"):
        assert answer.split()[1] in STATUSES
    else:
        assert not answer or isinstance(json.loads(answer.splitlines()[0]), dict)
    good = _read(server, [ASKED[1]], ends=False)
    assert good.startswith(b"HTTP/1.1 200")
    assert isinstance(json.loads(good.partition(b"\r\n\r\n")[2]), dict)
