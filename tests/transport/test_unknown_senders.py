"""Which senders may use an endpoint: frames of strangers, over real sockets."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from phm.commands.handler import CommandHandler
from phm.commands.mavlink_commands import MavlinkCommands
from phm.commands.services import CommandServices
from phm.core.clock import SystemClock
from phm.core.settings import MavlinkSettings
from phm.testing import settings
from phm.transport.client_admission import MAX_PEERS
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm.transport.mavlink_udp import network_of
from phm.transport.own_network import HOST_NAME
from tests.fakes.mavlink import Sender, free_port, heartbeat, text
from tests.fakes.until import until

# With its default dialect pymavlink starts with MAVLink 1, and forgets its key when it first receives MAVLink 2.
mavutil.set_dialect("common")
RESTART = mavlink.MAVLink_command_long_message(7, 193, 31010, 0, 3, 1, 0, 0, 0, 0, 0)
MakeAgent = Callable[..., "Agent"]


class Agent:
    """A hub of agent 7 with one endpoint and a command handler that permits `restart`; `did` lists the executed
    requests.
    """

    def __init__(self, url: str, key: str | None = None) -> None:
        chosen = settings(
            agent={"id": 7},
            containers=[{"name": "app"}],
            mavlink={
                "endpoints": [{"url": url, "budget": 0}],
                "commands": ["status", "restart"],
                "signing": {"key": key},
            },
        )
        assert isinstance(chosen.mavlink, MavlinkSettings)
        self.did: list[str] = []
        self.received: list[tuple[int, str]] = []
        self.hub = MavlinkHub(chosen.mavlink, 7, SystemClock())
        self.hub.listen(lambda message, link: self.received.append((message.get_srcSystem(), message.get_type())), (0,))
        services = CommandServices(
            tuple,
            tuple,
            tuple,
            lambda: True,
            lambda: True,
            run_checks=lambda: None,
            approve=str,
            restart=self._restart,
            note=lambda kind, text: None,
            later=TimeoutError,
        )
        self.commands = MavlinkCommands(
            self.hub, CommandHandler(services, ["app"], SystemClock()), services, chosen.mavlink, 7, SystemClock()
        )
        self.hub.start()
        self.commands.start()

    def _restart(self, key: str, by: str) -> str:
        self.did.append(by)
        return key

    def close(self) -> None:
        self.commands.close()
        self.hub.close()


@pytest.fixture
def board() -> Iterator[MakeAgent]:
    """Create agents, and close them at the end."""
    made: list[Agent] = []

    def make(url: str, key: str | None = None) -> Agent:
        made.append(Agent(url, key))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def udp() -> Iterator[Callable[..., socket.socket]]:
    """Create loopback UDP sockets, and close them at the end."""
    with contextlib.ExitStack() as stack:

        def make(host: str = "127.0.0.1", port: int = 0) -> socket.socket:
            made = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            made.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            made.bind((host, port))
            made.settimeout(60.0)
            return made

        yield make


def address_of(agent: Agent, ground: socket.socket) -> Any:
    """The address that the agent's endpoint sends from."""
    agent.hub.send(text("hello"))
    return ground.recvfrom(300)[1]


def test_udpout_receives_only_from_its_peer(board: MakeAgent, udp: Callable[..., socket.socket]) -> None:
    """A command from another port or host of the network is not even read; the peer's own is executed."""
    ground = udp()
    agent = board(f"udpout:127.0.0.1:{ground.getsockname()[1]}")
    ours = address_of(agent, ground)
    for stranger in (udp(), udp("127.0.0.2"), udp("127.0.0.2", ground.getsockname()[1])):
        stranger.sendto(Sender(255, 190).frame(RESTART), ours)
    known = Sender(254, 190)
    for message in (heartbeat(), RESTART):
        ground.sendto(known.frame(message), ours)
    until(lambda: agent.did, "the peer's restart")
    assert agent.did == ["254/190"]
    assert agent.received == [(254, "HEARTBEAT")]


