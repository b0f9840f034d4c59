"""A device that the application uses is unplugged."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Removes the device's node from the host. No software brings it back: PHM reports it and waits."""

    name, title, unit = "device_gone", "device unplugged", "devices/ros_app"
    condition = "device_missing"
    layer = "container"
    cause = "a cable came off or a device lost its power"
    healable = False
    evidence, evidence_s = "the kernel's event of a change in /dev", 0.05

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.device.unlink(missing_ok=True)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.make_device()

    def restored(self, agent: Agent) -> bool | None:
        return agent.device.exists()
