"""A vehicle for ground software of other projects: a complete PHM beside a simulated autopilot, and faults of each severity."""

from __future__ import annotations

import hashlib
import threading
from pathlib import Path

from phm.core.model import worst_by_slot
from phm.runtime.wiring import build_daemon
from phm.simulation.autopilot import SimulatedAutopilot
from phm.simulation.autopilot_model import AUTOPILOT
from phm.testing import settings
from phm.wire import status_word
from tests.fakes.engine import FakeEngine, container
from tests.fakes.mavlink import free_port
from tests.fakes.until import until

SYSTEM, COMPONENT = 7, 193
FAIL = "A07 FAIL 2 ros_app exited"
FIXED = "A07 OK 2 ros_app recovered"
WARN, ERROR = "A07 WARN 9 disk", "A07 FAIL 9 memory"


def _signed(folder: Path, passphrase: str) -> dict[str, object]:
    """The configuration keys for signing."""
    if not passphrase:
        return {}
    key = folder / "mavlink.key"
    key.write_text(hashlib.sha256(passphrase.encode()).hexdigest())
    key.chmod(0o600)
    return {"signing": {"key": str(key)}, "commands": ["status", "details", "check", "approve"]}


class Vehicle:
    """Vehicle 7: the autopilot's ground port is `tcp:127.0.0.1:<port>`, PHM is connected to its companion port and is also
    reachable directly at `tcp:127.0.0.1:<direct>`, as by its own radio. Everything runs in this process. The disk is WARN
    and the memory ERROR from the start; `break_container` is CRITICAL, `repair_container` NOTICE. With a passphrase PHM
    signs, with the key that Mission Planner and MAVProxy derive from it, and permits the command to run its checks.
    """

    def __init__(self, folder: Path, passphrase: str = "") -> None:
        self.port, self.direct, self.companion = free_port(), free_port(), free_port()
        self.pilot = SimulatedAutopilot(SYSTEM, f"tcpin:127.0.0.1:{self.companion}", f"tcpin:127.0.0.1:{self.port}")
        self._thread = threading.Thread(target=self.pilot.run, name="autopilot", daemon=True)
        self._thread.start()
        self.engine = FakeEngine(folder / "engine.sock")
        self.engine.containers["ros_app"] = container("ros_app")
        self.engine.__enter__()
        made = settings(
            agent={"id": SYSTEM},
            interval=1,
            state_dir=str(folder / "state"),
            run_dir=str(folder / "run"),
            log={"directory": str(folder / "log")},
            checks={"peers": {"enabled": False}},
            docker={"socket": self.engine.url},
            containers=[{"name": "ros_app"}],
            recovery={"mode": "off"},
            host={
                "memory": {"warn": 0, "error": 0},
                "disk": {"warn": 0, "error": 100},
                "cpu": {"warn": 100, "error": 100},
            },
            mavlink={
                "endpoints": [
                    {"url": f"tcp:127.0.0.1:{self.companion}", "name": "fc", "budget": 0, "leads_to": "both"},
                    {"url": f"tcpin:127.0.0.1:{self.direct}", "name": "direct", "budget": 0, "leads_to": "ground"},
                ],
                "heartbeat": 0.5,
                "refresh": 2,
                "autopilot_timeout": 2,
                **_signed(folder, passphrase),
            },
        )
        self.daemon = build_daemon(made)
        self.daemon.start()

    def break_container(self) -> None:
        self.engine.set("ros_app", status="exited", exit_code=1)

    def repair_container(self) -> None:
        self.engine.set("ros_app", status="running")

    def hang_autopilot(self) -> None:
        """From now on the autopilot sends nothing. Not before PHM has received it: without `autopilot: true` PHM expects none."""
        until(lambda: (SYSTEM, AUTOPILOT) in self.senders(), "PHM to receive the autopilot")
        self.pilot.hung = True

    def senders(self) -> set[tuple[int, int]]:
        """System and component of every sender that PHM receives."""
        return {
            (sender.system, sender.component)
            for link in self.daemon.components.probes.world.links.links()
            for sender in link.senders
        }

    def status_word(self) -> int:
        return status_word.encode(worst_by_slot(self.daemon.pipeline.states()))

    def close(self) -> None:
        self.daemon.stop()
        self.pilot.stop()
        self._thread.join(60)
        self.engine.__exit__(None, None, None)
