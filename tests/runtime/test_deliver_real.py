"""`phm deliver` to a running agent: real processes, a real port and a simulated autopilot."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.simulation.autopilot import SimulatedAutopilot
from phm.wire import json_log, status_file
from tests.fakes.mavlink import free_port
from tests.fakes.until import until
from tests.runtime.running import LIMIT_S, ROOT

LONG_LIMITS = """
import sys
from phm.commands import delivery_server
from phm.gcs import delivery_client
delivery_server.REQUEST_S = delivery_server.BODY_S = delivery_server.ANSWER_S = delivery_client.CONNECT_S = 60.0
from phm.cli import main
main(sys.argv[1:])
"""
"""`phm` with long limits for the steps of a delivery: a busy machine may stop either end for seconds."""
ENVIRON = {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "checks"))), "PHM_WATCHDOG": "off"}


class Agent:
    """`phm run` with an autopilot beside it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file, self.key = folder, folder / "agent" / "phm.yaml", folder / "delivery.key"
        self.port, companion, ground = free_port(), free_port(), free_port()
        self.file.parent.mkdir()
        self.key.write_text("ab" * 32)
        self.key.chmod(0o600)
        self.base: dict[str, Any] = {
            "agent": {"id": 3, "name": "A03"},
            "interval": "2s",
            "state_dir": str(folder / "state"),
            "run_dir": str(folder / "run"),
            "log": {"directory": str(folder / "log")},
            "checks": {"host": {"enabled": False}},
            # A busy machine may keep the autopilot of this test from sending: it is silent only after a minute.
            "mavlink": {"endpoints": [{"url": f"tcp:127.0.0.1:{companion}"}], "autopilot_timeout": 60},
            "delivery": {"listen": f"127.0.0.1:{self.port}", "key": str(self.key)},
        }
        self.mine = folder / "mine.yaml"
        self.original = folder / "original.yaml"
        for file in (self.file, self.original):
            file.write_text(json.dumps(self.base))
        self.pilot = SimulatedAutopilot(3, f"tcpin:127.0.0.1:{companion}", f"tcpin:127.0.0.1:{ground}")
        self.flying = threading.Thread(target=self.pilot.run, daemon=True)
        self.flying.start()
        self.process = subprocess.Popen(
            [sys.executable, "-c", LONG_LIMITS, "run", "-c", str(self.file)],
            text=True,
            stderr=subprocess.PIPE,
            env=ENVIRON,
        )

    def status(self) -> dict[str, Any]:
        try:
            return status_file.read(str(self.folder / "run"))
        except status_file.NoStatus:
            return {}

    def ready(self) -> bool:
        """Whether the agent knows that the vehicle is disarmed, and listens."""
        if ", disarmed, " not in json.dumps(self.status()):
            return False
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), LIMIT_S):
            return True
        return False

    def deliver(self, *more: str, key: Path | None = None, **changed: Any) -> subprocess.CompletedProcess[str]:
        """By default a change of the present configuration."""
        self.mine.write_text(json.dumps({**self.base, **changed}))
        where = f"127.0.0.1:{self.port}"
        chosen = more or ("--base", str(self.original))
        return subprocess.run(
            [
                sys.executable,
                "-c",
                LONG_LIMITS,
                "deliver",
                str(self.mine),
                where,
                "--key",
                str(key or self.key),
                *chosen,
            ],
            text=True,
            env=ENVIRON,
            capture_output=True,
            timeout=LIMIT_S,
            check=False,
        )

    def lines(self) -> list[str]:
        """Of the log."""
        return [json.dumps(each) for each in json_log.read(self.folder / "log")]

    def close(self) -> None:
        self.process.terminate()
        self.process.communicate(timeout=LIMIT_S)
        self.pilot.stop()
        self.flying.join(LIMIT_S)


@pytest.fixture
def agent(tmp_path: Path) -> Iterator[Agent]:
    made = Agent(tmp_path)
    yield made
    made.close()


@pytest.mark.long
def test_a_configuration_is_delivered_applied_and_recorded(agent: Agent, tmp_path: Path) -> None:
    """Each refusal changes nothing: invalid, a changed base, another key, armed."""
    until(agent.ready, "the agent")
    done = agent.deliver(interval="3s")
    assert (done.returncode, done.stdout, done.stderr) == (0, "A03: configuration reloaded: interval\n", "")
    until(lambda: agent.status().get("interval_s") == 3.0, "the new interval")
    assert json.loads(agent.file.read_text())["interval"] == "3s"
    until(lambda: ", disarmed, " in json.dumps(agent.status()), "the next heartbeat of the autopilot")
    until(lambda: any("replaces" in line and "from 127.0.0.1" in line for line in agent.lines()), "the line in the log")

    again = agent.deliver(interval="4s")
    assert again.returncode == 1 and "another configuration" in again.stderr
    invalid = agent.deliver("--any", interval="soon")
    assert invalid.returncode == 78 and f"{agent.file}:1: interval" in invalid.stderr
    other = tmp_path / "other.key"
    other.write_text("cd" * 32)
    other.chmod(0o600)
    wrong = agent.deliver("--any", key=other, interval="4s")
    assert wrong.returncode == 1 and "key" in wrong.stderr

    agent.pilot.armed = True
    until(lambda: any("the autopilot is armed" in line for line in agent.lines()), "the agent to know it")
    armed = agent.deliver("--any", interval="4s")
    assert armed.returncode == 1 and "known to be disarmed" in armed.stderr
    assert json.loads(agent.file.read_text())["interval"] == "3s"
    assert agent.status()["interval_s"] == 3.0
