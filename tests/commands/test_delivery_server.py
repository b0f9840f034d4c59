"""The port for configurations: real sockets, and a sender without the key gets nothing but a refusal."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from phm.commands import delivery_server
from phm.commands.delivery_server import MAX_CLIENTS, MAX_SAME, DeliveryServer
from phm.core.clock import SystemClock
from phm.core.rate_limiter import RateLimiter
from phm.gcs import delivery_client
from phm.gcs.delivery_client import DeliveryFailed
from phm.wire import delivery as wire
from phm.wire.delivery import DeliveryAnswer
from tests.fakes.until import until

KEY, OTHER = bytes(range(32)), bytes(32)
BASE, TEXT = wire.version_of("old"), "agent: {id: 1}\n"
LIMIT_S = 60.0


class Bench:
    """A server of agent A07, and what it executed."""

    def __init__(self) -> None:
        self.executed: list[tuple[str, str, str]] = []
        self.notes: list[str] = []
        self.go, self.broken = threading.Event(), False
        self.go.set()
        self.server = DeliveryServer(("127.0.0.1", 0), KEY, "A07", SystemClock(), self._execute, self.notes.append)
        self.server.start()
        until(lambda: self.server.address is not None, "the port")

    def _execute(self, text: str, base: str, who: str) -> DeliveryAnswer:
        self.executed.append((text, base, who))
        assert self.go.wait(LIMIT_S)
        if self.broken:
            raise ValueError("a secret")
        return DeliveryAnswer(True, "configuration reloaded: interval", wire.version_of(text))

    @property
    def where(self) -> tuple[str, int]:
        assert self.server.address is not None
        return self.server.address

    def deliver(self, key: bytes = KEY, text: str = TEXT) -> DeliveryAnswer:
        agent, answer = delivery_client.deliver(self.where, key, text, BASE)
        assert agent == "A07"
        return answer

    def connect(self) -> socket.socket:
        stream = socket.create_connection(self.where, LIMIT_S)
        stream.settimeout(LIMIT_S)
        return stream

    def say(self, data: bytes, client: socket.socket | None = None) -> str:
        """The text of the answer to these bytes."""
        with client or self.connect() as stream:
            if client is None:
                _line(stream)
            stream.sendall(data)
            return str(json.loads(json.loads(_line(stream))["answer"])["text"])


def _line(stream: socket.socket) -> bytes:
    data = b""
    while not data.endswith(b"\n"):
        more = stream.recv(1)
        if not more:
            raise ConnectionError(f"closed after {data!r}")
        data += more
    return data


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    for name in ("REQUEST_S", "BODY_S", "ANSWER_S"):
        monkeypatch.setattr(delivery_server, name, LIMIT_S)
    monkeypatch.setattr(delivery_server, "BURST", 1000.0)
    monkeypatch.setattr(delivery_server, "NOTE_RATE", 1e-9)
    made = Bench()
    yield made
    made.go.set()
    made.server.close()


def _signed(stream: socket.socket, key: bytes = KEY, text: str = TEXT, **changed: Any) -> bytes:
    """A request that fits what the agent has just said, with some of its fields changed after it was signed."""
    _, data = wire.request(wire.read_hello(_line(stream)), BASE, text, key)
    head, _, body = data.partition(b"\n")
    return json.dumps({**json.loads(head), **changed}).encode() + b"\n" + body


def test_the_operators_configuration_is_executed_and_the_answer_is_the_agents(bench: Bench) -> None:
    """Text, base and sender arrive, and the answer proves that the agent has the key."""
    answer = bench.deliver()
    assert (answer.ok, answer.text, answer.present, answer.trusted) == (
        True,
        "configuration reloaded: interval",
        wire.version_of(TEXT),
        True,
    )
    assert bench.executed == [(TEXT, BASE, "127.0.0.1")]


def test_another_key_is_refused_before_the_configuration_is_read(bench: Bench) -> None:
    """Nothing is executed, the log says who tried, and the answer says what is wrong."""
    answer = bench.deliver(OTHER)
    assert not answer.ok and not answer.trusted and "key" in answer.text
    assert bench.executed == []
    assert answer.text.startswith(
        "response not authenticated with the key; it may not be from the agent: the key is not this agent's"
    )
    assert bench.notes == [f"a configuration from 127.0.0.1 was refused: {answer.text.partition(': ')[2]}"]


def test_a_recorded_request_is_refused_later(bench: Bench) -> None:
    """Each connection has another nonce, so a recording fits none."""
    with bench.connect() as stream:
        recorded = _signed(stream)
        assert "reloaded" in bench.say(recorded, stream)
    assert "replayed" in bench.say(recorded)
    assert len(bench.executed) == 1


@pytest.mark.parametrize("field", ["base", "sha256", "nonce", "size"])
def test_a_request_that_was_changed_on_its_way_is_refused(bench: Bench, field: str) -> None:
    """The signature covers all fields, so no one can exchange the configuration or what it replaces."""
    with bench.connect() as stream:
        changed = _signed(stream, KEY, TEXT, **{field: 7 if field == "size" else "ab" * 32})
        assert "key" in bench.say(changed, stream)
    assert bench.executed == []


def test_a_configuration_that_was_changed_on_its_way_is_refused(bench: Bench) -> None:
    """Its SHA-256 is in the signed request."""
    with bench.connect() as stream:
        data = _signed(stream)
        assert "altered in transit" in bench.say(data[:-2] + b"2}", stream)
    assert bench.executed == []


def test_another_agents_request_is_refused(bench: Bench) -> None:
    """Agents may have the same key, so the request is bound to the name that the agent said."""
    with bench.connect() as stream:
        said = wire.read_hello(_line(stream))
        _, data = wire.request(wire.Hello("A08", said.nonce), BASE, TEXT, KEY)
        assert "key" in bench.say(data, stream)
    assert bench.executed == []


def test_the_largest_configuration_arrives_complete(bench: Bench) -> None:
    """The server reads more than it holds at a time."""
    text = "é" * (wire.MAX_SIZE // 2)
    assert bench.deliver(text=text).ok
    assert bench.executed[0][0] == text


def test_a_configuration_that_is_too_large_is_refused(bench: Bench) -> None:
    """Before it is read; the operator's own end does not even send it."""
    with bench.connect() as stream:
        request, data = wire.request(wire.read_hello(_line(stream)), BASE, "#" * (wire.MAX_SIZE + 1), KEY)
        head = data.partition(b"\n")[0] + b"\n"
        stream.sendall(head)
        answer = wire.read_answer(_line(stream), request, KEY)
    assert not answer.ok and answer.trusted and str(wire.MAX_SIZE) in answer.text
    with pytest.raises(DeliveryFailed, match="not sent"):
        bench.deliver(text="#" * (wire.MAX_SIZE + 1))
    assert bench.executed == []


