"""A device is unplugged and comes back with other numbers."""

from __future__ import annotations

import os
import time

from sitl.faults._world import app_runs
from sitl.faults.base import NULL, ZERO, Agent, Fault

GONE_S = 2.0
NULL_NUMBERS = os.stat(NULL).st_rdev


class Injection(Fault):
    """Replaces the device's node on the host; the container was started with the old numbers and cannot open the new one."""

    name, title, unit = "device_replugged", f"device replugged, gone for {GONE_S:g} s", "devices/ros_app"
    condition = "device_replugged"
    layer = "container"
    cause = "a cable had a loose contact: the device comes back with other numbers than the container was given"
    evidence, evidence_s = "the kernel's event of a change in /dev", 0.05

    def inject(self, agent: Agent) -> float:
        numbers = agent.device.stat().st_rdev
        like = ZERO if numbers == NULL_NUMBERS else NULL
        moment = time.monotonic()
        agent.device.unlink()
        # No waiting for anything: this is what is injected, a device that needs so long to come back.
        time.sleep(GONE_S)
        agent.make_device(like)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.make_device()

    def restored(self, agent: Agent) -> bool | None:
        if not agent.device.exists() or not app_runs(agent):
            return False
        numbers = agent.device.stat().st_rdev
        look = f"stat -c '%t %T' {agent.device} && : <{agent.device}"
        code, output = agent.app.exec_run(["sh", "-c", look])
        assert isinstance(output, bytes)  # no stream was asked for
        return bool(code == 0 and output.decode().split() == [f"{os.major(numbers):x}", f"{os.minor(numbers):x}"])
