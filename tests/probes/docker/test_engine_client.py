"""The Docker Engine client: deadlines, kinds of failure, limits."""

from __future__ import annotations

import hashlib
import os
import socket
import threading
from pathlib import Path

import pytest

from phm.facts import CannotTell, NoAccess, NoResponse, NotPermitted
from phm.testing import FakeClock
from phm.transport.call_deadlines import CallDeadlines
from phm.transport.docker import (
    DockerEngine,
    EngineBroken,
    EngineConflict,
    EngineError,
    EngineMissing,
    EngineNotConnected,
    EngineRefused,
    EngineTimeout,
    EngineUnreachable,
)
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import DropStream, Fault, Garbage, Hang, NoHttp, Oversize, Status, Trickle, Truncate
from tests.fakes.until import until
from tests.probes.docker.conftest import HUNG_S, LONG_S


@pytest.mark.parametrize("fault", [Hang(), Trickle(), Trickle(route="/json")])
def test_requests_to_a_hung_or_slow_engine_are_aborted_at_the_deadline(
    fake: FakeEngine, ask: DockerEngine, fault: Fault
) -> None:
    """Each request has a deadline, which slowly arriving bytes do not extend."""
    fake.containers["app"] = container("app")
    fake.fault, ask.timeout_s = fault, HUNG_S
    with pytest.raises(EngineTimeout, match=r"did not answer within 4\.0 s \(inspect app\)"):
        ask.inspect("app")


def test_an_engine_with_an_aborted_request_can_be_asked_again(fake: FakeEngine, ask: DockerEngine) -> None:
    """An aborted request leaves nothing behind that breaks the next one."""
    fake.containers["app"] = container("app")
    fake.fault = Trickle()
    with pytest.raises(EngineTimeout):
        ask.inspect("app", deadline_s=HUNG_S)
    fake.fault = None
    assert ask.inspect("app")["Name"] == "/app"


def test_only_the_overdue_request_is_aborted(fake: FakeEngine) -> None:
    """The deadline of one request does not affect a request of another thread with a later deadline."""
    fake.containers["app"] = container("app")
    engine = DockerEngine(fake.url, timeout_s=LONG_S)
    engine.version()
    fake.fault = Trickle(every_s=0.005, endless=False, route="/app/")
    seen: list[object] = []
    thread = threading.Thread(target=lambda: seen.append(engine.inspect("app")["Name"]))
    thread.start()
    assert fake.wait(lambda engine: "GET /containers/app/json" in engine.calls)
    with pytest.raises(EngineTimeout):
        engine.call(lambda client: client.inspect_container("app"), deadline_s=0.2)
    thread.join(LONG_S)
    assert seen == ["/app"]
    engine.close()


def test_requests_leave_neither_threads_nor_descriptors_behind(fake: FakeEngine, ask: DockerEngine) -> None:
    """A hundred requests, some of them aborted, leak nothing."""
    fake.containers["app"] = container("app")
    ask.inspect("app")
    threads = {thread for thread in threading.enumerate() if thread.name.startswith("phm-")}
    descriptors = len(os.listdir("/proc/self/fd"))
    for number in range(100):
        if number % 50 == 0:
            fake.fault = Hang()
            with pytest.raises(EngineTimeout):
                ask.call(lambda client: client.inspect_container("app"), deadline_s=0.05)
            fake.fault = None
        ask.inspect("app")
    # Of an earlier test one may have ended since.
    assert {thread for thread in threading.enumerate() if thread.name.startswith("phm-")} <= threads
    # The fake closes its ends of aborted connections in its own threads, and has those of the last ones.
    until(lambda: len(os.listdir("/proc/self/fd")) <= descriptors + 4, "the descriptors to be closed")


@pytest.mark.parametrize(
    ("fault", "kind", "words"),
    [
        (
            Status(403, "endpoint with name app already exists in network net"),
            EngineConflict,
            r"HTTP 403 \(inspect app\): endpoint",
        ),
        (Status(403, "Address already in use"), EngineConflict, r"HTTP 403 \(inspect app\): Address"),
        (Status(403, "not on the list"), EngineRefused, r"does not permit PHM to inspect app \(HTTP 403\)"),
        (Status(404, "No such container"), EngineMissing, "HTTP 404"),
        (Status(409, "is not running"), EngineConflict, "is not running"),
        (Status(500, "driver failed"), EngineBroken, "driver failed"),
        (Status(502), EngineUnreachable, "the proxy has no answer .*HTTP 502"),
        (Status(503), EngineNotConnected, "the proxy has no answer .*HTTP 503"),
        (Status(504), EngineTimeout, "the proxy has no answer .*HTTP 504"),
        (Garbage(), EngineBroken, "an invalid answer"),
        (NoHttp(), EngineBroken, "does not answer like"),
        (Truncate(), EngineUnreachable, "broke"),
        (Oversize(), EngineBroken, "longer than 16 MiB"),
    ],
)
def test_each_failure_of_the_engine_has_a_kind_and_a_text(
    fake: FakeEngine, ask: DockerEngine, fault: Fault, kind: type[EngineError], words: str
) -> None:
    """Every failure is one of a few exceptions, so a caller needs no knowledge of HTTP libraries."""
    fake.containers["app"] = container("app")
    ask.version()
    fake.fault = fault
    with pytest.raises(kind, match=words):
        ask.inspect("app", deadline_s=LONG_S)


