"""The endpoints against real peers: every kind of connection transfers every frame, and none delays another."""

from __future__ import annotations

import contextlib
import os
import pty
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from phm.core.clock import SystemClock
from phm.core.settings import MavlinkSettings
from phm.facts import LinkFact
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from tests.fakes.mavlink import Sender, free_port, heartbeat, text
from tests.fakes.until import until

WORD = 0x40025D55
MakeHub = Callable[..., MavlinkHub]


@pytest.fixture
def make_hub() -> Iterator[MakeHub]:
    """Create hubs of system 7, component 193 with the given endpoint URLs, started, and closed at the end."""
    hubs: list[MavlinkHub] = []

    def make(*urls: str) -> MavlinkHub:
        hub = MavlinkHub(
            MavlinkSettings.model_validate({"endpoints": [{"url": url, "budget": 0} for url in urls]}), 7, SystemClock()
        )
        hub.received = []  # type: ignore[attr-defined]
        hub.listen(lambda message, link: hub.received.append((message, link)), (0, 253))  # type: ignore[attr-defined]
        hubs.append(hub)
        hub.start()
        return hub

    yield make
    for hub in hubs:
        hub.close()


@pytest.fixture
def serial_pair() -> Iterator[tuple[int, str]]:
    """A pseudo terminal: the descriptor of the far end and the path that PHM opens."""
    far, near = pty.openpty()
    tty.setraw(far)
    tty.setraw(near)
    path = os.ttyname(near)
    os.close(near)
    yield far, path
    with contextlib.suppress(OSError):
        os.close(far)


class SerialPeer:
    """The far end of a pseudo terminal as a pymavlink connection, since mavutil insists on opening a path itself."""

    def __init__(self, fd: int) -> None:
        os.set_blocking(fd, False)
        self._fd, self.mav = fd, mavutil.mavlink.MAVLink(self, 255, 190)
        self.mav.robust_parsing = True
        self._waiting: list[Any] = []

    def write(self, data: bytes) -> None:
        os.write(self._fd, data)

    def recv_msg(self) -> Any:
        with contextlib.suppress(OSError):
            self._waiting += self.mav.parse_buffer(os.read(self._fd, 4096)) or []
        return self._waiting.pop(0) if self._waiting else None

    def close(self) -> None:
        """The descriptor belongs to the fixture."""


def connect(url: str) -> Any:
    return mavutil.mavlink_connection(url, source_system=255, source_component=190, dialect="common")


def exchange(hub: MavlinkHub, peer: Any) -> list[Any]:
    """Wait until the peer is received, send a HEARTBEAT and a STATUSTEXT, and return the frames that the peer decoded."""

    def speak() -> bool:
        peer.mav.heartbeat_send(6, 8, 0, 0, 4)
        peer.recv_msg()
        return bool(hub.received)  # type: ignore[attr-defined]

    until(speak, "the peer to be received")
    hub.send(heartbeat(WORD))
    hub.send(text("A07 FAIL 6 node_1 dead", 2))
    found: dict[str, Any] = {}

    def received() -> bool:
        message = peer.recv_msg()
        if message is not None and message.get_srcSystem() == 7:
            found[message.get_type()] = message
        return len(found) == 2

    until(received, "both messages")
    return [found["HEARTBEAT"], found["STATUSTEXT"]]


def assert_contract(hub: MavlinkHub, messages: list[Any]) -> None:
    """Assert the contract of docs/reference/mavlink.md on the wire."""
    beat, line = messages
    for message in messages:
        assert (message.get_srcSystem(), message.get_srcComponent(), message.get_msgbuf()[0]) == (7, 193, 0xFD)
    assert (beat.custom_mode, beat.type, beat.autopilot) == (WORD, 18, 8)
    assert (line.severity, line.text, line.id, line.chunk_seq) == (2, "A07 FAIL 6 node_1 dead", 0, 0)
    assert line.get_seq() == beat.get_seq() + 1
    (counters,) = hub.counters().values()
    until(lambda: counters.sent >= 2)
    assert counters.received >= 1
    assert all(fact.open and not fact.error for fact in hub.links())


