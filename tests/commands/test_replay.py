"""Recorded commands, replayed over a real socket with pymavlink's own frames."""

from __future__ import annotations

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
from phm.transport.mavlink_signing import EPOCH_S, NAME, TICKS
from tests.fakes.mavlink import LIMIT_S, free_port, heartbeat
from tests.fakes.until import until

# With its default dialect pymavlink starts with MAVLink 1, and loses its key when it first receives MAVLink 2.
mavutil.set_dialect("common")
KEY = bytes(range(1, 33))
RESTART, STATUS = (31010, 3, 1), (512, 253, 0)
MAV = mavlink
Start = Callable[..., "Agent"]
Ask = Callable[..., "Ground"]


class SetClock(SystemClock):
    """The machine's clocks, with a date that only the test moves: while the machine is busy, no frame becomes older."""

    ahead_s = 0.0

    def __init__(self) -> None:
        super().__init__()
        self._began_utc = time.time()

    def utc(self) -> float:
        return self._began_utc + self.ahead_s


class Agent:
    """Agent 7 with a key, listening on UDP; `did` has the executed commands."""

    def __init__(self, key: Path, state: Path | None, clock: SetClock, *, synchronized: bool | None = None) -> None:
        self.port = free_port()
        chosen = settings(
            agent={"id": 7},
            containers=[{"name": "app"}],
            mavlink={
                "endpoints": [{"url": f"udpin:127.0.0.1:{self.port}", "budget": 0}],
                "commands": ["status", "restart"],
                "signing": {"key": str(key)},
            },
        )
        assert isinstance(chosen.mavlink, MavlinkSettings)
        self.did: list[str] = []
        self.notes: list[str] = []
        self.hub = MavlinkHub(
            chosen.mavlink, 7, clock, str(state) if state is not None else None, synchronized=lambda: synchronized
        )
        self.received: list[Any] = []
        self.hub.listen(lambda message, link: self.received.append(message), (0,))
        services = CommandServices(
            tuple,
            tuple,
            tuple,
            lambda: True,
            lambda: True,
            run_checks=lambda: None,
            approve=str,
            restart=self._restart,
            note=lambda kind, text: self.notes.append(text),
            later=TimeoutError,
            remember=self.hub.remember,
            clock_problem=self.hub.clock_problem,
        )
        self.handler = MavlinkCommands(
            self.hub, CommandHandler(services, ["app"], clock), services, chosen.mavlink, 7, clock
        )
        self.hub.start()
        self.handler.start()
        until(self.hub.links, "the port opening")

    def _restart(self, key: str, by: str) -> str:
        self.did.append(by)
        return key

    def close(self) -> None:
        self.handler.close()
        self.hub.close()


class Ground:
    """A ground station with the key and a clock set by the test; it can record a command instead of sending it."""

    def __init__(self, port: int, utc: float) -> None:
        self.link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255, source_component=190)
        self.link.setup_signing(KEY, link_id=9)
        self.at(utc)

    def at(self, utc: float) -> None:
        self.link.mav.signing.timestamp = round((utc - EPOCH_S) * TICKS)

    def record(self, command: int, first: float, second: float) -> bytes:
        """The frame of a command, as it would have been sent."""
        message = MAV.MAVLink_command_long_message(7, 193, command, 0, first, second, 0, 0, 0, 0, 0)
        frame: bytes = message.pack(self.link.mav)
        self.link.mav.seq = (self.link.mav.seq + 1) % 256
        return frame

    def play(self, frame: bytes) -> int:
        """The result of its acknowledgement."""
        while self.link.recv_match(blocking=False) is not None:
            pass
        self.link.write(frame)
        ack = self.link.recv_match(type="COMMAND_ACK", blocking=True, timeout=LIMIT_S)
        assert ack is not None
        return int(ack.result)

    def heartbeat(self) -> None:
        self.link.mav.send(heartbeat(kind=MAV.MAV_TYPE_GCS))


@pytest.fixture
def key(tmp_path: Path) -> Path:
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    return path


@pytest.fixture
def start(key: Path) -> Iterator[Start]:
    """Start agents, and close them at the end."""
    made: list[Agent] = []

    def begin(state: Path | None, clock: SetClock, **named: Any) -> Agent:
        made.append(Agent(key, state, clock, **named))
        return made[-1]

    yield begin
    for one in made:
        one.close()


@pytest.fixture
def ask() -> Iterator[Ask]:
    """Create ground stations of an agent, and close them at the end."""
    made: list[Ground] = []

    def begin(agent: Agent, utc: float) -> Ground:
        made.append(Ground(agent.port, utc))
        return made[-1]

    yield begin
    for one in made:
        one.link.close()


