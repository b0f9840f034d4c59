"""The application container is on its network, but nothing comes through."""

from __future__ import annotations

import fcntl
import socket
import struct
import time
from pathlib import Path

from sitl.faults._world import answers, app_runs
from sitl.faults.base import STOP_S, Agent, Fault

LINKS = Path("/sys/class/net")
SIOCGIFFLAGS, SIOCSIFFLAGS, IFF_UP = 0x8913, 0x8914, 1
"""Of <linux/sockios.h> and <linux/if.h>."""


class Injection(Fault):
    """Takes down the host's end of the application's virtual cable; for the engine the container stays connected."""

    name, title, unit = "address_silent", "interface down, still connected", "network/ros_app"
    condition = "address_silent"
    layer = "container"
    cause = "the virtual cable between the container and its network is down, while the engine believes it connected"
    evidence, evidence_s = "the first message of a topic of 5 Hz that does not arrive", 0.2
    evidence_period_s = 0.2

    _link = ""

    def inject(self, agent: Agent) -> float:
        # One call: a list of all interfaces may miss one while others come and go.
        self._link = socket.if_indextoname(int(agent.run_in_app("cat", "/sys/class/net/eth0/iflink")))
        moment = time.monotonic()
        set_link(self._link, up=False)
        return moment

    def clear(self, agent: Agent) -> None:
        if (LINKS / self._link).exists() and not up(self._link):
            set_link(self._link, up=True)
            # Nodes that were cut off for longer than their lease do not find each other again.
            agent.app.restart(timeout=STOP_S)

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent) and answers(agent.app)


def up(link: str) -> bool:
    return bool(int((LINKS / link / "flags").read_text(), 16) & IFF_UP)


def set_link(link: str, *, up: bool) -> None:
    """`ip link set LINK up|down`, on the host of the engine. Needs root. Raises OSError when there is no such link."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        asked = struct.pack("16sH22x", link.encode(), 0)
        _, flags = struct.unpack("16sH22x", fcntl.ioctl(any_socket, SIOCGIFFLAGS, asked))
        flags = flags | IFF_UP if up else flags & ~IFF_UP
        fcntl.ioctl(any_socket, SIOCSIFFLAGS, struct.pack("16sH22x", link.encode(), flags))
