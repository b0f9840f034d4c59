"""Responses of the Docker Engine, or of any other server on its socket: inspect, processes, events, tar, and HTTP itself."""

from __future__ import annotations

import base64
import contextlib
import json
import socket
import tarfile
import threading
from collections.abc import Callable, Iterator
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import strategies as st

from phm.facts import CannotTell, ContainerFact
from phm.probes.container_watcher import ContainerWatcher
from phm.probes.docker_event import DockerEvent
from phm.probes.docker_facts import container_fact
from phm.probes.docker_processes import processes
from phm.probes.docker_reconcile import ExpectedState, differences
from phm.testing import FakeClock, settings
from phm.transport.docker import DockerEngine
from phm.transport.docker_session import FAILURES
from phm.transport.docker_tar import MOST_HEADER, FileCopy, pack, unpack
from tests.fuzz.hostile import DEEP, JSON, corrupted, damaged, written
from tests.fuzz.targets import folder, fuzzed

ID = "ab" * 32
INSPECT = {
    "Id": ID, "Name": "/app", "Image": "sha256:1", "RestartCount": 1,
    "State": {
        "Status": "running", "StartedAt": "2026-11-21T10:00:00.5Z", "ExitCode": 0, "OOMKilled": False, "Error": "", "Pid": 7,
        "Health": {"Status": "healthy", "FailingStreak": 0, "Log": [{"Output": "fine"}]},
    },
    "HostConfig": {
        "NetworkMode": "net", "RestartPolicy": {"Name": "always"}, "Tmpfs": {"/tmp": ""}, "Privileged": False,
        "Devices": [{"PathOnHost": "/dev/a", "PathInContainer": "/dev/b", "CgroupPermissions": "rwm"}],
        "DeviceCgroupRules": ["c 1:1 rw"],
    },
    "NetworkSettings": {
        "Networks": {
            "net": {"NetworkID": "n1", "IPAddress": "10.0.0.2", "Gateway": "10.0.0.1", "Aliases": ["a"],
                    "IPAMConfig": {"IPv4Address": "10.0.0.2"}},
        }
    },
    "Mounts": [{"Type": "volume", "Source": "/s", "Destination": "/d", "Name": "v", "RW": True}],
    "Config": {"Labels": {"a": "b"}, "StopSignal": "SIGINT", "StopTimeout": 10,
               "Healthcheck": {"Test": ["CMD", "true"], "Interval": 30_000_000_000, "Retries": 3, "StartPeriod": 0}},
}  # fmt: skip
TOP = {
    "Titles": ["PID", "PPID", "STAT", "TIME", "ELAPSED", "COMMAND"],
    "Processes": [["7", "1", "S", "1", "2", "sleep 1"]],
}
EVENT = {
    "Type": "container", "Action": "health_status: healthy", "timeNano": 1_800_000_000_000_000_000,
    "Actor": {"ID": ID, "Attributes": {"name": "app", "exitCode": "1", "signal": "15", "container": ID}},
}  # fmt: skip
NETWORK_EVENT = {
    **EVENT,
    "Type": "network",
    "Action": "disconnect",
    "Actor": {"ID": "n1", "Attributes": EVENT["Actor"]["Attributes"]},
}  # type: ignore[index]
STAT = {"name": "f", "size": 3, "mode": 0o644, "mtime": "2026-11-21T10:00:00Z", "linkTarget": ""}
TAR = pack("folder/file", FileCopy(b"words" * 300, 0o755, 1, 2), 1_800_000_000.0)


@fuzzed("inspect", answer=damaged(INSPECT) | JSON)
def test_any_inspect_response_is_a_fact_or_none(answer: Any) -> None:
    """A fact whose parts have their types, or CannotTell; and the comparison of two states accepts it."""
    if not isinstance(answer, dict):
        return  # the client accepts only objects
    with contextlib.suppress(CannotTell):
        fact = container_fact(answer)
        assert isinstance(fact, ContainerFact)
        assert all(isinstance(text, str) for text in (fact.id, fact.name, fact.status, fact.health, fact.network_mode))
        assert isinstance(fact.exit_code, int)
        hash(fact)
        differences(ExpectedState.of(container_fact(INSPECT)), ExpectedState.of(fact))


