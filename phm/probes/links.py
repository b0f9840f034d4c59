"""What is heard on the MAVLink endpoints: ground station, radios, our autopilot, the traffic, and whoever uses our identity."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from phm.clock import Clock
from phm.facts import AutopilotFact, GcsFact, LinkFact, RadioFact
from phm.probes.link_flow import Flow
from phm.probes.link_pilot import Pilot
from phm.probes.link_radio import Radio
from phm.probes.link_users import users
from phm.probes.worker import Worker
from phm.settings import Settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm.transport.mavlink_budget import periods

DOUBLES = 2
"""So many heartbeats of another sender within DOUBLE_S make a duplicate: a late echo may come once."""
DOUBLE_S = 30.0
USERS_S = 1.0
"""Deadline of a look at who has a port open."""
STATUS = mavlink.MAVLINK_MSG_ID_RADIO_STATUS
BOOTED = (
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
)  # fmt: skip
"""Messages of an autopilot that carry `time_boot_ms`."""


class Links:
    """A `phm.facts.LinkProbe`. `on_wake` is called when something appears or is lost, when arming changes, when the autopilot
    reboots, and when an endpoint opens or closes; from the endpoints' threads, so it must not wait.
    """

    def __init__(self, hub: MavlinkHub, settings: Settings, clock: Clock, on_wake: Callable[[], None]) -> None:
        self._hub, self._clock, self._on_wake = hub, clock, on_wake
        self._system, self._settings = settings.agent.id, settings.mavlink
        self._gcs: tuple[float, int, int, str] | None = None
        self._pilot = Pilot()
        self._radios: dict[str, Radio] = {}
        self._flows: dict[str, Flow] = {}
        self._doubles: deque[float] = deque(maxlen=DOUBLES)
        self._worker = Worker("ports")
        self._shown: tuple[object, ...] = ()
        self._lock = threading.RLock()
        hub.listen(self._hear, (mavlink.MAVLINK_MSG_ID_HEARTBEAT,))
        hub.listen(self._hear_radio, (STATUS,))
        hub.listen(self._hear_time, BOOTED)
        hub.watch(self._sample)
        self._shown = self._picture()

    # ------------------------------------------------------------ what checks ask

    def gcs_age_s(self) -> float | None:
        gcs = self._gcs
        return None if gcs is None else self._clock.mono() - gcs[0]

    def gcs(self) -> GcsFact | None:
        gcs = self._gcs
        return None if gcs is None else GcsFact(self._clock.mono() - gcs[0], *gcs[1:])

    def autopilot(self) -> AutopilotFact | None:
        with self._lock:
            return self._pilot.fact(self._clock.mono())

    def radios(self) -> tuple[RadioFact, ...]:
        with self._lock:
            facts = [radio.fact(self._clock.mono()) for radio in self._radios.values()]
        return tuple(fact for fact in facts if fact is not None)

    def links(self) -> tuple[LinkFact, ...]:
        now = self._clock.mono()
        with self._lock:
            return tuple(
                self._flows[base.name].fact(now, base) if base.name in self._flows else base
                for base in self._hub.links()
            )

    def users(self, path: str) -> tuple[str, ...]:
        return self._worker.call(lambda: users(path), USERS_S)

    def problems(self) -> tuple[str, ...]:
        """Sentences about identities on the links: our own, and our autopilot's."""
        now, found = self._clock.mono(), []
        doubles = tuple(self._doubles)
        if len(doubles) == DOUBLES and now - doubles[0] <= DOUBLE_S:
            found.append(
                f"another program sends MAVLink heartbeats as system {self._system} component {self._hub.component_id}, "
                "so routers hide one of the two: give one of them another component id (mavlink.component_id) or agent id"
            )
        with self._lock:
            twins = self._pilot.twins(now)
        if twins:
            found.append(
                f"two autopilots speak as system {self._system}, as their times since boot differ: give each vehicle a "
                "system id of its own"
            )
        return tuple(found)

    # ------------------------------------------------------------ from the endpoints' threads

    def look(self) -> None:
        """Wake the checks when the picture has changed since the last time, be it by silence."""
        with self._lock:
            picture = self._picture()
            changed, self._shown = picture != self._shown, picture
        if changed:
            self._on_wake()

    def _sample(self) -> None:
        now, own = self._clock.mono(), (self._system, self._hub.component_id)
        with self._lock:
            for name, traffic in self._hub.traffic().items():
                self._flows.setdefault(name, Flow(own)).sample(now, traffic)
        self.look()

    def _picture(self) -> tuple[object, ...]:
        """What a check would judge differently; ages only as far as they matter."""
        pilot, limits = self.autopilot(), self._settings
        flying = None if pilot is None else (pilot.age_s <= limits.autopilot_timeout, pilot.armed, pilot.reboots)
        gcs_age_s = self.gcs_age_s()
        gcs = None if gcs_age_s is None else gcs_age_s <= limits.gcs_timeout
        radios = tuple((radio.link, radio.age_s <= limits.radio_timeout) for radio in self.radios())
        links = tuple((link.name, link.open) for link in self._hub.links())
        return gcs, flying, len(self.problems()), radios, links

    def _hear(self, message: Any, link: str) -> None:
        now = self._clock.mono()
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if (system, component) == (self._system, self._hub.component_id):
            if not self._hub.echo(bytes(message.get_msgbuf())):
                self._doubles.append(now)
        elif self._is_pilot(message):
            if message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
                with self._lock:
                    self._pilot.heartbeat(now, message, link)
        elif message.type == mavlink.MAV_TYPE_GCS and system != self._system:
            # With our own system id it is a program aboard that calls itself a ground station.
            self._gcs = (now, system, component, link)
        self.look()

    def _hear_radio(self, message: Any, link: str) -> None:
        asked_s = self._settings.heartbeat or periods(self._hub.agents)[0]
        with self._lock:
            self._radios.setdefault(link, Radio(link)).hear(self._clock.mono(), message, asked_s)
        self.look()

    def _hear_time(self, message: Any, link: str) -> None:
        if self._is_pilot(message):
            with self._lock:
                before = self._pilot.reboots
                self._pilot.booted(self._clock.mono(), message.time_boot_ms)
                rebooted = self._pilot.reboots != before
            if rebooted:
                self.look()

    def _is_pilot(self, message: Any) -> bool:
        own = message.get_srcSystem() == self._system
        return bool(own and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1)
