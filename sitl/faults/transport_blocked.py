"""Discovery between the application and PHM passes, and no data does."""

from __future__ import annotations

import time
from collections.abc import Iterator

from sitl.faults._application import works
from sitl.faults._firewall import blocks, clear, drop
from sitl.faults.base import Agent, Fault

PARTICIPANTS = 15
"""As many ports as one rule takes; PHM's participant is among the first of its container."""


class Injection(Fault):
    """Drops what the application sends to the ports on which DDS takes data, and leaves those of discovery open.

    That is how shared memory without a shared /dev/shm looks from outside, too, but from the start. The nodes reach each other
    by loopback. The rules are the namespace's, and go with a restart.
    """

    name, title, unit = "transport_blocked", "transport blocked, discovery passes", "network/ros_app"
    condition = "transport_blocked"
    layer = "ros"
    cause = "a firewall lets discovery through and no data, or shared memory is not shared"
    evidence, evidence_s = "the next message of its topics does not arrive outside of the container, at 5 Hz", 0.2
    evidence_period_s = 0.2

    def inject(self, agent: Agent) -> float:
        domain = next(
            (
                int(entry.partition("=")[2])
                for entry in agent.app.attrs["Config"]["Env"]
                if entry.startswith("ROS_DOMAIN_ID=")
            ),
            0,
        )
        ports = ",".join(str(port) for port in data_ports(domain))
        moment = time.monotonic()
        drop(agent, f"OUTPUT ! -o lo -p udp -m multiport --dports {ports}")
        return moment

    def clear(self, agent: Agent) -> None:
        clear(agent)

    def restored(self, agent: Agent) -> bool | None:
        return not blocks(agent) and works(agent)


def data_ports(domain: int) -> Iterator[int]:
    """The ports on which the first participants of a ROS domain take data, by the formula of RTPS: unlike those of discovery, odd."""
    return (7400 + 250 * domain + 11 + 2 * participant for participant in range(PARTICIPANTS))
