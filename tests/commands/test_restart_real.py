"""Restart and start of real containers by the ground: the command over UDP, the action, its verification, the result line."""

from __future__ import annotations

import itertools
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pymavlink import mavutil

from phm.core.model import ActionEvent, Event, FaultOpened, Level
from phm.core.settings import Settings
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from phm.transport.dialect import mavlink
from tests.fakes.mavlink import free_port, heartbeat
from tests.fakes.until import until

APPROVE, RESTART = 2, 3
RUN = "trap 'exit 0' TERM; while :; do sleep 0.1; done"
# With its default dialect pymavlink starts with MAVLink 1, and loses its key when it first receives MAVLink 2.
mavutil.set_dialect("common")
AGAIN_S = 20.0
"""A command without an answer is sent again after this time."""


def watching(folder: Path, names: dict[str, str], url: str, mode: str = "act") -> Settings:
    """PHM as agent 7 with a link to `url`. The container `app` has opted in to recovery, others have not. names: on the engine, by key."""
    return settings(
        agent={"id": 7},
        interval=2,
        state_dir=str(folder / "state"),
        run_dir=str(folder / "run"),
        log={"directory": str(folder / "log")},
        checks={"host": {"enabled": False}, "peers": {"enabled": False}},
        containers=[{"name": name, "alias": key, "recover": key == "app"} for key, name in names.items()],
        recovery={"mode": mode, "verify": "30s", "stop_timeout": "2s", "ladders": {"exited": ["start"]}},
        mavlink={"endpoints": [{"url": url, "budget": 0}], "commands": ["restart", "approve", "details"]},
    )


class Agent:
    """PHM as agent 7 on the real engine, with the container `app` that has opted in and `other` that has not."""

    def __init__(self, folder: Path, names: dict[str, str], mode: str = "act") -> None:
        port = free_port(socket.SOCK_DGRAM)
        made = watching(folder, names, f"udpin:127.0.0.1:{port}", mode)
        self.events: list[Event] = []
        self.lines: list[tuple[int, str]] = []
        self.daemon = build_daemon(made)
        self.daemon.components.bus.subscribe("test", self.events.append)
        self.daemon.start()
        hub = self.daemon.components.probes.mavlink
        assert hub is not None
        until(hub.links, "the port opening")
        self.ground: Any = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=255, source_component=190
        )

    def close(self) -> None:
        self.ground.close()
        self.daemon.stop()

    def until(self, wanted: Callable[[], Any], what: str) -> None:
        """Read incoming messages while waiting, and send heartbeats of a ground station."""
        until(wanted, what, lambda: self.lines, step=self._receive)

    def _receive(self) -> None:
        self.ground.mav.send(heartbeat(kind=mavlink.MAV_TYPE_GCS))
        message = self.ground.recv_match(blocking=True, timeout=0.2)
        if message is not None and message.get_type() == "STATUSTEXT":
            self.lines.append((message.severity, message.text))
        elif message is not None and message.get_type() == "COMMAND_ACK":
            self.answer: int | None = message.result

    def ask(self, operation: int, number: int) -> int:
        """The result of the acknowledgement. The command is sent again until there is one, as a ground station does."""
        self.answer = None
        attempts, again_s = itertools.count(), 0.0

        def answered() -> bool:
            nonlocal again_s
            if self.answer is None and time.monotonic() >= again_s:
                self.ground.mav.command_long_send(7, 193, 31010, next(attempts), operation, number, 0, 0, 0, 0, 0)
                again_s = time.monotonic() + AGAIN_S
            return self.answer is not None

        self.until(answered, "the acknowledgement")
        assert self.answer is not None
        return self.answer

    def is_ok(self) -> bool:
        states = self.daemon.pipeline.states()
        return {state.level for state in states if state.unit.startswith("container/")} == {Level.OK}


def started(container: Any) -> str:
    container.reload()
    return str(container.attrs["State"]["StartedAt"])


def test_a_restart_requested_by_the_ground_is_executed_verified_and_reported(real: Any, tmp_path: Path) -> None:
    """The container is restarted, the other one unchanged, no fault is opened, and the ground receives the result."""
    containers = {"app": real.container(RUN), "other": real.container(RUN)}
    agent = Agent(tmp_path, {key: container.name for key, container in containers.items()})
    before = {key: started(container) for key, container in containers.items()}
    try:
        agent.until(agent.is_ok, "all to be is_ok")
        assert agent.ask(RESTART, 2) == mavlink.MAV_RESULT_FAILED, "it has not opted in"
        assert agent.ask(RESTART, 1) == mavlink.MAV_RESULT_ACCEPTED
        agent.until(lambda: (5, "A07 OK 2 restart done: app") in agent.lines, "the line about its end")
    finally:
        agent.close()
    assert started(containers["app"]) != before["app"]
    assert started(containers["other"]) == before["other"]
    assert [event.fault.unit for event in agent.events if isinstance(event, FaultOpened)] == []
    phases = [event.phase.value for event in agent.events if isinstance(event, ActionEvent)]
    assert phases == ["started", "done", "verified"]


def test_a_recommended_action_is_approved_by_the_number_in_its_line(real: Any, tmp_path: Path) -> None:
    """The line has everything that the operator needs: the container is started by approval, and not before."""
    container = real.container(RUN)
    agent = Agent(tmp_path, {"app": container.name}, mode="advise")
    try:
        agent.until(agent.is_ok, "all to be is_ok")
        container.kill()
        agent.until(lambda: any("ADVISE" in text for _, text in agent.lines), "the advice")
        line = next(text for _, text in agent.lines if "ADVISE" in text)
        words, _, rest = line.partition(" #")
        number, _, valid = rest.partition(" ")
        assert (words, valid) == ("A07 ADVISE 2 start app", "60s")
        assert agent.ask(APPROVE, int(number) + 1) == mavlink.MAV_RESULT_FAILED, "there is no such fault"
        container.reload()
        assert container.status == "exited"
        assert agent.ask(APPROVE, int(number)) == mavlink.MAV_RESULT_ACCEPTED
        agent.until(
            lambda: any(text.startswith("A07 OK 2 app started") for _, text in agent.lines), "the end of the fault"
        )
    finally:
        agent.close()
    container.reload()
    assert container.status == "running"
