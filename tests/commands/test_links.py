"""Commands over real sockets, with pymavlink's own connection as the ground station."""

from __future__ import annotations

import itertools
import time
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
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from tests.fakes.mavlink import LIMIT_S, free_port, heartbeat
from tests.fakes.until import until

# With its default dialect pymavlink starts with MAVLink 1, and loses its key when it first receives MAVLink 2.
mavutil.set_dialect("common")

AGAIN_S = 20.0
"""A command without an answer is sent again after this time. Late answers to both could be taken for those of the next command."""


class Agent:
    """A hub of agent 7 with its handler, listening on UDP; `did` has the executed commands."""

    def __init__(self, port: int, key: Path | None = None) -> None:
        chosen = settings(
            agent={"id": 7},
            containers=[{"name": "app"}],
            mavlink={
                "endpoints": [{"url": f"udpin:127.0.0.1:{port}", "budget": 0, "link_id": 4}],
                "commands": ["status", "restart"],
                "signing": {"key": str(key) if key else None, "command_age": 300},  # the machine may be busy
            },
        )
        assert isinstance(chosen.mavlink, MavlinkSettings)
        self.did: list[str] = []
        self.notes: list[str] = []
        self.hub = MavlinkHub(chosen.mavlink, 7, SystemClock())
        services = CommandServices(
            tuple,
            tuple,
            tuple,
            lambda: True,
            lambda: True,
            run_checks=lambda: self.did.append("look"),
            approve=str,
            restart=lambda key, by: self.did.append(key) or key,
            note=lambda kind, text: self.notes.append(text),
            later=TimeoutError,
        )
        self.handler = MavlinkCommands(
            self.hub, CommandHandler(services, ["app"], SystemClock()), services, chosen.mavlink, 7, SystemClock()
        )
        self.hub.start()
        self.handler.start()
        until(self.hub.links, "the port opening")

    def close(self) -> None:
        self.handler.close()
        self.hub.close()


@pytest.fixture
def agent_and_stations() -> Iterator[tuple[Agent, list[Any]]]:
    """The agent, and two ground stations, 255 and 254, on its link."""
    port = free_port()
    agent = Agent(port)
    grounds = [
        mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=n, source_component=190)
        for n in (255, 254)
    ]
    yield agent, grounds
    for ground in grounds:
        ground.close()
    agent.close()


def ask(ground: Any, command: int, first: float, second: float = 0, *, wanted: str = "COMMAND_ACK") -> Any:
    """Send until acknowledged, as a ground station does; return the message of the wanted type for this sender."""
    ours = ground.mav.srcSystem
    while ground.recv_match(blocking=False) is not None:
        pass  # left over from an earlier command
    ground.mav.send(heartbeat(kind=mavlink.MAV_TYPE_GCS))
    attempts, next_s = itertools.count(), 0.0

    def answer() -> Any:
        nonlocal next_s
        if time.monotonic() >= next_s:
            ground.mav.command_long_send(7, 193, command, next(attempts), first, second, 0, 0, 0, 0, 0)
            next_s = time.monotonic() + AGAIN_S
        message = ground.recv_match(type=wanted, blocking=True, timeout=0.2)
        if getattr(message, "target_system", ours) != ours or getattr(message, "command", command) != command:
            return None
        return message

    return until(answer, f"{wanted} for command {command}", limit_s=LIMIT_S)


def test_a_ground_station_gets_an_acknowledgement(agent_and_stations: tuple[Agent, list[Any]]) -> None:
    """Status, a restart, a command without permission, and one for another component."""
    agent, (ground, _other) = agent_and_stations
    assert ask(ground, 512, 253, wanted="STATUSTEXT").text == "A07 STALE --------"
    assert ask(ground, 512, 390, wanted="ONBOARD_COMPUTER_STATUS").cpu_cores == [255] * 8
    results = [ask(ground, *command).result for command in ((31010, 3, 1), (31010, 1), (400, 1))]
    assert results == [mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_UNSUPPORTED]
    assert agent.did == ["app"]


def test_the_acknowledgement_names_its_receiver(agent_and_stations: tuple[Agent, list[Any]]) -> None:
    """Both stations get an answer on one link, and each can identify its own."""
    _agent, grounds = agent_and_stations
    for ground in grounds:
        ack = ask(ground, 512, 253)
        assert (ack.target_component, ack.get_srcSystem(), ack.get_srcComponent()) == (190, 7, 193)


# ---------------------------------------------------------------- with signing

KEY = bytes(range(1, 33))
Sign = Callable[..., Any]


@pytest.fixture
def signed(tmp_path: Path) -> Iterator[tuple[Agent, Sign]]:
    """The agent with a key, and a factory of ground stations: with this key, or without any."""
    path, port = tmp_path / "key", free_port()
    path.write_bytes(KEY)
    path.chmod(0o600)
    agent, grounds = Agent(port, path), []

    def ground(key: bytes | None = None) -> Any:
        made = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255, source_component=190)
        grounds.append(made)
        if key is not None:
            made.setup_signing(key, link_id=9)
        return made

    yield agent, ground
    for made in grounds:
        made.close()
    agent.close()


def test_a_signed_command_is_executed_and_its_answer_is_signed(signed: tuple[Agent, Sign]) -> None:
    """pymavlink's own receiver rejects anything without a valid signature; the link id is the configured one."""
    agent, ground = signed
    ack = ask(ground(KEY), 31010, 3, 1)
    assert (ack.result, ack.get_signed(), ack.get_link_id()) == (mavlink.MAV_RESULT_ACCEPTED, True, 4)
    assert agent.did == ["app"]
    assert until(lambda: agent.notes, "the note")[0].endswith("signed: app")


def test_an_unsigned_command_is_denied_if_signing_is_on(signed: tuple[Agent, Sign]) -> None:
    """Whatever it requests; a ground station without the key can still read the answer."""
    agent, ground = signed
    station = ground()
    for command in ((31010, 3, 1), (512, 253)):
        assert ask(station, *command).result == mavlink.MAV_RESULT_DENIED
    assert agent.did == []


def test_a_command_signed_with_another_key_gets_no_answer(signed: tuple[Agent, Sign]) -> None:
    """It is counted and reported as a problem; it does not lock out the real ground station."""
    agent, ground = signed
    forger = ground(bytes(32))
    forger.mav.signing.timestamp = 2**47  # years ahead

    def forged() -> bool:
        forger.mav.command_long_send(7, 193, 31010, 0, 3, 1, 0, 0, 0, 0, 0)
        return bool(agent.hub.report()[0]["refused"]["forged"])

    until(forged, "a forged frame")
    assert "wrong signature" in agent.hub.problem()
    assert (agent.did, agent.notes) == ([], [])
    assert ask(ground(KEY), 31010, 3, 1).result == mavlink.MAV_RESULT_ACCEPTED


def test_a_recorded_command_is_not_executed_again(signed: tuple[Agent, Sign]) -> None:
    """The identical frame, later."""
    agent, ground = signed
    station = ground(KEY)
    recorded: list[bytes] = []
    write = station.write
    station.write = lambda data: (recorded.append(bytes(data)), write(data))[1]
    assert ask(station, 31010, 3, 1).result == mavlink.MAV_RESULT_ACCEPTED
    for frame in recorded:
        write(frame)
    commands = [frame for frame in recorded if frame[7:10] == bytes((76, 0, 0))]
    until(lambda: agent.hub.report()[0]["refused"]["old"] == len(commands), "the copies")
    assert agent.did == ["app"]
