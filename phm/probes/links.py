"""What is heard on the MAVLink endpoints: the ground station, our autopilot, and whoever uses our identity."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from phm.clock import Clock
from phm.facts import AutopilotFact, LinkFact
from phm.settings import Settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub

DOUBLES = 2
"""So many heartbeats of another sender within DOUBLE_S make a duplicate: a late echo may come once."""
DOUBLE_S = 30.0


class Links:
    """A `phm.facts.LinkProbe`. `on_wake` is called when a ground station or the autopilot appears or is lost,
    when arming changes, and when an endpoint opens or closes; from the endpoints' threads, so it must not wait.
    """

    def __init__(self, hub: MavlinkHub, settings: Settings, clock: Clock, on_wake: Callable[[], None]) -> None:
        self._hub, self._clock, self._on_wake = hub, clock, on_wake
        self._system = settings.agent.id
        self._timeout_s = settings.mavlink.gcs_timeout
        self._gcs_heard: float | None = None
        self._pilot: tuple[float, AutopilotFact] | None = None
        self._doubles: deque[float] = deque(maxlen=DOUBLES)
        self._shown: tuple[object, ...] = ()
        self._lock = threading.Lock()
        hub.listen(self._hear, (mavlink.MAVLINK_MSG_ID_HEARTBEAT,))
        hub.watch(self.look)
        self._shown = self._picture()

    def gcs_age_s(self) -> float | None:
        heard = self._gcs_heard
        return None if heard is None else self._clock.mono() - heard

    def autopilot(self) -> AutopilotFact | None:
        pilot = self._pilot
        if pilot is None:
            return None
        heard, fact = pilot
        return AutopilotFact(self._clock.mono() - heard, fact.armed, fact.custom_mode, fact.system_status)

    def links(self) -> tuple[LinkFact, ...]:
        return self._hub.links()

    def problems(self) -> tuple[str, ...]:
        """Sentences about our own identity on the links."""
        doubles = tuple(self._doubles)
        if len(doubles) < DOUBLES or self._clock.mono() - doubles[0] > DOUBLE_S:
            return ()
        return (
            f"another program sends MAVLink heartbeats as system {self._system} component {self._hub.component_id}, "
            "so routers hide one of the two: give one of them another component id (mavlink.component_id) or agent id",
        )

    def look(self) -> None:
        """Wake the checks when the picture has changed since the last time, be it by silence."""
        picture = self._picture()
        with self._lock:
            changed, self._shown = picture != self._shown, picture
        if changed:
            self._on_wake()

    def _picture(self) -> tuple[object, ...]:
        """What a check would judge differently; ages only as far as they matter."""
        pilot = self.autopilot()
        flying = None if pilot is None else (pilot.age_s <= self._timeout_s, pilot.armed)
        gcs_age_s = self.gcs_age_s()
        gcs = None if gcs_age_s is None else gcs_age_s <= self._timeout_s
        return gcs, flying, bool(self.problems()), tuple((link.name, link.open) for link in self.links())

    def _hear(self, message: Any, link: str) -> None:
        now = self._clock.mono()
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if (system, component) == (self._system, self._hub.component_id):
            if not self._hub.echo(bytes(message.get_msgbuf())):
                self._doubles.append(now)
        elif system == self._system and component == mavlink.MAV_COMP_ID_AUTOPILOT1:
            if message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
                armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
                self._pilot = (now, AutopilotFact(0.0, armed, message.custom_mode, message.system_status))
        elif message.type == mavlink.MAV_TYPE_GCS and system != self._system:
            # With our own system id it is a program aboard that calls itself a ground station.
            self._gcs_heard = now
        self.look()