@pytest.mark.parametrize(
    ("ours", "theirs", "they_first"),
    [
        ("udpout:127.0.0.1:{}", "udpin:127.0.0.1:{}", True),
        ("udpin:127.0.0.1:{}", "udpout:127.0.0.1:{}", False),
        ("tcp:127.0.0.1:{}", "tcpin:127.0.0.1:{}", True),
        ("tcpin:127.0.0.1:{}", "tcp:127.0.0.1:{}", False),
        ("udpbcast:127.255.255.255:{}", "udpin:0.0.0.0:{}", True),
    ],
)
def test_a_pymavlink_peer_reads_what_is_sent(make_hub: MakeHub, ours: str, theirs: str, they_first: bool) -> None:
    """UDP and TCP in both directions: identity, wire version 2, status word, severity and text arrive."""
    port = free_port(socket.SOCK_DGRAM if ours.startswith("udp") else socket.SOCK_STREAM)
    peer = connect(theirs.format(port)) if they_first else None
    hub = make_hub(ours.format(port))
    until(lambda: any(fact.open for fact in hub.links()), "the endpoint opening")
    if they_first:
        # A peer that only listens on UDP answers its last sender.
        hub.send(heartbeat(1))
    peer = peer or connect(theirs.format(port))
    try:
        assert_contract(hub, exchange(hub, peer))
    finally:
        peer.close()


def test_a_serial_peer_reads_what_is_sent(make_hub: MakeHub, serial_pair: tuple[int, str]) -> None:
    """A serial line transfers the same frames."""
    far, path = serial_pair
    hub = make_hub(path)
    assert_contract(hub, exchange(hub, SerialPeer(far)))


def test_a_restarted_tcp_server_is_reconnected(make_hub: MakeHub) -> None:
    """The link is reported closed with a reason and reopened, without affecting another endpoint."""
    tcp, udp = free_port(), free_port(socket.SOCK_DGRAM)
    other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    other.bind(("127.0.0.1", udp))
    other.settimeout(60.0)
    hub = make_hub(f"tcp:127.0.0.1:{tcp}", f"udpout:127.0.0.1:{udp}")
    for _ in range(2):
        with socket.create_server(("127.0.0.1", tcp)) as server:
            server.settimeout(60.0)
            client, _ = server.accept()
            until(lambda: bool(hub.links()) and hub.links()[0].open)
            client.close()
        fact = until(lambda: [link for link in hub.links() if not link.open])[0]
        assert (fact.name, bool(fact.error)) == (f"tcp:127.0.0.1:{tcp}", True)
        hub.send(text("still here"))
        assert b"still here" in other.recv(300)
    other.close()


def test_a_serial_port_that_disappears_is_reopened(make_hub: MakeHub, tmp_path: Path) -> None:
    """An unplugged adapter is a closed link; plugged in again it works without intervention."""
    path = tmp_path / "ttyRADIO"
    hub = make_hub(str(path))
    fact = until(hub.links)[0]
    assert not fact.open
    assert "No such file" in fact.error
    for _ in range(2):
        far, near = pty.openpty()
        tty.setraw(far)
        path.symlink_to(os.ttyname(near))
        os.close(near)
        until(lambda: hub.links()[0].open, "the port opening")
        path.unlink()
        os.close(far)
        until(lambda: not hub.links()[0].open, "the loss of the port being seen")


def test_a_serial_port_is_opened_below_the_mount_of_the_hosts_devices(tmp_path: Path) -> None:
    """A container without the device in `devices` has it there alone, and its `device_cgroup_rules` permit opening it."""
    far, near = pty.openpty()
    (tmp_path / "phm-no-such-port").symlink_to(os.ttyname(near))
    entry = {"url": "/dev/phm-no-such-port"}
    hub = MavlinkHub(MavlinkSettings.model_validate({"endpoints": [entry]}), 7, SystemClock(), dev_root=str(tmp_path))
    hub.start()
    until(lambda: hub.links() and hub.links()[0].open, "the port opening")
    hub.close()
    os.close(far)
    os.close(near)