def test_a_delayed_command_of_a_known_sender_is_too_old(start: Start, ask: Ask, tmp_path: Path) -> None:
    """It was withheld, and is newer than everything received from its sender; six hours later it is denied."""
    clock = SetClock()
    agent = start(tmp_path, clock)
    ground = ask(agent, clock.utc())
    ground.heartbeat()
    until(lambda: agent.received, "the heartbeat")
    delayed = ground.record(*RESTART)
    clock.ahead_s = 6 * 3600.0
    assert ground.play(delayed) == MAV.MAV_RESULT_DENIED
    assert agent.did == []
    assert "signed 21600 s ago" in until(lambda: agent.notes, "the note")[0]
    ground.at(clock.utc())
    assert ground.play(ground.record(*RESTART)) == MAV.MAV_RESULT_ACCEPTED
    assert agent.did == ["255/190"]


def test_a_slow_radio_makes_no_command_too_old(start: Start, ask: Ask, tmp_path: Path) -> None:
    """Seconds of latency, and clocks that differ by seconds, are allowed."""
    clock = SetClock()
    agent = start(tmp_path, clock)
    ground = ask(agent, clock.utc() - 5.0)
    assert ground.play(ground.record(*RESTART)) == MAV.MAV_RESULT_ACCEPTED
    assert agent.did == ["255/190"]


def test_a_command_whose_time_cannot_be_saved_is_refused(start: Start, ask: Ask, tmp_path: Path) -> None:
    """It could be executed again after a restart of PHM; a read-only request changes nothing and is answered."""
    (tmp_path / "file").write_text("")
    clock = SetClock()
    agent = start(tmp_path / "file", clock)
    ground = ask(agent, clock.utc())
    assert ground.play(ground.record(*RESTART)) == MAV.MAV_RESULT_FAILED
    assert ground.play(ground.record(*STATUS)) == MAV.MAV_RESULT_ACCEPTED
    assert agent.did == []
    assert "cannot write" in until(lambda: agent.notes, "the note")[0]
    (tmp_path / "file").unlink()
    assert ground.play(ground.record(*RESTART)) == MAV.MAV_RESULT_ACCEPTED
    assert agent.did == ["255/190"]
    assert (tmp_path / "file" / NAME).exists()


def test_without_a_clock_a_recorded_command_changes_nothing(start: Start, ask: Ask, tmp_path: Path) -> None:
    """A year-old frame sets our time, so its action waits until the clock is set; then the recorded frame is old."""
    clock = SetClock()
    true_utc = clock.utc()
    clock.ahead_s = -true_utc  # 1970
    agent = start(tmp_path, clock)
    ground = ask(agent, true_utc - 365 * 86400.0)
    ground.heartbeat()
    first, second, read = ground.record(*RESTART), ground.record(*RESTART), ground.record(*STATUS)
    assert [ground.play(frame) for frame in (first, second)] == [MAV.MAV_RESULT_TEMPORARILY_REJECTED] * 2
    assert ground.play(read) == MAV.MAV_RESULT_ACCEPTED
    assert agent.did == []
    assert "set this computer's clock" in until(lambda: agent.notes, "the note")[0]
    third = ground.record(*RESTART)
    clock.ahead_s = 0.0
    assert ground.play(third) == MAV.MAV_RESULT_DENIED
    ground.at(true_utc)
    assert ground.play(ground.record(*RESTART)) == MAV.MAV_RESULT_ACCEPTED
    assert agent.did == ["255/190"]


def test_after_a_restart_without_a_clock_commands_wait(start: Start, ask: Ask, tmp_path: Path) -> None:
    """The saved time is in the past, and commands recorded since are newer than it."""
    clock = SetClock()
    true_utc = clock.utc()
    agent = start(tmp_path, clock)
    ground = ask(agent, true_utc)
    assert ground.play(ground.record(*RESTART)) == MAV.MAV_RESULT_ACCEPTED
    agent.close()
    ground.at(true_utc + 3600.0)
    recorded = ground.record(*RESTART)
    clock.ahead_s = -true_utc
    again = start(tmp_path, clock)
    assert ask(again, 0.0).play(recorded) == MAV.MAV_RESULT_TEMPORARILY_REJECTED
    assert again.did == []


def test_a_synchronized_clock_overrides_received_times(start: Start, ask: Ask, tmp_path: Path) -> None:
    """A ground station whose clock is ahead is accepted: frames that are not signed yet cannot have been recorded."""
    clock = SetClock()
    agent = start(tmp_path, clock, synchronized=True)
    ground = ask(agent, clock.utc() + 3600.0)
    assert ground.play(ground.record(*RESTART)) == MAV.MAV_RESULT_ACCEPTED
    unsure = start(None, clock)
    ground = ask(unsure, clock.utc() + 3600.0)
    assert ground.play(ground.record(*RESTART)) == MAV.MAV_RESULT_TEMPORARILY_REJECTED
    assert (agent.did, unsure.did) == (["255/190"], [])
