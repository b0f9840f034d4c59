"""Commands over real sockets, with pymavlink's own connection as the ground station."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
from pymavlink import mavutil

from phm.clock import SystemClock
from phm.inbound.desk import Desk, Powers
from phm.settings import MavlinkSettings
from phm.testing import settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from tests.fakes.mavlink import LIMIT_S, free_port, heartbeat


class Aboard:
    """A hub of agent 7 with its desk, listening by UDP; `did` is what was done."""

    def __init__(self, port: int) -> None:
        chosen = settings(
            agent={"id": 7}, containers=[{"name": "app"}],
            mavlink={"endpoints": [{"url": f"udpin:127.0.0.1:{port}", "budget": 0}], "commands": ["status", "restart"]},
        )  # fmt: skip
        assert isinstance(chosen.mavlink, MavlinkSettings)
        self.did: list[str] = []
        self.notes: list[str] = []
        self.hub = MavlinkHub(chosen.mavlink, 7, SystemClock())
        powers = Powers(
            tuple, tuple, tuple, lambda: True, lambda: True, look=lambda: self.did.append("look"),
            approve=str, restart=lambda key, by: self.did.append(key) or key, note=lambda kind, text: self.notes.append(text),
            later=TimeoutError,
        )  # fmt: skip
        self.desk = Desk(self.hub, powers, chosen, SystemClock())
        self.hub.start()
        self.desk.start()

    def close(self) -> None:
        self.desk.close()
        self.hub.close()


@pytest.fixture
def aboard() -> Iterator[tuple[Aboard, list[Any]]]:
    """The agent, and two ground stations, 255 and 254, on its link."""
    port = free_port()
    agent = Aboard(port)
    grounds = [
        mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=n, source_component=190)
        for n in (255, 254)
    ]
    yield agent, grounds
    for ground in grounds:
        ground.close()
    agent.close()


def ask(ground: Any, command: int, first: float, second: float = 0, *, wanted: str = "COMMAND_ACK") -> Any:
    """Ask as a ground station does, again until acknowledged; the message of the wanted type that came to the asker."""
    ours = ground.mav.srcSystem
    ground.mav.send(heartbeat(kind=mavlink.MAV_TYPE_GCS))
    for again in range(round(LIMIT_S / 2)):
        ground.mav.command_long_send(7, 193, command, again, first, second, 0, 0, 0, 0, 0)
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            message = ground.recv_match(type=wanted, blocking=True, timeout=0.2)
            if message is not None and getattr(message, "target_system", ours) == ours:
                return message
    raise AssertionError(f"no {wanted} for command {command}")


def test_a_ground_station_asks_and_is_answered(aboard: tuple[Aboard, list[Any]]) -> None:
    """Status, a restart, something that is not allowed, and something that is not ours."""
    agent, (ground, _other) = aboard
    assert ask(ground, 512, 253, wanted="STATUSTEXT").text == "A07 STALE --------"
    assert ask(ground, 512, 390, wanted="ONBOARD_COMPUTER_STATUS").cpu_cores == [255] * 8
    results = [ask(ground, *command).result for command in ((31010, 3, 1), (31010, 1), (400, 1))]
    assert results == [mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_UNSUPPORTED]
    assert agent.did == ["app"]


def test_the_acknowledgement_names_its_asker(aboard: tuple[Aboard, list[Any]]) -> None:
    """Both stations are answered on one link; each sees which answer is its own."""
    _agent, grounds = aboard
    for ground in grounds:
        ack = ask(ground, 512, 253)
        assert (ack.target_component, ack.get_srcSystem(), ack.get_srcComponent()) == (190, 7, 193)