@contextlib.contextmanager
def silent_server() -> Iterator[int]:
    """A loopback port on which connecting hangs: the queue of a server that never accepts is full."""
    with socket.socket() as server, contextlib.ExitStack() as clients:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        for _ in range(4):
            client = clients.enter_context(socket.socket())
            client.setblocking(False)
            client.connect_ex(server.getsockname())
        yield server.getsockname()[1]


def test_a_hanging_connection_delays_no_other(make_hub: MakeHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """While one endpoint waits for an answer that never arrives, another sends and the hub still closes immediately."""
    # A busy machine may exceed the usual limit.
    monkeypatch.setattr("phm.transport.mavlink_connection.CONNECT_LIMIT_S", 3600.0)
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", 0))
    udp.settimeout(60.0)
    with silent_server() as port:
        hub = make_hub(f"tcp:127.0.0.1:{port}", f"udpout:127.0.0.1:{udp.getsockname()[1]}")
        for number in range(500):
            hub.send(text(f"line {number}"))
        assert b"line" in udp.recv(300)
        assert [fact.name for fact in hub.links()] == [f"udpout:127.0.0.1:{udp.getsockname()[1]}"]
        hub.close()
        name = f"phm-mavlink-tcp:127.0.0.1:{port}"
        until(lambda: not any(each.name.startswith(name) for each in threading.enumerate()), "the end of its thread")
    udp.close()


def test_a_hanging_name_server_delays_no_other_endpoint(make_hub: MakeHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """A lookup without an answer delays only its endpoint; a late answer is used."""
    # A busy machine may exceed the usual limit.
    monkeypatch.setattr("phm.transport.mavlink_connection.RESOLVE_LIMIT_S", 3600.0)
    real, release = socket.getaddrinfo, threading.Event()

    def slow(host: str, *rest: Any, **named: Any) -> Any:
        if host == "radio" and not named.get("flags"):
            release.wait(120.0)
            host = "127.0.0.1"
        return real(host, *rest, **named)

    monkeypatch.setattr(socket, "getaddrinfo", slow)
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", 0))
    udp.settimeout(60.0)
    port = udp.getsockname()[1]
    hub = make_hub(f"udpout:radio:{port}", f"udpout:127.0.0.1:{port}")
    hub.send(text("by address"))
    assert b"by address" in udp.recv(300)
    assert [fact.name for fact in hub.links()] == [f"udpout:127.0.0.1:{port}"]
    release.set()
    until(lambda: len(hub.links()) == 2 and all(fact.open for fact in hub.links()))
    udp.close()


def test_a_host_name_may_appear_later(make_hub: MakeHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """A container that is started after PHM is found once its name resolves; until then the link reports the missing
    name.
    """
    real, known = socket.getaddrinfo, threading.Event()

    def names(host: str, *rest: Any, **named: Any) -> Any:
        if host == "autopilot":
            if not known.is_set():
                raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
            host = "127.0.0.1"
        return real(host, *rest, **named)

    monkeypatch.setattr(socket, "getaddrinfo", names)
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", 0))
    udp.settimeout(60.0)
    hub = make_hub(f"udpout:autopilot:{udp.getsockname()[1]}")
    (fact,) = until(hub.links)
    assert not fact.open
    assert "autopilot" in fact.error
    hub.send(text("sent before the name was known"))
    known.set()
    assert b"sent before" in udp.recv(300)
    until(lambda: hub.links()[0] == LinkFact(fact.name, open=True))
    udp.close()


def test_a_client_that_does_not_read_loses_only_its_own_frames(make_hub: MakeHub) -> None:
    """A hanging ground station must not delay the others."""
    port = free_port()
    hub = make_hub(f"tcpin:127.0.0.1:{port}")
    until(hub.links)
    with socket.socket() as stuck, socket.create_connection(("127.0.0.1", port)) as reader:
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        stuck.connect(("127.0.0.1", port))
        (counters,) = hub.counters().values()
        reader.settimeout(60.0)
        got = bytearray()

        def arrived() -> bool:
            for _ in range(50):
                hub.send(text("x" * 50))
            got.extend(reader.recv(65536))
            return counters.dropped > 0 and b"at last" in got

        def lost() -> bool:
            hub.send(text("at last"))
            return arrived()

        until(lost, "the stuck client losing frames while the other reads")


def test_udp_answers_only_peers_that_send_mavlink(make_hub: MakeHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise does not make a peer, a frame does; at most 8 of one address and 16 in all; a new address is still
    admitted.
    """
    # On a busy machine the usual time may pass between two frames.
    monkeypatch.setattr("phm.transport.client_admission.IDLE_S", 3600.0)
    port = free_port(socket.SOCK_DGRAM)
    hub = make_hub(f"udpin:127.0.0.1:{port}")
    until(hub.links)
    frame = Sender(255, 190).frame(heartbeat())
    with contextlib.ExitStack() as stack:
        peers = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(21)]
        for number, peer in enumerate(peers):
            peer.setblocking(False)
            peer.bind((f"127.0.0.{2 + (number > 10) + (number > 19)}", 0))
            peer.connect(("127.0.0.1", port))
        peers[0].send(b"\xfd\x09garbage" * 9)
        peers[1].send(frame[:-1])
        for peer in peers[2:]:
            peer.send(frame)
        until(lambda: len(hub.received) == 19)  # type: ignore[attr-defined]
        hub.send(text("hello"))
        reached: set[int] = set()

        def all_reached() -> bool:
            # A frame counts as sent before it was sent to the last of the peers.
            reached.update(number for number, peer in enumerate(peers) if _read(peer))
            return len(reached) >= 16

        until(all_reached)
        # The only peer of its address, the last one, has displaced the newest of the crowd.
        assert reached == {*range(2, 9), *range(11, 19), 20}


def test_a_frame_to_two_peers_counts_twice(make_hub: MakeHub) -> None:
    """The bytes of an endpoint are what its network carries."""
    port = free_port(socket.SOCK_DGRAM)
    hub = make_hub(f"udpin:127.0.0.1:{port}")
    until(hub.links)
    with contextlib.ExitStack() as stack:
        peers = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)]
        for peer in peers:
            peer.settimeout(60.0)
            peer.sendto(Sender(255, 190).frame(heartbeat()), ("127.0.0.1", port))
        until(lambda: len(hub.received) == 2)  # type: ignore[attr-defined]
        hub.send(text("hello"))
        size = sum(len(peer.recv(300)) for peer in peers)
        (counters,) = hub.counters().values()
        until(lambda: counters.bytes_out)
        assert (counters.sent, counters.bytes_out) == (1, size)


def _read(sock: socket.socket) -> bytes:
    try:
        return sock.recv(300)
    except BlockingIOError:
        return b""


def test_a_failing_listener_does_not_close_the_link(make_hub: MakeHub) -> None:
    """A defect in a probe or reporter affects nothing else."""

    def broken(message: Any, link: str) -> None:
        raise RuntimeError("a defect")

    port = free_port(socket.SOCK_DGRAM)
    hub = make_hub(f"udpin:127.0.0.1:{port}")
    hub.listen(broken, (0,))
    until(hub.links)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        for count in (1, 2):
            peer.sendto(Sender(255, 190).frame(heartbeat()), ("127.0.0.1", port))
            until(lambda wanted=count: len(hub.received) == wanted)  # type: ignore[attr-defined, misc]
    assert hub.links()[0].open


def test_an_unreachable_network_is_a_closed_link_until_a_frame_is_sent(make_hub: MakeHub) -> None:
    """A UDP socket can always be opened, which proves nothing: the link must not look open between failures."""
    # The kernel rejects this address for a socket without SO_BROADCAST, like any address without a route.
    hub = make_hub("udpout:255.255.255.255:9")
    until(hub.links)
    states: list[bool] = []
    hub.watch(lambda: states.append(hub.links()[0].open))
    hub.send(text("to no peer"))
    until(lambda: len(states) >= 4 and states[-1] is False, "several attempts")
    assert hub.links()[0].error == "Permission denied"
    assert True not in states[states.index(False) :]


def test_ground_stations_are_monitored_while_a_link_is_busy(make_hub: MakeHub) -> None:
    """A link that is never idle must not delay the detection of a lost ground station."""
    port = free_port(socket.SOCK_DGRAM)
    hub = make_hub(f"udpin:127.0.0.1:{port}")
    until(hub.links)
    looks: list[int] = []
    hub.watch(lambda: looks.append(1))
    frame = Sender(7, 1).frame(heartbeat())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:

        def busy() -> bool:
            peer.sendto(frame, ("127.0.0.1", port))
            return len(looks) >= 2

        until(busy)


def test_close_sends_queued_messages(make_hub: MakeHub) -> None:
    """The final heartbeat, queued just before, reaches the ground."""
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", 0))
    udp.settimeout(60.0)
    hub = make_hub(f"udpout:127.0.0.1:{udp.getsockname()[1]}")
    until(hub.links)
    hub.send(text("farewell"))
    hub.close()
    assert b"farewell" in udp.recv(300)
    udp.close()


def test_a_full_radio_buffer_slows_only_its_own_link(make_hub: MakeHub) -> None:
    """RADIO_STATUS from one endpoint slows that endpoint, not the other."""
    peers = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for peer in peers:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(60.0)
    radio, other = (f"udpout:127.0.0.1:{peer.getsockname()[1]}" for peer in peers)
    hub = make_hub(radio, other)
    hub.send(text("hello"))
    _, address = peers[0].recvfrom(300)
    full = Sender(51, 68)
    status = mavlink.MAVLink_radio_status_message(100, 100, 5, 30, 30, 0, 0)

    def slowed() -> bool:
        peers[0].sendto(full.frame(status), address)
        return hub.budgets()[radio][1] > 1.0

    until(slowed)
    assert hub.budgets()[other][1] == 1.0
    for peer in peers:
        peer.close()


def test_no_texts_are_sent_to_other_agents() -> None:
    """A link that leads only to peers gets heartbeats and the messages for that link; the ground gets everything."""
    ends = {}
    for name in ("ground", "peers"):
        ends[name] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        ends[name].bind(("127.0.0.1", 0))
    endpoints = [
        {"url": f"udpout:127.0.0.1:{end.getsockname()[1]}", "name": name, "leads_to": name, "budget": 0}
        for name, end in ends.items()
    ]
    hub = MavlinkHub(MavlinkSettings.model_validate({"endpoints": endpoints}), 7, SystemClock())
    view = mavlink.MAVLink_tunnel_message(0, 0, 46193, 1, [1] * 128)
    hub.start()
    try:
        hub.send(text("A07 OK 11111111"))
        hub.send(heartbeat(WORD))
        hub.send(view, link="peers")
        read: dict[str, set[str]] = {name: set() for name in ends}
        decoder = mavlink.MAVLink(None)
        for name, end in ends.items():
            end.settimeout(60.0)
            while len(read[name]) < 2:
                read[name] |= {message.get_type() for message in decoder.parse_buffer(end.recv(4096)) or []}
    finally:
        hub.close()
        rest = {name: _left(end) for name, end in ends.items()}
    assert read == {"ground": {"HEARTBEAT", "STATUSTEXT"}, "peers": {"HEARTBEAT", "TUNNEL"}}
    assert rest == {"ground": b"", "peers": b""}


def _left(end: socket.socket) -> bytes:
    """The unread data; closes the socket."""
    with contextlib.closing(end), contextlib.suppress(BlockingIOError):
        end.setblocking(False)
        return end.recv(4096)
    return b""
