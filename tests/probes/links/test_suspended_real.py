"""A real PHM that is suspended, with real senders on a socket: missed data is not a loss, and a real loss is detected."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Level, Slot
from phm.transport.dialect import mavlink
from phm.wire import status_word
from tests.fakes.mavlink import Sender, free_port, heartbeat
from tests.fakes.until import until

ROOT = Path(__file__).parents[3]
TIMEOUT_S, STOPPED_S, PERIOD_S = 4.0, 9.0, 0.5
"""Stopped for more than twice the timeouts: the bound for a PHM that is starved for good must not apply."""
UNITS = ("autopilot", "gcs", "peers/A02")


class Senders:
    """Autopilot, ground station and another agent's PHM, each with two heartbeats per second, on one UDP socket."""

    def __init__(self, port: int) -> None:
        self._sock, self._port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), port
        self.speaks, self._ends = threading.Event(), threading.Event()
        self.speaks.set()
        self.rounds, self.paused_s, self._sent_at = 0, 0.0, time.monotonic()
        """How often it had its turn, and the longest pause between two turns: how late a busy machine made them."""
        word = status_word.encode({Slot.COMPANION: Level.OK})
        self._senders: list[tuple[Sender, Any]] = [
            (Sender(1, 1), heartbeat(5, kind=mavlink.MAV_TYPE_QUADROTOR, autopilot=3)),
            (Sender(255, 190), heartbeat(kind=mavlink.MAV_TYPE_GCS)),
            (Sender(2, 193), heartbeat(word)),
        ]
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def _loop(self) -> None:
        while not self._ends.wait(PERIOD_S):
            self.paused_s, self._sent_at = max(self.paused_s, time.monotonic() - self._sent_at), time.monotonic()
            if self.speaks.is_set():
                for sender, message in self._senders:
                    self._sock.sendto(sender.frame(message), ("127.0.0.1", self._port))
            self.rounds += 1

    def close(self) -> None:
        self._ends.set()
        self._thread.join(60)
        self._sock.close()


class Agent:
    """`phm run` as a process, without the watchdog, which would resume it."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder = folder
        endpoint = {"url": f"udpin:127.0.0.1:{port}", "name": "senders", "leads_to": "both"}
        limits = {"autopilot_timeout": TIMEOUT_S, "gcs_timeout": TIMEOUT_S, "heartbeat": 1.5}
        document = {
            "agent": {"id": 1},
            "interval": 2,
            "swarm": {"agents": [1, 2]},
            "checks": {"host": {"enabled": False}},
            "mavlink": {"endpoints": [endpoint], **limits},
            "log": {"directory": str(folder / "log")},
            "state_dir": str(folder / "state"),
            "run_dir": str(folder / "run"),
        }
        (folder / "phm.yaml").write_text(json.dumps(document))
        self.process = subprocess.Popen(
            [sys.executable, "-m", "phm.cli", "run", "-c", str(folder / "phm.yaml")],
            env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "checks"))), "PHM_WATCHDOG": "off"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def levels(self) -> dict[str, str]:
        try:
            document = json.loads((self.folder / "run" / "status.json").read_text())
        except (OSError, ValueError):
            return {}
        return {entry["id"]: entry["level"] for entry in document["checks"]}

    def is_ok(self) -> bool:
        levels = self.levels()
        return all(levels.get(unit) == "OK" for unit in UNITS)

    def lost(self) -> list[str]:
        """Units of senders with a fault, open or closed, since the start of PHM."""
        lines = (self.folder / "log" / "phm.jsonl").read_text().splitlines()
        events = [json.loads(line) for line in lines if line.endswith("}")]
        opened = [event["unit"] for event in events if event["event"] == "fault_opened"]
        return [unit for unit in opened if unit in {*UNITS, "peers/swarm"}]

    def passes(self) -> int:
        return (self.folder / "log" / "phm.jsonl").read_text().count('"event":"report"')


@pytest.fixture
def senders() -> Iterator[tuple[Senders, int]]:
    port = free_port(socket.SOCK_DGRAM)
    made = Senders(port)
    yield made, port
    made.close()


@pytest.fixture
def agent(tmp_path: Path, senders: tuple[Senders, int]) -> Iterator[Agent]:
    made = Agent(tmp_path, senders[1])
    yield made
    made.process.send_signal(signal.SIGCONT)
    made.process.kill()
    made.process.wait()


@pytest.mark.parametrize("frozen", ["PHM", "the machine"])
def test_a_suspended_phm_reports_no_false_loss_and_detects_a_real_one(
    agent: Agent, senders: tuple[Senders, int], frozen: str
) -> None:
    """Whether senders kept sending or were frozen too; a sender that stays silent afterwards is reported.

    A machine that keeps the senders of this test from sending makes PHM rightly report them: then it is tried again.
    """
    sender, before = senders[0], 0
    for left in reversed(range(5)):
        until(agent.is_ok, "all senders received")
        agent.process.send_signal(signal.SIGSTOP)
        if frozen == "the machine":
            sender.speaks.clear()
        rounds = sender.rounds + STOPPED_S / PERIOD_S
        until(lambda: sender.rounds >= rounds, "the suspension to last")  # noqa: B023
        sender.speaks.set()
        agent.process.send_signal(signal.SIGCONT)
        passes = agent.passes()
        until(lambda: agent.passes() >= passes + 4, "four passes after it")  # noqa: B023
        lost = agent.lost()[before:]
        if not lost or sender.paused_s < TIMEOUT_S / 2 or not left:
            break
        before, sender.paused_s = len(agent.lost()), 0.0
    assert lost == [], f"the senders themselves paused for at most {sender.paused_s:.1f} s"
    before = len(agent.lost())
    sender.speaks.clear()
    until(lambda: "autopilot" in agent.lost()[before:], "the loss of the autopilot")