def test_the_host_answers_a_bridged_container_from_the_gateway(
    board: MakeAgent, udp: Callable[..., socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames from the address that host.docker.internal names and from the gateway are read, from its port alone; the gateway of
    now counts."""
    real, gateways = socket.getaddrinfo, ["127.0.0.2"]
    monkeypatch.setattr(
        socket,
        "getaddrinfo",
        lambda host, *rest, **named: real("127.0.0.1" if host == HOST_NAME else host, *rest, **named),
    )
    monkeypatch.setattr("phm.transport.mavlink_connection.is_private", lambda: True)
    monkeypatch.setattr("phm.transport.mavlink_connection.gateway", lambda: gateways[-1])
    named = udp()
    port = named.getsockname()[1]
    agent = board(f"udpout:{HOST_NAME}:{port}")
    ours = address_of(agent, named)
    via = {host: udp(host, port) for host in ("127.0.0.2", "127.0.0.3")}
    for stranger in (udp(), udp("127.0.0.2"), via["127.0.0.3"]):
        stranger.sendto(Sender(255, 190).frame(heartbeat()), ours)
    for number, ground in enumerate((named, via["127.0.0.2"])):
        ground.sendto(Sender(251 + number, 190).frame(heartbeat()), ours)
    until(lambda: len(agent.received) == 2, "both addresses of the host to be read")
    gateways.append("127.0.0.3")
    via["127.0.0.3"].sendto(Sender(253, 190).frame(heartbeat()), ours)
    until(lambda: len(agent.received) == 3, "the new gateway to be read")
    assert [system for system, _ in agent.received] == [251, 252, 253]


def test_udpbcast_receives_answers_only_from_its_port(board: MakeAgent, udp: Callable[..., socket.socket]) -> None:
    """A receiver of the broadcast answers from the port that it was sent to; frames from another port are not read."""
    port = free_port(socket.SOCK_DGRAM)
    ground = udp("0.0.0.0", port)
    agent = board(f"udpbcast:127.255.255.255:{port}")
    agent.hub.send(text("hello"))
    _data, ours = ground.recvfrom(300)
    udp().sendto(Sender(255, 190).frame(RESTART), ("127.0.0.1", ours[1]))
    for message in (heartbeat(), RESTART):
        ground.sendto(Sender(254, 190).frame(message), ("127.0.0.1", ours[1]))
    until(lambda: agent.did, "the restart that the listener on the port requested")
    assert agent.did == ["254/190"]
    assert agent.received == [(254, "HEARTBEAT")]


def test_a_ground_station_that_starts_later_gets_the_next_frame(
    board: MakeAgent, udp: Callable[..., socket.socket]
) -> None:
    """A missing listener is reported to a connected socket at first, which must lose neither the link nor a line."""
    port = free_port(socket.SOCK_DGRAM)
    agent = board(f"udpout:127.0.0.1:{port}")
    (counters,) = agent.hub.counters().values()
    for number in range(3):
        agent.hub.send(text("to no peer"))
        until(lambda sent=number + 1: counters.sent == sent)  # type: ignore[misc]
    ground = udp("127.0.0.1", port)
    agent.hub.send(text("to the ground"))
    assert b"to the ground" in ground.recv(300)
    assert [fact.open for fact in agent.hub.links()] == [True]
    assert agent.hub._endpoints[0]._opened == 1


@pytest.mark.parametrize(
    ("target", "inside", "outside"),
    [
        ("192.168.6.255", "192.168.6.1", "192.168.7.1"),
        ("192.168.7.127", "192.168.7.126", "192.168.7.129"),
        ("10.42.255.255", "10.42.3.4", "10.43.3.4"),
    ],
)
def test_the_network_of_a_broadcast_address_is_known_without_its_mask(target: str, inside: str, outside: str) -> None:
    """All bits behind the last zero may be host bits."""
    network = network_of(target)
    assert ipaddress.ip_address(inside) in network
    assert ipaddress.ip_address(outside) not in network
    assert ipaddress.ip_address("8.8.8.8") in network_of("255.255.255.255")


def test_udpout_follows_a_route_change(board: MakeAgent, udp: Callable[..., socket.socket]) -> None:
    """When the route starts at another address of this machine, a silent endpoint is reopened from there."""
    ground = udp()
    agent = board(f"udpout:127.0.0.1:{ground.getsockname()[1]}")
    endpoint = agent.hub._endpoints[0]
    address_of(agent, ground)
    assert endpoint._opener.moved() is False
    endpoint._opener._source = "192.0.2.1"  # as if the first interface had disappeared
    assert endpoint._opener.moved() is True


# ---------------------------------------------------------------- many senders


def test_sixteen_source_ports_do_not_lock_out_a_ground_station(
    board: MakeAgent, udp: Callable[..., socket.socket]
) -> None:
    """Frames from many ports of one address leave places for another address, which gets everything."""
    port = free_port(socket.SOCK_DGRAM)
    agent = board(f"udpin:127.0.0.1:{port}")
    until(agent.hub.links)
    crowd, ground = [udp("127.0.0.2") for _ in range(MAX_PEERS)], udp()
    for number, stranger in enumerate(crowd):
        stranger.sendto(Sender(200 + number, 190).frame(heartbeat()), ("127.0.0.1", port))
    until(lambda: len(agent.received) == len(crowd))
    ground.sendto(Sender(255, 190).frame(heartbeat()), ("127.0.0.1", port))
    until(lambda: (255, "HEARTBEAT") in agent.received)
    agent.hub.send(text("to the ground"))
    assert b"to the ground" in ground.recv(300)


def test_a_ground_station_displaces_an_idle_one_of_its_address(
    board: MakeAgent, udp: Callable[..., socket.socket]
) -> None:
    """Behind the same address as many idle senders it gets everything after seconds, not after a minute."""
    port = free_port(socket.SOCK_DGRAM)
    agent = board(f"udpin:127.0.0.1:{port}")
    until(agent.hub.links)
    crowd, ground, known = [udp() for _ in range(MAX_PEERS)], udp(), Sender(255, 190)
    for stranger in crowd:
        stranger.sendto(Sender(200, 190).frame(heartbeat()), ("127.0.0.1", port))
    until(lambda: len(agent.received) == len(crowd))
    ground.settimeout(0.2)

    def read() -> bool:
        ground.sendto(known.frame(heartbeat()), ("127.0.0.1", port))
        agent.hub.send(text("to the ground"))
        with contextlib.suppress(TimeoutError):
            return b"to the ground" in ground.recv(300)
        return False

    until(read, "the ground station getting lines")


def test_idle_tcp_clients_do_not_lock_out_a_ground_station(board: MakeAgent) -> None:
    """Silent connections leave places for another address, and are displaced when they have been idle for long."""
    port = free_port()
    agent = board(f"tcpin:127.0.0.1:{port}")
    until(agent.hub.links)
    with contextlib.ExitStack() as stack:
        for host in ("127.0.0.2", "127.0.0.3"):
            for _ in range(MAX_PEERS):
                stack.enter_context(socket.create_connection(("127.0.0.1", port), source_address=(host, 0)))

        def reads() -> bool:
            with socket.create_connection(("127.0.0.1", port)) as ground, contextlib.suppress(OSError):
                ground.settimeout(5.0)
                agent.received.clear()  # of an earlier attempt
                ground.sendall(Sender(255, 190).frame(heartbeat()))
                until(lambda: (255, "HEARTBEAT") in agent.received or not _open(ground))
                agent.hub.send(text("to the ground"))
                return b"to the ground" in ground.recv(300)
            return False

        until(reads, "the ground station getting lines")


def _open(sock: socket.socket) -> bool:
    """Whether the other side has not closed the connection."""
    try:
        return sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


def test_a_signing_peer_is_admitted_among_many_unsigned_ones(board: MakeAgent, tmp_path: Path) -> None:
    """With signing on, connections that send constantly without signing leave places for those that sign."""
    key, port = tmp_path / "key", free_port()
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    agent = board(f"tcpin:127.0.0.1:{port}", str(key))
    until(agent.hub.links)
    stop = threading.Event()
    with contextlib.ExitStack() as stack:
        for host in ("127.0.0.2", "127.0.0.3"):
            flood = threading.Thread(target=_flood, args=(port, host, stop), daemon=True)
            stack.callback(flood.join, 60.0)
            flood.start()
        stack.callback(stop.set)
        until(lambda: len(agent.received) > 20 * MAX_PEERS, "the floods to have all connections that they get")
        ground = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}", source_system=255, source_component=190)
        stack.callback(ground.close)
        ground.setup_signing(bytes(range(32)), link_id=9)

        def answered() -> bool:
            ground.mav.command_long_send(7, 193, 31010, 0, 3, 1, 0, 0, 0, 0, 0)
            return ground.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.5) is not None

        until(answered, "an answer to the signing peer")
        until(lambda: agent.did, "the restart")
    assert (ground.mav.srcSystem, set(agent.did)) == (255, {"255/190"})


def _flood(port: int, host: str, stop: threading.Event) -> None:
    """As many connections as are admitted, each of which sends heartbeats constantly, and reconnects when it is closed."""
    frame = Sender(int(host[-1]), 190).frame(heartbeat())
    open_now: list[socket.socket] = []
    while not stop.is_set():
        with contextlib.suppress(OSError):
            if len(open_now) < MAX_PEERS:
                open_now.append(socket.create_connection(("127.0.0.1", port), source_address=(host, 0)))
        for sock in list(open_now):
            try:
                sock.sendall(frame)
            except OSError:
                sock.close()
                open_now.remove(sock)
        stop.wait(0.05)
    for sock in open_now:
        sock.close()


def test_a_link_without_a_radio_is_not_slowed_down(udp: Callable[..., socket.socket]) -> None:
    """RADIO_STATUS can be forged by anyone; with `radio: off` it is not read."""
    with reported_full(udp(), "off") as slowed:
        assert slowed() == 1.0
    with reported_full(udp(), "auto") as slowed:
        until(lambda: slowed() > 1.0, "the slow-down")  # on a busy machine the first report may be outdated already


@contextlib.contextmanager
def reported_full(ground: socket.socket, radio: str) -> Iterator[Callable[[], float]]:
    """By how much a link is slowed down after its radio has reported a full buffer once more."""
    full = mavlink.MAVLink_radio_status_message(100, 100, 5, 30, 30, 0, 0)
    url = f"udpout:127.0.0.1:{ground.getsockname()[1]}"
    hub = MavlinkHub(MavlinkSettings.model_validate({"endpoints": [{"url": url, "radio": radio}]}), 7, SystemClock())
    received: list[Any] = []
    hub.listen(lambda message, link: received.append(message), (0,))
    hub.start()
    try:
        hub.send(text("hello"))
        _data, ours = ground.recvfrom(300)
        sender = Sender(51, 68)

        def slowed() -> float:
            received.clear()
            for message in (full, heartbeat()):
                ground.sendto(sender.frame(message), ours)
            until(lambda: received, "the message after the report")
            return hub.budgets()[url][1]

        yield slowed
    finally:
        hub.close()
