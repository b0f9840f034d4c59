"""The router of a simulated agent as a separate program, with real sockets."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from sitl.simulation import router as program
from tests.fakes.until import until

LIMIT_S = 60.0
MOST_KB = 12 * 1024
SELECTS = ("23", "270", "72")
"""Numbers of select and pselect6 on x86-64, and of pselect6 on arm64."""


class Far:
    """The link emulator's end."""

    def __init__(self) -> None:
        self.door = socket.create_server(("127.0.0.1", 0))
        self.door.settimeout(LIMIT_S)
        self.port = self.door.getsockname()[1]
        self.open = contextlib.ExitStack()
        self.open.enter_context(self.door)

    def connected(self) -> socket.socket:
        sock, _ = self.door.accept()
        sock.settimeout(LIMIT_S)
        return self.open.enter_context(sock)


@pytest.fixture
def far() -> Iterator[Far]:
    made = Far()
    with made.open:
        yield made


@pytest.fixture
def port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


@pytest.fixture
def router(far: Far, port: int) -> Iterator[subprocess.Popen[bytes]]:
    argv = [sys.executable, "-I", "-S", str(Path(program.__file__)), str(port), "127.0.0.1", str(far.port)]
    with subprocess.Popen(argv) as process:
        yield process
        process.kill()


@contextlib.contextmanager
def connected(port: int) -> Iterator[socket.socket]:
    found: list[socket.socket] = []

    def tried() -> bool:
        with contextlib.suppress(ConnectionRefusedError):
            found.append(socket.create_connection(("127.0.0.1", port), LIMIT_S))
        return bool(found)

    until(tried, "the router to listen")
    with found[0] as near:
        near.settimeout(LIMIT_S)
        yield near


def waits_without_timeout(pid: int) -> bool:
    """Whether it is in a call of select() or pselect() without a timeout (the fifth argument): only an event wakes it."""
    call = Path(f"/proc/{pid}/syscall").read_text().split()
    return call[0] in SELECTS and call[5] == "0x0"


def refused(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), LIMIT_S).close()
    except ConnectionRefusedError:
        return True
    return False


def test_bytes_pass_in_both_directions(router: subprocess.Popen[bytes], far: Far, port: int) -> None:
    """Also after PHM was disconnected."""
    air = far.connected()
    for _ in range(2):
        with connected(port) as near:
            near.sendall(b"up")
            assert air.recv(10) == b"up"
            air.sendall(b"down")
            assert near.recv(10) == b"down"


def test_a_later_connection_replaces_the_earlier_one(router: subprocess.Popen[bytes], far: Far, port: int) -> None:
    """PHM may have lost a connection that the router still considers open."""
    air = far.connected()
    with connected(port) as lost, connected(port) as near:
        assert lost.recv(10) == b""
        near.sendall(b"up")
        assert air.recv(10) == b"up"


def test_connections_are_refused_while_the_emulator_is_away(
    router: subprocess.Popen[bytes], far: Far, port: int
) -> None:
    """As if there were no router: PHM sees one fault, whichever of the two processes ends."""
    air = far.connected()
    with connected(port) as near:
        air.close()
        far.door.close()
        assert near.recv(10) == b""
    until(lambda: refused(port), "the router to refuse")


def test_the_router_needs_little_memory_and_no_cpu_when_idle(
    router: subprocess.Popen[bytes], far: Far, port: int
) -> None:
    """One for each agent of a machine: 12 MB at most, and it sleeps while no data arrive."""
    air = far.connected()
    with connected(port) as near:
        air.sendall(b"down")
        assert near.recv(10) == b"down"
        status = Path(f"/proc/{router.pid}/status").read_text()
        (resident,) = [line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")]
        assert int(resident) <= MOST_KB
        until(lambda: waits_without_timeout(router.pid), "the router to sleep")


def test_the_router_ends_on_sigterm(router: subprocess.Popen[bytes], far: Far) -> None:
    """`docker stop` does not have to kill it."""
    far.connected()
    router.terminate()
    assert router.wait(LIMIT_S) == 0
