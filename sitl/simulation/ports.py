"""Ports of the link emulator."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Ports:
    """The router of agent K, and its radio on the network between agents, have the given port plus K. 0: any free one."""

    ground: int = 0
    control: int = 0
    router: int = 0
    peers: int = 0

    def router_of(self, agent: int) -> int:
        return self.router + agent if self.router else 0

    def peers_of(self, agent: int) -> int:
        return self.peers + agent if self.peers else 0


INSIDE = Ports(ground=5500, control=5501, router=5600, peers=14600)
"""In its own container, where simulated ArduPilots have 5760 + 10 i beside them."""