def test_a_refusal_is_not_permitted_and_everything_is_cannot_tell() -> None:
    """Checks and recovery know only `CannotTell`, `NotPermitted` and `NoResponse`."""
    assert issubclass(EngineRefused, NotPermitted)
    assert all(
        issubclass(kind, CannotTell)
        for kind in (EngineTimeout, EngineUnreachable, EngineRefused, EngineConflict, EngineMissing, EngineBroken)
    )
    assert issubclass(EngineTimeout, NoResponse) and issubclass(EngineUnreachable, NoResponse)
    assert not issubclass(EngineBroken, NoResponse)


def test_a_missing_socket_names_its_path(tmp_path: Path) -> None:
    """Without a socket the error has the path that was tried."""
    with pytest.raises(EngineNotConnected, match=r"there is no .*/none\.sock"):
        DockerEngine(f"unix://{tmp_path}/none.sock").version()


def test_a_socket_without_a_server_has_its_own_error(tmp_path: Path) -> None:
    """A socket file that an engine left behind differs from a missing one."""
    left = socket.socket(socket.AF_UNIX)
    left.bind(str(tmp_path / "left.sock"))
    left.close()
    with pytest.raises(EngineNotConnected, match="no Docker Engine listens") as refused:
        DockerEngine(f"unix://{tmp_path}/left.sock").version()
    # A bind mount keeps the old file when the engine creates its socket again.
    assert str(refused.value).endswith("if it runs, its socket was created again, so restart PHM's container")