FOUND: list[dict[str, Any]] = [
    {**INSPECT, "HostConfig": {"DeviceCgroupRules": True}},
    {**INSPECT, "NetworkSettings": {"Networks": {"net": {"Aliases": 7}}}},
]
"""What made it stumble once."""


@pytest.mark.parametrize("answer", FOUND)
def test_invalid_lists_are_empty(answer: dict[str, Any]) -> None:
    """In a part of the response that is not needed."""
    assert container_fact(answer).id == ID


@pytest.mark.parametrize("answer", [{**TOP, "Processes": 7}, {**TOP, "Titles": ["PID", []]}])
def test_a_process_list_of_another_shape_is_rejected(answer: dict[str, Any]) -> None:
    """With CannotTell, as any invalid response."""
    with pytest.raises(CannotTell):
        processes(answer)


@fuzzed("process list", answer=damaged(TOP) | JSON)
def test_any_process_list_is_facts_or_none(answer: Any) -> None:
    """Invalid numbers, rows of another length, titles that are not a list."""
    if isinstance(answer, dict):
        with contextlib.suppress(CannotTell):
            assert all(fact.pid > 0 for fact in processes(answer))


@fuzzed("events", said=st.lists(st.sampled_from([EVENT, NETWORK_EVENT]).flatmap(damaged) | JSON, max_size=6))
def test_any_event_is_published_or_ignored(said: list[Any]) -> None:
    """A published event is about a configured container or network, and memory stays bounded."""
    published: list[DockerEvent] = []
    chosen = settings(containers=[{"name": "app", "networks": ["net"]}, {"label": "a=b"}])
    watch = ContainerWatcher(
        cast(DockerEngine, SimpleNamespace(timeout_s=1.0)),
        chosen.containers,
        chosen.docker,
        FakeClock(),
        published.append,
    )
    for raw in said:
        if isinstance(raw, dict):
            event = watch._decoder.decode(raw)
            assert event is None or (isinstance(str(event), str) and event.subjects)


class _Pieces:
    """The part of a response that the tar reader uses."""

    def __init__(self, data: bytes, size: int) -> None:
        self._data, self._size = data, size

    def iter_content(self, size: int) -> Iterator[bytes]:
        for at in range(0, len(self._data), self._size):
            yield self._data[at : at + self._size]


@fuzzed("tar", data=corrupted(TAR) | st.binary(max_size=2000), size=st.sampled_from([1, 100, 512, 65536]))
def test_any_tar_is_one_file_or_a_failure(data: bytes, size: int) -> None:
    """Never more than the limit, and only failures that the client explains."""
    taken = bytearray()
    with contextlib.suppress(CannotTell, *FAILURES):
        member = unpack(cast(Any, _Pieces(data, size)), taken.extend, "a file", 2000)
        assert len(taken) == member.size
    assert len(taken) <= 2000


def test_an_extended_header_without_an_end_is_not_kept_in_memory() -> None:
    """Whatever size it states: the reader stops behind the largest header, not at the end of the response."""
    header = tarfile.TarInfo("f")
    header.type, header.size = tarfile.XHDTYPE, 8 << 30
    sent = 0

    def endless(size: int) -> Iterator[bytes]:
        nonlocal sent
        yield header.tobuf(tarfile.GNU_FORMAT)
        while sent < 10 * MOST_HEADER:
            sent += size
            yield bytes(size)

    with pytest.raises(CannotTell, match="a file has a header of more than 1048576 bytes"):
        unpack(cast(Any, SimpleNamespace(iter_content=endless)), bytearray().extend, "a file", 1000)
    assert sent < 2 * MOST_HEADER


