"""The complete daemon with a key: ground commands reach checks, faults and recovery, and are logged."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from phm.core.model import Event, Note
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink_signing import NAME
from phm.wire import tunnel
from tests.fakes.mavlink import LIMIT_S, free_port, heartbeat, is_reply
from tests.fakes.until import until

KEY = bytes(range(1, 33))
AGAIN_S = 20.0
"""A command without an answer is sent again after this time. Late answers to both could be taken for those of the next command."""
# With its default dialect pymavlink starts with MAVLink 1, and loses its key when it first receives MAVLink 2.
mavutil.set_dialect("common")


class Agent:
    """PHM as agent 7 with one container that no engine has, and a ground station with the key."""

    def __init__(self, folder: Path) -> None:
        key, port = folder / "key", free_port()
        key.write_text(KEY.hex())
        key.chmod(0o600)
        made = settings(
            agent={"id": 7},
            interval=5,
            state_dir=str(folder / "state"),
            run_dir=str(folder / "run"),
            log={"directory": str(folder / "log")},
            checks={"host": {"enabled": False}, "peers": {"enabled": False}},
            docker={"socket": f"unix://{folder}/none.sock"},
            containers=[{"name": "app"}],
            mavlink={
                "endpoints": [{"url": f"udpin:127.0.0.1:{port}", "budget": 0}],
                "signing": {"key": str(key), "command_age": 300},  # the machine may be busy
                "commands": ["status", "details", "check", "approve", "restart"],
            },
        )
        self.folder, self.events = folder, list[Event]()
        self.daemon = build_daemon(made)
        self.daemon.components.bus.subscribe("test", self.events.append)
        self.daemon.start()
        hub = self.daemon.components.probes.mavlink
        assert hub is not None
        until(hub.links, "the port opening")
        self.ground: Any = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=255, source_component=190
        )
        self.ground.setup_signing(KEY, link_id=9)

    def close(self) -> None:
        self.ground.close()
        self.daemon.stop()

    def ask(self, command: int, first: float, second: float = 0) -> list[Any]:
        """The messages received until shortly after the acknowledgement."""
        came: list[Any] = []
        attempts, next_s = itertools.count(), 0.0

        def acknowledged() -> bool:
            nonlocal next_s
            if time.monotonic() >= next_s:
                self.ground.mav.send(heartbeat(kind=mavlink.MAV_TYPE_GCS))
                self.ground.mav.command_long_send(7, 193, command, next(attempts), first, second, 0, 0, 0, 0, 0)
                next_s = time.monotonic() + AGAIN_S
            while (message := self.ground.recv_match(blocking=True, timeout=1.0)) is not None:
                came.append(message)
                if message.get_type() == "COMMAND_ACK" and message.command == command:
                    return True
            return False

        until(acknowledged, f"an answer to {command} {first}", lambda: came, limit_s=LIMIT_S)
        return came

    def detail(self) -> Any:
        """A TUNNEL that is not the text of an earlier answer; None: none came in a moment."""
        message = self.ground.recv_match(type="TUNNEL", blocking=True, timeout=0.5)
        return None if message is None or is_reply(message) else message

    def notes(self) -> list[str]:
        return [event.text for event in list(self.events) if isinstance(event, Note) and event.kind == "COMMAND"]


@pytest.fixture
def agent(tmp_path: Path) -> Iterator[Agent]:
    made = Agent(tmp_path)
    yield made
    made.close()


def test_a_command_reaches_its_handler(agent: Agent) -> None:
    """Checks, details of a fault, a restart that the container has not opted in to; each is signed and logged."""
    assert agent.ask(31010, 1)[-1].result == mavlink.MAV_RESULT_ACCEPTED, agent.notes()
    until(agent.daemon.pipeline.open_faults, "the fault of the engine")
    fault = agent.daemon.pipeline.open_faults()[0]
    came = agent.ask(512, 385, int(fault.id.rpartition("-")[2]))
    assert came[-1].result == mavlink.MAV_RESULT_ACCEPTED
    details = [
        message for message in came if message.get_type() == "TUNNEL" and not is_reply(message)
    ]  # before or behind the acknowledgement
    detail = (details or [until(agent.detail, "details")])[0]
    part = tunnel.decode(bytes(detail.payload[: detail.payload_length]))
    assert isinstance(part, tunnel.FaultDetail)
    assert (part.fault, detail.get_signed()) == (fault.id, True)
    assert agent.ask(31010, 3, 1)[-1].result == mavlink.MAV_RESULT_FAILED
    until(lambda: len(agent.notes()) >= 3, "the notes")
    said = " | ".join(agent.notes())
    for words in ("running all checks", f"sending details of {fault.id}", "app has not opted in (recover: true)"):
        assert words in said
    log = agent.folder / "log" / "phm.log"
    until(lambda: "---- COMMAND: accepted" in log.read_text(), "the line in the log")


def test_the_signing_time_is_saved_before_a_command_is_executed(agent: Agent) -> None:
    """Its file has the stream of the ground station."""
    agent.ask(31010, 1)
    assert "[9, 255, 190, " in (agent.folder / "state" / NAME).read_text()
