"""The control client of the air process (`sitl.simulation.link_emulator`): commands for radios, routers and autopilots of a swarm.

One JSON object a line goes there, one comes back, over a separate TCP connection for each call: any number of
programs may do it together, and one that was killed leaves nothing behind.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping, Sequence
from typing import Any

LIMIT_S = 5.0


class LinkEmulatorClient:
    """address: host and port of the air process's control socket.

    Each method raises ConnectionError when it does not answer, ValueError when the request is invalid.
    """

    def __init__(self, address: tuple[str, int]) -> None:
        self.address = address

    def set(self, agent: int, link: str, **how: Any) -> None:
        """Change what one link of one agent is like; what is not named stays unchanged.

        ``ground`` is the pair of telemetry radios to the ground, ``peers`` the agent's radio on the network between agents:
          cut          True: nothing passes either way; the radio itself is there, and a ground radio goes on with RADIO_STATUS
          loss         share of the frames that get lost, 0 to 1, each way
          burst        frames that are lost together on average (1: each by itself)
          delay_s      seconds, each way
          rate_bps     air data rate; a SiK pair carries about 0.4 of it each way
          rssi, noise  in the radios' units; only what RADIO_STATUS says
          fill_bps     bits per second of foreign traffic that the agent's side sends through it (saturation)
          off          True: the radio on board has no power; no RADIO_STATUS either
        ``router`` (on board, between PHM, autopilot and ground radio) and ``autopilot`` (its cable to the router):
          off          True: the router is killed, connections are refused; the autopilot is unplugged
        """
        self._ask("set", agent=agent, link=link, values=how)

    def reset(self, agent: int) -> None:
        """Everything about the agent as it was at the start: links, router and autopilot (which stays armed or disarmed)."""
        self._ask("reset", agent=agent)

    def split(self, groups: Sequence[Sequence[int]]) -> None:
        """Split the peers' network: agents receive only those of their own group. ``[]``: join it again. Agents
        that are in no group receive nothing."""
        self._ask("split", groups=[list(group) for group in groups])

    def autopilot(self, agent: int, what: str, **how: float) -> None:
        """``hang``, ``resume``, ``reboot`` (silent for ``boot_s``, default 6 s, disarmed after), ``arm``, ``disarm``.
        Simulated autopilots alone."""
        self._ask("autopilot", agent=agent, order=what, values=how)

    def traffic(self) -> dict[int, dict[str, int]]:
        """Counters since the start, by agent: ``to_ground`` and ``from_ground`` bytes that the radios were given for the
        air, ``phm_to_ground`` those of them that PHM sent (component 193), ``to_peers``, ``from_peers``, and
        ``ground_lost``, ``peers_lost`` frames that did not arrive."""
        return {int(agent): dict(counters) for agent, counters in self._ask("traffic")["agents"].items()}

    def state(self) -> dict[str, Any]:
        """``{"agents": {K: {"ground": {...}, "peers": {...}, "router": {...}, "autopilot": {...}}}, "groups": [...]}``:
        the current values of all of `set`, ``connected`` of the router (PHM's connections), ``armed``, ``hung``, ``rebooting``."""
        found = self._ask("state")["state"]
        return {**found, "agents": {int(agent): state for agent, state in found["agents"].items()}}

    def _ask(self, what: str, **words: Any) -> Mapping[str, Any]:
        line = json.dumps({"do": what, **words}).encode() + b"\n"
        with socket.create_connection(self.address, LIMIT_S) as connection:
            connection.sendall(line)
            answer = connection.makefile("rb").readline()
        if not answer:
            raise ConnectionError(f"the air process at {self.address[0]}:{self.address[1]} closed without an answer")
        said: dict[str, Any] = json.loads(answer)
        if "error" in said:
            raise ValueError(said["error"])
        return said
