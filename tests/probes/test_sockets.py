"""Connections to real servers on loopback."""

from __future__ import annotations

import contextlib
import os
import resource
import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from phm.core.clock import SystemClock
from phm.facts import CannotTell, ConnectionFact
from phm.probes.pattern_matcher import PatternMatcher
from phm.probes.sockets import BANNER_BYTES, Sockets

CLOCK = SystemClock()
Serve = Callable[[Callable[[socket.socket], object]], int]


@pytest.fixture
def sockets() -> Iterator[Sockets]:
    matcher = PatternMatcher(CLOCK, limit_s=60.0)
    made = Sockets(CLOCK, matcher)
    yield made
    made.close()
    matcher.close()


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Start a server for one connection on a free port, which is returned."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def start(answer: Callable[[socket.socket], object]) -> int:
            def run() -> None:
                # The client may close first, with data unread: then its end of the connection is a reset. On a busy machine it may have
                # its answer by the system, and the listener be closed, before this thread accepts.
                with contextlib.suppress(OSError), listener.accept()[0] as connection:
                    answer(connection)

            threading.Thread(target=run, daemon=True).start()
            return int(listener.getsockname()[1])

        yield start


def test_a_listening_port_is_connected(sockets: Sockets, serve: Serve) -> None:
    """By address and by name; `localhost` may have an IPv6 address first, without a listener."""
    port = serve(lambda connection: connection.recv(1))
    fact = sockets.connect("localhost", port, timeout_s=60)
    assert (fact.problem, fact.received) == ("", "")


def test_a_closed_port_is_refused(sockets: Sockets) -> None:
    """A server that has ended."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    assert sockets.connect("127.0.0.1", port, timeout_s=60).problem == "the connection was refused"


def test_a_greeting_of_the_server_is_read(sockets: Sockets, serve: Serve) -> None:
    """Also in several parts, until it is what was expected."""

    def answer(connection: socket.socket) -> None:
        for part in (b"SSH", b"-2.0", b"-x\r\n"):
            connection.sendall(part)
        connection.recv(1)

    fact = sockets.connect("127.0.0.1", serve(answer), timeout_s=60, expect="SSH-2.0")
    assert fact.received.startswith("SSH-2.0")


def test_a_silent_server_ends_at_the_deadline(sockets: Sockets, serve: Serve) -> None:
    """The connection exists; nothing is received."""
    stop, fact = threading.Event(), ConnectionFact("never connected", 0.0)
    port = serve(lambda _: stop.wait(120))
    for timeout_s in (0.2, 5.0, 20.0):  # a busy machine may need seconds to connect
        with contextlib.suppress(CannotTell):
            fact = sockets.connect("127.0.0.1", port, timeout_s=timeout_s, expect="SSH")
        if not fact.problem:
            break
    stop.set()
    assert (fact.problem, fact.received) == ("", "")


def test_a_server_that_never_stops_sending_is_cut(sockets: Sockets, serve: Serve) -> None:
    """Its text is bounded, and so is the time."""

    def answer(connection: socket.socket) -> None:
        with contextlib.suppress(OSError):  # PHM closes
            while True:
                connection.sendall(b"x" * 65536)

    fact = sockets.connect("127.0.0.1", serve(answer), timeout_s=60, expect="SSH")
    assert 0 < len(fact.received) <= BANNER_BYTES


def test_an_unknown_name_is_a_problem_of_the_server(sockets: Sockets) -> None:
    """As of a container that is gone: Docker's name server forgets it. `.invalid` never exists (RFC 6761)."""
    try:
        problem = sockets.connect("server.invalid", 80, timeout_s=60).problem
    except CannotTell as error:  # a machine without any name server
        problem = str(error)
    assert "server.invalid" in problem


def test_after_the_end_nothing_is_connected() -> None:
    """PHM that stops waits for no server."""
    sockets = Sockets(CLOCK, PatternMatcher(CLOCK))
    sockets.close()
    with pytest.raises(CannotTell, match="PHM is stopping"):
        sockets.connect("127.0.0.1", 1, timeout_s=30)


def test_a_lack_of_file_descriptors_is_not_a_failure_of_the_server(sockets: Sockets) -> None:
    """PHM's own shortage must not restart the container behind the server.

    The server has no thread: its `accept` would need a file descriptor, too.
    """
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    calls: tuple[Callable[[], object], ...] = (
        lambda: sockets.connect("127.0.0.1", port, timeout_s=60),
        lambda: sockets.get(f"http://127.0.0.1:{port}/", timeout_s=60),
    )
    assert sockets.connect("127.0.0.1", 1, timeout_s=60).problem, "its threads run now"
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    lowest = os.dup(0)
    os.close(lowest)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, before[1]))
    try:
        for call in calls:
            with pytest.raises(CannotTell, match="Too many open files"):
                call()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
        listener.close()
