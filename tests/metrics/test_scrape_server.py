"""The server of the page: only GET /metrics, and no client holds it up or makes it work much."""

from __future__ import annotations

import contextlib
import errno
import http.client
import socket
import socketserver
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from phm.core import threads
from phm.core.clock import SystemClock
from phm.testing import FakeClock
from phm.transport import scrape_server
from phm.transport.scrape_server import MAX_CLIENTS, MAX_HEAD, ScrapeServer
from phm.wire.openmetrics import wants_openmetrics
from tests.fakes.until import until

PAGE = b"x" * 300_000


def scrape_threads() -> list[threading.Thread]:
    """Those that serve clients now."""
    return [thread for thread in threading.enumerate() if thread.name == "phm-scrape"]


class Bench:
    """A server and what was rendered."""

    def __init__(self, *, local: bool = True) -> None:
        self.rendered: list[str] = []
        self.page, self.broken, self.takes_s = PAGE, False, 0.0
        self.may_end = threading.Event()
        self.may_end.set()
        self.clock = FakeClock()
        self.server = ScrapeServer("127.0.0.1", 0, self._render, wants_openmetrics, self.clock, local=local)
        self.server.start()

    def _render(self, accept: str) -> tuple[bytes, str]:
        self.rendered.append(accept)
        self.clock.advance(self.takes_s)
        assert self.may_end.wait(60)
        if self.broken:
            raise ValueError("secret")
        return self.page, "text/plain; version=0.0.4"

    def get(self, path: str = "/metrics", method: str = "GET", **headers: str) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection(*self.server.address, timeout=60)
        try:
            connection.request(method, path, headers=headers)
            response = connection.getresponse()
            return response.status, response.read()
        finally:
            connection.close()

    def connect(self) -> socket.socket:
        return socket.create_connection(self.server.address, timeout=60)

    def raw(self, request: bytes) -> bytes:
        """All that comes back."""
        with self.connect() as client:
            client.sendall(request)
            found = b""
            with contextlib.suppress(ConnectionError):
                while more := client.recv(65536):
                    found += more
            return found


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A client, and a thread of the server, that the machine delays is not slow; a test of a slow one sets the limit. The time of a
    client is longer than `until` waits: where a newer one must have replaced it, it is not enough that its time is over."""
    monkeypatch.setattr(scrape_server, "CLIENT_S", 600.0)
    monkeypatch.setattr(scrape_server, "DROP_LIMIT_S", 60.0)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.may_end.set()
    made.server.close()


def test_only_the_page_is_served(bench: Bench) -> None:
    """By GET, or HEAD without the body."""
    assert bench.get() == (200, PAGE)
    assert bench.get("/metrics?name[]=x") == (200, PAGE)
    assert bench.get(method="HEAD") == (200, b"")
    assert bench.get("/")[0] == 404
    assert bench.get("/../etc/passwd")[0] == 404
    assert bench.get(method="POST")[0] == 405


@pytest.mark.parametrize("host", ["evil.example", "evil.example:9464", "127.0.0.1.evil.example", "[::2]:1", "127.evil"])
def test_on_loopback_another_name_of_the_host_is_refused(bench: Bench, host: str) -> None:
    """A web page of anywhere can have its own name point to this machine, and read what its browser gets."""
    assert bench.get(Host=host)[0] == 403
    assert bench.rendered == []


@pytest.mark.parametrize("host", ["localhost", "localhost:9464", "127.0.0.1:9464", "127.0.0.2", "[::1]:9464"])
def test_local_names_are_answered(bench: Bench, host: str) -> None:
    """As Prometheus sends them."""
    assert bench.get(Host=host)[0] == 200


def test_elsewhere_any_name_is_answered() -> None:
    """An address that others reach has names that PHM does not know."""
    bench = Bench(local=False)
    try:
        assert bench.get(Host="drone-5.fleet.example:9464")[0] == 200
    finally:
        bench.server.close()


@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        (b"\r\n\r\n", b"400"),
        (b"GET /metrics\r\n\r\n", b"400"),
        (b"\x00\xff\x16\x03\x01\r\n\r\n", b"400"),
        (b"GET  /metrics HTTP/1.1\r\n\r\n", b"400"),
        (b"GET /metrics HTTP/1.1\r\n" + b"A: b\r\n" * MAX_HEAD + b"\r\n", b"431"),
        (b"GET /" + b"a" * 10 * MAX_HEAD + b" HTTP/1.1\r\n\r\n", b"431"),
    ],
)
def test_anything_but_a_request_is_refused(bench: Bench, request_bytes: bytes, status: bytes) -> None:
    """With a status, or with the end of the connection when more came than is read."""
    said = bench.raw(request_bytes)
    assert said.startswith(b"HTTP/1.0 " + status) or (status == b"431" and not said)
    assert bench.get()[0] == 200


def test_slow_clients_do_not_keep_prometheus_waiting(bench: Bench) -> None:
    """More of them than are served together send half a request: the next one gets its page, and the oldest are dropped."""
    slow = [bench.connect() for _ in range(MAX_CLIENTS + 4)]
    try:
        for client in slow:
            client.sendall(b"GET /metrics HTTP/1.1\r\nHo")
        until(lambda: bench.server.dropped >= 4, "the oldest clients to be dropped")
        assert bench.get() == (200, PAGE)
        assert slow[0].recv(10) == b""
    finally:
        for client in slow:
            client.close()


def test_a_client_that_sends_or_reads_slowly_is_dropped_after_a_time(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is for all of its request and answer, so a byte now and then does not extend it."""
    bench.page = b"x" * 20_000_000  # more than the kernel takes into its buffers
    with monkeypatch.context() as shorter, contextlib.ExitStack() as clients:
        shorter.setattr(scrape_server, "CLIENT_S", 0.3)
        sends, reads = clients.enter_context(bench.connect()), clients.enter_context(socket.socket())
        reads.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        reads.connect(bench.server.address)
        reads.sendall(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n")

        def drip() -> bool:
            with contextlib.suppress(ConnectionError):
                sends.sendall(b"G")
            return bench.server.dropped >= 2

        until(drip, "both clients to be dropped")
    bench.page = PAGE
    bench.clock.advance(scrape_server.AGAIN_S)
    assert bench.get() == (200, PAGE)


def test_any_number_of_slow_clients_has_a_limited_number_of_threads(bench: Bench) -> None:
    """Each would otherwise take one of the processes that the container may have."""
    slow = []
    for _ in range(4 * MAX_CLIENTS):
        slow.append(bench.connect())
        slow[-1].sendall(b"GET /metrics HTTP/1.1\r\nHo")
        # Those of dropped clients may be about to end.
        until(lambda: len(scrape_threads()) <= MAX_CLIENTS, "threads beyond the limit to end", scrape_threads)
    until(lambda: bench.server.dropped >= 3 * MAX_CLIENTS, "the older clients to be dropped")
    until(lambda: 0 < len(scrape_threads()) <= MAX_CLIENTS, "threads of the newest clients alone", scrape_threads)
    assert bench.get() == (200, PAGE)
    for client in slow:
        client.close()
    until(lambda: not scrape_threads(), "the threads to end")


def test_a_page_that_is_never_done_does_not_collect_threads(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A dropped client cannot end a thread that waits for the page, so the next ones are turned away."""
    monkeypatch.setattr(scrape_server, "DROP_LIMIT_S", 0.01)
    bench.may_end.clear()
    waiting = [bench.connect() for _ in range(MAX_CLIENTS + 4)]
    for client in waiting:
        with contextlib.suppress(ConnectionError):
            client.sendall(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n")
    until(lambda: bench.server.dropped >= 4, "clients to be turned away")
    until(lambda: len(scrape_threads()) <= MAX_CLIENTS, "threads beyond the limit to end", scrape_threads)
    bench.may_end.set()
    until(lambda: not scrape_threads(), "the threads to end")
    assert bench.get() == (200, PAGE)
    for client in waiting:
        client.close()


def test_a_request_that_ends_early_is_not_answered(bench: Bench) -> None:
    """A part of a request may lack the header that refuses it."""
    with bench.connect() as client:
        client.sendall(b"GET /metrics HTTP/1.1\r\nHost: local")
        client.shutdown(socket.SHUT_WR)
        assert client.recv(100) == b""
    assert bench.rendered == []


def test_clients_are_accepted_again_after_a_failure(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Such as a lack of file descriptors; there is a pause after each failure, as the listener stays ready."""
    failures = [OSError(errno.EMFILE, "Too many open files")] * 3
    accept = socketserver.TCPServer.get_request

    def fail_first(server: socketserver.TCPServer) -> Any:
        if failures:
            raise failures.pop()
        return accept(server)

    monkeypatch.setattr(scrape_server, "RETRY_S", 0.01)
    monkeypatch.setattr(socketserver.TCPServer, "get_request", fail_first)
    assert bench.get() == (200, PAGE)
    assert caplog.text.count("a client could not be accepted: [Errno 24] Too many open files") == 3


def test_without_a_thread_for_it_a_client_is_dropped_and_the_next_is_served(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a process limit; PHM reports the limit as its problem."""
    monkeypatch.setattr(threads, "_refused", {})
    monkeypatch.setattr(threads, "REPORTED_S", 600.0)
    with monkeypatch.context() as limited:
        limited.setattr(threading.Thread, "start", _no_thread)
        assert bench.raw(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n") == b""
    assert bench.server.dropped == 1
    assert "threads cannot be started (phm-scrape)" in threads.problem()
    assert bench.get() == (200, PAGE)


def _no_thread(_thread: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


def test_at_the_end_all_clients_are_disconnected(bench: Bench) -> None:
    """Also those that would wait for their time to be over."""
    with bench.connect() as client:
        client.sendall(b"GET /metrics")
        until(scrape_threads, "the client to be accepted")
        bench.server.close()
        assert client.recv(10) == b""
    until(lambda: not scrape_threads(), "the threads to end")


def test_many_clients_at_once_are_all_served_and_the_page_is_made_once(bench: Bench) -> None:
    """Rendering costs the most, so it is done at most once per AGAIN_S for each format."""
    found: list[tuple[int, bytes]] = []
    threads = [threading.Thread(target=lambda: found.append(bench.get())) for _ in range(MAX_CLIENTS // 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert found == [(200, PAGE)] * len(threads)
    assert len(bench.rendered) == 1
    bench.get(Accept="application/openmetrics-text")
    bench.get(Accept="application/openmetrics-text; version=1.0.0; x=1")
    assert len(bench.rendered) == 2
    bench.clock.advance(scrape_server.AGAIN_S)
    bench.get()
    assert len(bench.rendered) == 3


def test_a_failure_is_an_answer_without_its_reason_and_the_next_request_is_served(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    """The reason is in PHM's log."""
    bench.broken = True
    status, body = bench.get()
    assert (status, b"secret" in body) == (500, False)
    assert "secret" in caplog.text
    bench.broken = False
    bench.clock.advance(scrape_server.AGAIN_S)
    assert bench.get()[0] == 200


def test_a_failing_page_is_not_made_for_each_request(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    """Else a client fills the log with the reason, and keeps a core busy."""
    bench.broken = True
    assert [bench.get()[0] for _ in range(5)] == [500] * 5
    assert len(bench.rendered) == 1 and caplog.text.count("Traceback") == 1
    bench.clock.advance(scrape_server.AGAIN_S)
    bench.broken = False
    assert bench.get()[0] == 200


def test_a_page_that_takes_long_is_not_made_all_the_time(bench: Bench) -> None:
    """The pause begins when it is done, so a busy daemon is not kept busy by it."""
    bench.takes_s = 10 * scrape_server.AGAIN_S
    for _ in range(3):
        assert bench.get()[0] == 200
    assert len(bench.rendered) == 1


def test_a_refusal_has_what_http_asks_for(bench: Bench) -> None:
    """HEAD never gets a body, whatever the status; 405 names the methods."""
    assert bench.get("/other", method="HEAD") == (404, b"")
    assert bench.raw(b"HEAD /other HTTP/1.1\r\nHost: localhost\r\n\r\n").endswith(b"\r\n\r\n")
    assert b"\r\nAllow: GET, HEAD\r\n" in bench.raw(b"POST /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert bench.get(method="BREW")[0] == 501
    assert bench.get(method="POST", Host="evil.example")[0] == 403


def test_a_client_learns_nothing_about_the_machine(bench: Bench) -> None:
    """Neither the version of Python, nor what it sent: a browser could take that for a page."""
    said = bench.raw(b"GET /<script> HTTP/1.1\r\nHost: localhost\r\n\r\n") + bench.raw(b"<script>\r\n\r\n")
    assert b"Python" not in said
    assert said.count(b"X-Content-Type-Options: nosniff\r\n") == 2
    assert all(b"<script>" not in answer.partition(b"\r\n\r\n")[2] for answer in said.split(b"HTTP/1.0 "))


def test_the_port_is_free_after_close() -> None:
    """So that the daemon of a new configuration can listen there immediately; a second one meanwhile cannot."""
    first = ScrapeServer("127.0.0.1", 0, lambda _: (b"", ""), wants_openmetrics, SystemClock(), local=True)
    first.start()
    with pytest.raises(OSError, match="in use"):
        ScrapeServer(*first.address, lambda _: (b"", ""), wants_openmetrics, SystemClock(), local=True)
    first.close()
    ScrapeServer(*first.address, lambda _: (b"", ""), wants_openmetrics, SystemClock(), local=True).close()
