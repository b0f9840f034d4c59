"""Listens for autopilots on the configured MAVLink endpoints for `phm learn`. It sends nothing."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import Any

from phm.core.clock import Clock
from phm.core.settings import MavlinkSettings
from phm.learn.observations import Observations, ObservedAutopilot
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm.transport.mavlink_signing import InvalidKey

MOST = 32
"""Maximum number of autopilots that are counted."""


@dataclass(slots=True)
class _Heartbeats:
    link: str
    count: int
    last_s: float
    longest_s: float = 0.0


class AutopilotObserver:
    """Call `start`, then `into` at the end."""

    def __init__(self, settings: MavlinkSettings, agent_id: int, clock: Clock, dev_root: str = "/dev") -> None:
        self._clock = clock
        self._urls = {entry.key: entry.url for entry in settings.endpoints}
        self._lock = threading.Lock()
        self._received: dict[int, _Heartbeats] = {}
        self._problem = ""
        self._hub: MavlinkHub | None = None
        try:
            self._hub = MavlinkHub(settings, agent_id, clock, dev_root=dev_root)
            self._hub.listen(self._receive, (mavlink.MAVLINK_MSG_ID_HEARTBEAT,))
        except InvalidKey as error:
            self._problem = f"MAVLink was not watched: {error}"

    def start(self) -> None:
        if self._hub is not None:
            self._hub.start()

    def tick(self) -> None:
        """Nothing to do: frames arrive in the endpoints' threads."""

    def into(self, seen: Observations) -> Observations:
        with self._lock:
            found = tuple(
                ObservedAutopilot(system, heartbeats.link, heartbeats.count, heartbeats.longest_s)
                for system, heartbeats in sorted(self._received.items())
                if heartbeats.count > 1
            )
        problems = [self._problem] if self._problem else []
        for link in self._hub.links() if self._hub is not None else ():
            if not link.open:
                problems.append(
                    f"MAVLink endpoint {link.name} cannot be opened ({link.error}): does the running PHM use it?"
                )
            elif not found and self._urls.get(link.name, "").startswith("udpout:"):
                problems.append(
                    f"no autopilot was received on {link.name}: at udpout:, the other side answers only after PHM has sent, and "
                    "`phm learn` sends nothing. Set mavlink.autopilot yourself"
                )
        return replace(seen, autopilots=found, problems=(*seen.problems, *problems))

    def close(self) -> None:
        if self._hub is not None:
            self._hub.close()

    def _receive(self, message: Any, link: str) -> None:
        if (
            message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1
            or message.autopilot == mavlink.MAV_AUTOPILOT_INVALID
        ):
            return
        now_s, system = self._clock.mono(), int(message.get_srcSystem())
        with self._lock:
            heartbeats = self._received.get(system)
            if heartbeats is None:
                if len(self._received) < MOST:
                    self._received[system] = _Heartbeats(link, 1, now_s)
                return
            heartbeats.longest_s = max(heartbeats.longest_s, now_s - heartbeats.last_s)
            heartbeats.count, heartbeats.last_s = heartbeats.count + 1, now_s
