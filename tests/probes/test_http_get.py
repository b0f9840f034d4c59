"""GET requests to real web servers on loopback."""

from __future__ import annotations

import contextlib
import http.server
import ssl
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.core.clock import SystemClock
from phm.facts import CannotTell
from phm.probes.http_get import BODY_BYTES
from phm.probes.pattern_matcher import PatternMatcher
from phm.probes.sockets import Sockets


class Pages(http.server.BaseHTTPRequestHandler):
    """`/slow` sends a byte now and then, `/endless` never stops, `/garbage` is not HTTP."""

    stop = threading.Event()

    def do_GET(self) -> None:
        if self.path == "/garbage":
            self.wfile.write(b"\x00\x01\r\n\r\n")
            return
        self.send_response({"/moved": 302, "/gone": 503}.get(self.path, 200))
        self.send_header("Location", "http://elsewhere.invalid/")
        self.end_headers()
        if self.path == "/page?x=1":
            self.wfile.write(b'{"state": "flying", "host": "%s"}' % self.headers["Host"].encode())
        while self.path in ("/endless", "/slow"):
            if self.path == "/slow" and self.stop.wait(0.05):
                return
            try:
                self.wfile.write(b"x" * (1 if self.path == "/slow" else 65536))
            except OSError:
                return

    def log_message(self, format: str, *args: object) -> None:
        """Silent."""


def serving(context: ssl.SSLContext | None = None) -> Iterator[str]:
    Pages.stop.clear()
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Pages) as server:
        if context is not None:
            server.socket = context.wrap_socket(server.socket, server_side=True)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{server.server_address[1]}"
        Pages.stop.set()
        server.shutdown()


@pytest.fixture
def server() -> Iterator[str]:
    yield from serving()


@pytest.fixture
def sockets() -> Iterator[Sockets]:
    clock = SystemClock()
    matcher = PatternMatcher(clock, limit_s=60.0)
    made = Sockets(clock, matcher)
    yield made
    made.close()
    matcher.close()


def test_a_page_has_a_status_and_a_body(sockets: Sockets, server: str) -> None:
    """The query is sent, and the pattern is searched in the body."""
    fact = sockets.get(f"http://{server}/page?x=1", timeout_s=60, pattern='"state": "fl.*g"')
    assert (fact.problem, fact.status, fact.found) == ("", 200, True)
    assert fact.body == f'{{"state": "flying", "host": "{server}"}}'
    assert not sockets.get(f"http://{server}/page?x=1", timeout_s=60, pattern="landed").found


def test_a_redirect_is_not_followed(sockets: Sockets, server: str) -> None:
    """A server cannot send PHM to other hosts."""
    fact = sockets.get(f"http://{server}/moved", timeout_s=60)
    assert (fact.problem, fact.status, fact.location) == ("", 302, "http://elsewhere.invalid/")


def test_an_error_page_is_an_answer(sockets: Sockets, server: str) -> None:
    """What it means is the check's matter."""
    assert sockets.get(f"http://{server}/gone", timeout_s=60).status == 503


def test_an_answer_that_trickles_ends_at_the_deadline(sockets: Sockets, server: str) -> None:
    """The time is that of the entire answer, not from byte to byte."""
    said = ""
    for timeout_s in (0.5, 5.0, 20.0):  # a busy machine may need seconds to look up the address
        with contextlib.suppress(CannotTell):
            said = sockets.get(f"http://{server}/slow", timeout_s=timeout_s).problem
            break
    assert said == f"no answer within {timeout_s:g} s"


def test_an_endless_body_is_cut(sockets: Sockets, server: str) -> None:
    """Memory is bounded whatever the server sends."""
    fact = sockets.get(f"http://{server}/endless", timeout_s=60)
    assert (fact.status, len(fact.body)) == (200, BODY_BYTES)


def test_an_answer_in_another_protocol_is_a_problem(sockets: Sockets, server: str) -> None:
    """It is text for the log, not an exception."""
    assert sockets.get(f"http://{server}/garbage", timeout_s=60).problem.startswith("no valid answer")


def test_a_port_without_listener(sockets: Sockets, server: str) -> None:
    """The connection is refused: port 1 of loopback."""
    assert sockets.get("http://127.0.0.1:1/", timeout_s=60).problem == "the connection was refused"


def test_a_certificate_is_verified_unless_the_user_says_otherwise(sockets: Sockets, tmp_path: Path) -> None:
    """One without a known issuer is refused."""
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    words = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    words += ["-subj", "/CN=127.0.0.1", "-days", "2", "-keyout", str(key), "-out", str(certificate)]
    subprocess.run(words, check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    for address in serving(context):
        refused = sockets.get(f"https://{address}/", timeout_s=60)
        assert refused.problem.startswith("its certificate is not valid"), refused
        assert sockets.get(f"https://{address}/", timeout_s=60, verify_tls=False).status == 200