def test_a_forbidden_socket_names_the_required_group(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """For a denied permission the error has the remedy, not only an error number."""

    class Forbidden(socket.socket):
        def connect(self, address: object) -> None:
            raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("phm.transport.docker_http._Socket", Forbidden)
    with pytest.raises(EngineNotConnected, match="add the docker group with group_add") as refused:
        DockerEngine(f"unix://{tmp_path}/engine.sock").version()
    assert isinstance(refused.value, NoAccess)


def test_a_tcp_engine_without_a_server_is_unreachable() -> None:
    """TCP has the same deadline and the same error texts."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with pytest.raises(EngineTimeout):
            DockerEngine(f"tcp://127.0.0.1:{port}", timeout_s=0.3).version()
    with pytest.raises(EngineNotConnected, match=f"127.0.0.1:{port}"):
        DockerEngine(f"tcp://127.0.0.1:{port}", timeout_s=LONG_S).version()


def test_creating_the_client_sends_no_request(fake: FakeEngine) -> None:
    """PHM starts although the engine is down: the first request connects."""
    DockerEngine(fake.url)
    assert list(fake.calls) == []


@pytest.mark.parametrize(
    ("newest", "oldest", "spoken"), [("1.41", "1.24", "1.41"), ("1.54", "1.44", "1.44"), ("1.60", "1.50", "1.50")]
)
def test_the_api_version_suits_the_engine(tmp_path: Path, newest: str, oldest: str, spoken: str) -> None:
    """Requests to an old engine use its version, to a new one the newest that PHM knows and the engine supports."""
    with FakeEngine(tmp_path / "e.sock", api=newest, minimum=oldest) as fake:
        engine = DockerEngine(fake.url, timeout_s=LONG_S)
        assert engine.call(lambda client: client.api_version) == spoken


def test_a_proxy_that_hides_the_version_is_supported(fake: FakeEngine, ask: DockerEngine) -> None:
    """A socket proxy may allow only containers."""
    fake.containers["app"] = container("app")
    fake.fault = Status(403, route="/version")
    assert ask.inspect("app")["Name"] == "/app"


def test_a_restart_may_take_its_stop_timeout(fake: FakeEngine, ask: DockerEngine) -> None:
    """The deadline of a restart is longer than the stop timeout of the container."""
    fake.containers["app"] = container("app")
    ask.version()
    ask.timeout_s = HUNG_S
    fake.fault = Trickle(every_s=0.1, endless=False, route="/restart")  # an answer that takes longer than that
    before = fake.containers["app"]["State"]["StartedAt"]
    ask.restart("app", stop_timeout_s=60.0)
    assert fake.containers["app"]["State"]["StartedAt"] != before


def test_actions_change_the_container(fake: FakeEngine, ask: DockerEngine) -> None:
    """start, stop, pause, unpause, kill, connect and disconnect reach the engine with their arguments."""
    fake.containers["app"] = container("app", networks=["swarm"])
    state = fake.containers["app"]["State"]
    ask.pause("app")
    assert state["Status"] == "paused"
    ask.unpause("app")
    ask.start("app")
    ask.kill("app")
    assert state["ExitCode"] == 137
    ask.start("app")
    ask.stop("app", 0.5)
    assert state["Status"] == "exited"
    ask.disconnect("swarm", "app", force=True)
    ask.connect("swarm", "app", aliases=("nav",), addresses=("10.9.0.7", "fd00::7"))
    attached = fake.containers["app"]["NetworkSettings"]["Networks"]["swarm"]
    assert attached["Aliases"] == ["nav"]
    assert attached["IPAMConfig"] == {"IPv4Address": "10.9.0.7", "IPv6Address": "fd00::7"}


def test_a_file_is_read_up_to_its_limit(fake: FakeEngine, ask: DockerEngine) -> None:
    """Content comes through the archive route; a larger file is rejected before it is read."""
    content = os.urandom(300_000)
    fake.containers["app"] = container("app", files={"/opt/model": content})
    total = hashlib.sha256()
    assert ask.copy_file("app", "/opt/model", total.update, limit=1 << 20) == 300_000
    assert total.digest() == hashlib.sha256(content).digest()
    assert ask.stat_path("app", "/opt/model")["size"] == 300_000
    with pytest.raises(CannotTell, match="more than the 1000"):
        ask.read_file("app", "/opt/model", 1000)
    with pytest.raises(EngineMissing):
        ask.stat_path("app", "/opt/none")


def test_closing_an_event_stream_ends_it_immediately(fake: FakeEngine, ask: DockerEngine) -> None:
    """Another thread ends the reader of a silent stream."""
    stream = ask.events()
    seen: list[object] = []
    reader = threading.Thread(target=lambda: seen.extend(stream))
    reader.start()
    assert fake.wait(lambda engine: engine.streams == 1)
    stream.close()
    reader.join(60)
    assert not reader.is_alive()
    assert seen == []


def test_a_dropped_event_stream_ends_the_iteration(fake: FakeEngine, ask: DockerEngine) -> None:
    """The caller sees the end and reconnects; earlier events were delivered."""
    stream = ask.events()
    assert fake.wait(lambda engine: engine.streams == 1)
    fake.emit("container", "die", "x", name="app")
    iterator = iter(stream)
    assert next(iterator)["Action"] == "die"
    fake.fault = DropStream()
    assert list(iterator) == []


def test_opening_a_hung_event_stream_fails_at_the_deadline(fake: FakeEngine, ask: DockerEngine) -> None:
    """It has the deadline of a request."""
    ask.version()
    fake.fault, ask.timeout_s = Hang(route="/events"), HUNG_S
    with pytest.raises(EngineTimeout):
        ask.events()


def test_close_aborts_open_requests_and_rejects_new_ones(fake: FakeEngine) -> None:
    """PHM ends immediately although the engine hangs."""
    engine = DockerEngine(fake.url, timeout_s=60)
    fake.fault = Hang()
    caught: list[BaseException] = []

    def hang() -> None:
        try:
            engine.version()
        except CannotTell as error:
            caught.append(error)

    thread = threading.Thread(target=hang)
    thread.start()
    assert fake.wait(lambda server: bool(server.calls))
    engine.close()
    thread.join(60)
    assert len(caught) == 1
    with pytest.raises(EngineNotConnected, match="closing"):
        engine.version()


def test_a_socket_is_closed_at_its_deadline_and_not_before() -> None:
    """The watchdog follows the injected clock, and the socket of a finished request is never touched."""
    clock = FakeClock()
    watchdog = CallDeadlines(clock, "phm-test-deadlines")
    ours, theirs = socket.socketpair()
    done, other = socket.socketpair()
    with watchdog.watch(1.0) as early:
        early.attach(done)
    with watchdog.watch(5.0) as call:
        call.attach(ours)
        clock.wait_for_sleepers(1, LONG_S)
        clock.advance(4.9)
        clock.wait_for_sleepers(1, LONG_S)
        assert not call.expired
        clock.advance(0.2)
        assert theirs.recv(1) == b""
        assert call.expired
    done.send(b"x")
    assert other.recv(1) == b"x"
    watchdog.close()
    for end in (ours, theirs, done, other):
        end.close()