@pytest.mark.parametrize(
    "data", [b"GET / HTTP/1.1\r\n\r\n", b"\n", b"[]\n", b"\xff\n", b"[" * 1000 + b"\n", b"x" * 5000, b'{"v": 1}\n']
)
def test_anything_else_is_refused(bench: Bench, data: bytes) -> None:
    """With a sentence, and the next one is served."""
    assert "phm deliver" in bench.say(data)
    assert bench.deliver().ok


def test_a_slow_sender_is_disconnected(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a request, and with the key but without the configuration."""
    monkeypatch.setattr(delivery_server, "REQUEST_S", 0.2)
    assert "no request within" in bench.say(b"")
    monkeypatch.setattr(delivery_server, "REQUEST_S", LIMIT_S)
    monkeypatch.setattr(delivery_server, "BODY_S", 0.2)
    with bench.connect() as stream:
        assert "did not arrive" in bench.say(_signed(stream)[:-1], stream)
    assert bench.executed == []
    monkeypatch.setattr(delivery_server, "BODY_S", LIMIT_S)
    assert bench.deliver().ok


def test_a_second_one_at_the_same_time_is_refused(bench: Bench) -> None:
    """Until the first one is done."""
    bench.go.clear()
    first: list[DeliveryAnswer] = []
    thread = threading.Thread(target=lambda: first.append(bench.deliver()), daemon=True)
    thread.start()
    until(lambda: bench.executed, "the first one")
    second = bench.deliver()
    assert not second.ok and second.trusted and "another configuration" in second.text
    bench.go.set()
    thread.join(LIMIT_S)
    assert first[0].ok and len(bench.executed) == 1
    assert bench.deliver().ok


def test_a_sender_that_ends_does_not_end_its_delivery(bench: Bench) -> None:
    """What has begun is finished, and the next one is served."""
    bench.go.clear()
    with bench.connect() as stream:
        stream.sendall(_signed(stream))
        until(lambda: bench.executed, "the execution")
    bench.go.set()
    until(lambda: bench.deliver().ok, "the next one")


def test_silent_connections_keep_no_one_out(bench: Bench) -> None:
    """Those of one address are limited, and of many addresses the oldest ones give way."""
    with contextlib.ExitStack() as stack:
        held = [stack.enter_context(bench.connect()) for _ in range(MAX_SAME)]
        for each in held:
            _line(each)
        with pytest.raises(DeliveryFailed, match="too many connections"):
            bench.deliver()
        for number in range(2, 2 + MAX_CLIENTS):
            other = stack.enter_context(socket.socket())
            other.settimeout(LIMIT_S)
            other.bind((f"127.0.0.{number}", 0))
            other.connect(bench.where)
            _line(other)
        assert held[0].recv(1) == b"", "the oldest one is disconnected"
        assert bench.deliver().ok


def test_senders_and_lines_in_the_log_are_limited(bench: Bench) -> None:
    """A sender that guesses keys waits, and cannot fill the log."""
    bench.server._rate = RateLimiter(1e-9, 10.0, 4)
    for _ in range(10):
        assert not bench.deliver(OTHER).ok
    with pytest.raises(DeliveryFailed, match="too many connections"):
        bench.deliver(OTHER)
    assert len(bench.notes) == 3


def test_an_answer_of_someone_without_the_key_is_never_a_success() -> None:
    """A program that took the agent's address cannot say that it is done."""
    said, _ = wire.hello("A07")
    request, _ = wire.request(said, BASE, TEXT, KEY)
    good = DeliveryAnswer(True, "done", BASE)
    assert wire.read_answer(wire.answer_line(good, KEY, request), request, KEY).ok
    for line in (wire.answer_line(good), wire.answer_line(good, OTHER, request)):
        got = wire.read_answer(line, request, KEY)
        assert not got.ok and got.text == "response not authenticated with the key; it may not be from the agent: done"
    before, _ = wire.request(said, BASE, TEXT, KEY)
    assert not wire.read_answer(wire.answer_line(good, KEY, before), request, KEY).ok, "an answer to another request"


def test_a_failure_inside_is_answered_without_its_reason(bench: Bench) -> None:
    """The reason is for the log of the agent."""
    bench.broken = True
    answer = bench.deliver()
    assert not answer.ok and "secret" not in answer.text
    bench.broken = False
    assert bench.deliver().ok


def test_a_port_in_use_is_a_problem_until_it_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM works without it, and tries again."""
    monkeypatch.setattr(delivery_server, "RETRY_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = taken.getsockname()[:2]
        server = DeliveryServer(where, KEY, "A07", SystemClock(), lambda *_: DeliveryAnswer(True, ""), lambda _: None)
        server.start()
        until(lambda: "phm deliver" in server.problem(), "the problem")
    until(lambda: server.problem() == "" and server.address == where, "the port")
    server.close()


def test_something_else_at_the_agents_port_is_named() -> None:
    """A web server, for example, and a port without a listener."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        where = other.getsockname()[:2]

        def answer() -> None:
            client, _ = other.accept()
            with client:
                client.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        with pytest.raises(DeliveryFailed, match="not PHM's port"):
            delivery_client.deliver(where, KEY, TEXT, BASE)
        thread.join(LIMIT_S)
    with pytest.raises(DeliveryFailed, match="refused"):
        delivery_client.deliver(where, KEY, TEXT, BASE)