def test_a_file_larger_than_the_largest_header_is_read() -> None:
    """The limit is that of the header alone; a long path has an extended one."""
    data, taken = bytes(3 * MOST_HEADER), bytearray()
    tar = pack("folder/" * 50 + "file", FileCopy(data, 0o755, 1, 2), 1_800_000_000.0)
    unpack(cast(Any, _Pieces(tar, 65536)), taken.extend, "a file", len(data))
    assert taken == data


def _http(body: bytes, *headers: str, status: str = "200 OK") -> bytes:
    lines = [f"HTTP/1.1 {status}", f"Content-Length: {len(body)}", *headers]
    return "\r\n".join(lines).encode() + b"\r\n\r\n" + body


_STAT_HEADER = "X-Docker-Container-Path-Stat: " + base64.b64encode(json.dumps(STAT).encode()).decode()
_CHUNKED = b'HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n4\r\n{"a"\r\n3\r\n:1}\r\n0\r\n\r\n'
VALID = [
    _http(json.dumps(INSPECT).encode(), "Content-Type: application/json"), _http(json.dumps(TOP).encode()), _http(TAR),
    _http(b"", _STAT_HEADER), _http(b'{"message": "no"}', status="404 Not Found"), _CHUNKED,
    _http(json.dumps(EVENT).encode() + b"\n"), _http(b"[]"), _http(b'{"Id": "ab"}', status="201 Created"),
]  # fmt: skip


class _FakeServer:
    """Listens in place of the engine and sends the same response to every request."""

    def __init__(self) -> None:
        self.says = b""
        self.path = f"{folder()}/engine.sock"
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(self.path)
        self._listener.listen(16)
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            peer, _ = self._listener.accept()
            with peer, contextlib.suppress(OSError):
                peer.settimeout(10)
                peer.recv(1 << 16)
                peer.sendall(self.says)


@cache
def _fake_server() -> tuple[_FakeServer, DockerEngine]:
    made = _FakeServer()
    return made, DockerEngine(f"unix://{made.path}", timeout_s=20)


@pytest.mark.parametrize("says", [_http(b"[1]"), _http(DEEP[0])])
def test_a_response_that_is_not_an_object_is_an_error_of_the_engine(says: bytes) -> None:
    """It does not reach the check, nor does one that is nested too deeply to be parsed."""
    server, engine = _fake_server()
    server.says = says
    for ask in (engine.inspect, engine.inspect_network, engine.top):
        with pytest.raises(CannotTell):
            ask("app")
    with pytest.raises(CannotTell):
        engine.list()


def _events(engine: DockerEngine) -> object:
    with engine.events() as stream:
        return list(stream)


CALLS: list[Callable[[DockerEngine], object]] = [
    lambda engine: engine.inspect("app"), lambda engine: engine.inspect_network("net"), lambda engine: engine.top("app"),
    lambda engine: engine.list(label="a"), lambda engine: engine.stat_path("app", "/f"), DockerEngine.version,
    lambda engine: engine.read_file("app", "/f", 2000), _events, lambda engine: engine.restart("app", 1.0),
    lambda engine: engine.exec_detached("app", ["true"]), lambda engine: engine.connect("net", "app"),
]  # fmt: skip


@fuzzed(
    "HTTP of the engine",
    says=st.sampled_from(VALID).flatmap(corrupted)
    | damaged(INSPECT).map(written).map(_http)
    | damaged(STAT).map(
        lambda stat: _http(b"", f"X-Docker-Container-Path-Stat: {base64.b64encode(written(stat)[:9000]).decode()}")
    )
    | st.sampled_from(DEEP).map(_http)
    | st.binary(max_size=300),
    call=st.sampled_from(range(len(CALLS))),
)
def test_any_response_ends_as_a_value_or_an_error_of_the_engine(says: bytes, call: int) -> None:
    """One of the exceptions that checks and recovery know."""
    server, engine = _fake_server()
    server.says = says
    with contextlib.suppress(CannotTell):
        CALLS[call](engine)
