"""Evaluates data received on the MAVLink endpoints: ground station, radios, autopilot, traffic, other users of PHM's
identity."""

from __future__ import annotations

import errno
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from phm.core.clock import Clock
from phm.core.settings import MavlinkSettings
from phm.facts import AutopilotFact, GcsFact, LinkFact, RadioFact
from phm.probes import boot_time
from phm.probes.adaptive_timeout import UNEVEN_S
from phm.probes.autopilot_state import AutopilotState
from phm.probes.blocking_call import BlockingCallWorker
from phm.probes.ground_stations import GroundStations, StationHeartbeat, counts_as_pilot
from phm.probes.link_radio import RadioState
from phm.probes.link_stats import LinkStats
from phm.probes.serial_port_users import users
from phm.probes.unexpected_senders import UnexpectedSenders
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm.transport.mavlink_endpoint import IDLE_S
from phm.transport.priority import MessagePriority, default_periods

DOUBLES = 2
"""This many heartbeats of another sender within DOUBLE_S are a duplicate: a late echo may come once."""
DOUBLE_S = 30.0
STALL_S = 1.2
"""PHM reads each open endpoint twice a second. After a longer break PHM was suspended, not the sender."""
GONE, GONE_REFUSED = 4, 2
"""After this many failed attempts to reopen an endpoint, or refusals, nothing will arrive on it soon: 1.5 s, 0.3 s."""
USERS_S = 1.0
"""Deadline for determining which program uses a port."""
STATUS = mavlink.MAVLINK_MSG_ID_RADIO_STATUS


class Links:
    """A `phm.facts.LinkProbe`.

    `on_wake` is called when a sender appears or is lost, when arming changes, when the autopilot reboots, and when an
    endpoint opens or closes; from the endpoints' threads, so it must not block.
    """

    def __init__(
        self, hub: MavlinkHub, agent: int, settings: MavlinkSettings, clock: Clock, on_wake: Callable[[], None]
    ) -> None:
        self._hub, self._clock, self._on_wake = hub, clock, on_wake
        self._system, self._settings = agent, settings
        self._pilots_gcs = GroundStations(self._settings.gcs_timeout)
        self._any_gcs = GroundStations(self._settings.gcs_timeout)
        """Also stations that are not the pilot's: who relays to the ground depends on them."""
        self._unreached = False
        """It was unreachable and has sent nothing since: a radio at the edge of its range repeatedly finds and loses
        the other one."""
        self._pilot = AutopilotState(self._settings.autopilot_timeout, clock.late_s)
        self._pilot_links = frozenset(entry.key for entry in self._settings.endpoints if entry.to_autopilot)
        self._strays = UnexpectedSenders()
        self._boot_time = boot_time.BootTimeRequests(agent) if settings.request_boot_time else None
        self._sampled: float | None = None
        self._ground = frozenset(entry.key for entry in self._settings.endpoints if entry.to_ground)
        self._radios: dict[str, RadioState] = {}
        self._flows: dict[str, LinkStats] = {}
        self._doubles: deque[float] = deque(maxlen=DOUBLES)
        self._worker = BlockingCallWorker("ports")
        self._shown: tuple[object, ...] = ()
        self._lock = threading.RLock()
        hub.listen(self._receive, (mavlink.MAVLINK_MSG_ID_HEARTBEAT,))
        hub.listen(self._receive_radio, (STATUS,))
        hub.listen(self._receive_time, boot_time.TIMES)
        hub.listen(self._receive_reboot, boot_time.REBOOTS)
        hub.watch(self._sample)
        self._shown = self._picture()

    def resume(self, before: Links) -> None:
        """Go on with what the predecessor has received on the same endpoints (after a reload, which never changes them): else a sender
        that is lost would seem to be one that was never there."""
        with before._lock, self._lock:
            self._pilots_gcs, self._any_gcs, self._unreached = before._pilots_gcs, before._any_gcs, before._unreached
            self._pilot, self._radios, self._flows = before._pilot, before._radios, before._flows

    def close(self) -> None:
        """End the thread that looks for the users of a port. The endpoints stay open: they are the hub's."""
        self._worker.close()

    # ------------------------------------------------------------ queries of checks

    def gcs_age_s(self) -> float | None:
        """Seconds since the last heartbeat of a ground station; None: none was received."""
        gcs = self._fact(self._any_gcs)
        return None if gcs is None else gcs.silent_s

    def gcs(self) -> GcsFact | None:
        return self._fact(self._pilots_gcs)

    def _fact(self, stations: GroundStations) -> GcsFact | None:
        with self._lock:
            last = stations.last
            if last is None:
                return None
            read_at, due_s = self._hub.read_at(last.link), stations.cadence.due_s()
            overdue = stations.cadence.overdue(read_at, self._clock.late_s)
            not_counted_s = self._not_counted_s(last.at, last.link, self._settings.gcs_timeout)
            age_s = self._clock.mono() - last.at
            return GcsFact(age_s, last.system, last.component, last.link, due_s, overdue, not_counted_s, stations.left)

    def gcs_unreachable(self) -> bool:
        """Whether this agent certainly cannot reach a ground station, even if `gcs_timeout` has not passed: the radio on board
        has lost its counterpart, or all endpoints to the ground are gone. Silence of the ground alone does not prove it."""
        return self._gcs_unreachable(self._fact(self._any_gcs), self.radios())

    def autopilot(self) -> AutopilotFact | None:
        with self._lock:
            return self._pilot.fact(self._clock.mono(), self._hub.read_at, self._unread_s(self._pilot.link))

    def radios(self) -> tuple[RadioFact, ...]:
        with self._lock:
            limit_s = self._settings.radio_timeout
            facts = [
                radio.fact(self._clock.mono(), self._not_counted_s(radio.received_at, link, limit_s))
                for link, radio in self._radios.items()
            ]
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
        """Sentences about identities on the links: PHM's own, and the autopilot's."""
        now, found = self._clock.mono(), []
        doubles = tuple(self._doubles)
        if len(doubles) == DOUBLES and now - doubles[0] <= DOUBLE_S:
            found.append(
                f"another program sends MAVLink heartbeats as system {self._system} component {self._hub.component_id}, "
                "so routers hide one of the two: give one of them another component id (mavlink.component_id) or agent id"
            )
        with self._lock:
            twins = self._pilot.identity_shared(now)
            stray = self._strays.link(now, self._pilot.boot_s(now))
        if twins:
            found.append(
                f"two autopilots send as system {self._system} (their times since boot or armed states differ): "
                "give each vehicle its own system id"
            )
        if stray:
            found.append(
                f"heartbeats of an autopilot with our system id {self._system} arrive by {stray}, which does not lead to it, "
                "and are ignored: give each vehicle its own system id, or correct leads_to of the endpoint"
            )
        return tuple(found)

    def _not_counted_s(self, received_at: float, link: str, limit_s: float) -> float:
        """Time since then in which PHM did not run or had not read this link: frames may wait in it. At most `limit_s`
        for a link that PHM no longer reads."""
        return max(min(self._unread_s(link), limit_s), self._clock.late_s(received_at, limit_s))

    def _unread_s(self, link: str) -> float:
        """How long an open link should have been read, and was not."""
        read_at = self._hub.read_at(link)
        return 0.0 if read_at is None else max(0.0, self._clock.mono() - read_at - IDLE_S)

    # ------------------------------------------------------------ from the endpoints' threads

    def wake_if_changed(self) -> None:
        """Wake the checks if the state has changed since the last call, also because of silence."""
        with self._lock:
            picture = self._picture()
            changed, self._shown = picture != self._shown, picture
        if changed:
            self._on_wake()

    def _sample(self) -> None:
        now, own = self._clock.mono(), (self._system, self._hub.component_id)
        links = self._hub.links()
        closed = {link.name for link in links if not link.open}
        with self._lock:
            before, self._sampled = self._sampled, now if len(closed) < len(links) else None
            if before is not None and now - before > STALL_S:
                self._pilot.stalled(now)
            for stations in (self._pilots_gcs, self._any_gcs):
                if stations.last is not None and stations.last.link in closed:
                    stations.cadence.broke(now)
            if self._pilot.link in closed:
                self._pilot.broke(now)
            for name, traffic in self._hub.traffic().items():
                self._flows.setdefault(name, LinkStats(own, self._clock.late_s)).sample(now, traffic)
            link, request = self._pilot.link, self._boot_time and self._boot_time.due(now, self._pilot.fact(now))
        if request is not None:
            self._hub.send(request, MessagePriority.REQUEST, key="boot time", link=link)
        self.wake_if_changed()

    def _picture(self) -> tuple[object, ...]:
        """The state for checks; ages only as coarse as they matter."""
        pilot, limits, gcs = self.autopilot(), self._settings, self.gcs()
        flying = None
        if pilot is not None:
            lost = (pilot.silent_s > limits.autopilot_timeout, pilot.overdue)
            flying = (lost, pilot.armed, pilot.reboots, pilot.rebooting_s is None)
        ground = None if gcs is None else (gcs.silent_s > limits.gcs_timeout, gcs.overdue, gcs.left)
        received = self.radios()
        unreachable = self._gcs_unreachable(self._fact(self._any_gcs), received)
        radios = tuple((radio.silent_s <= limits.radio_timeout, *_report(radio)) for radio in received)
        links = tuple((link.name, link.open, _gone(link)) for link in self._hub.links())
        return ground, unreachable, flying, len(self.problems()), radios, links

    def _gcs_unreachable(self, gcs: GcsFact | None, radios: tuple[RadioFact, ...]) -> bool:
        gone = {link.name for link in self._hub.links() if _gone(link)}
        cut = bool(self._ground) and self._ground <= gone
        if gcs is None:
            return cut
        lost = any(radio.alone and radio.link == gcs.link and radio.age_s < gcs.age_s for radio in radios)
        if cut or (lost and gcs.silent_s > UNEVEN_S):
            self._unreached = True
        return self._unreached

    def _receive(self, message: Any, link: str) -> None:
        now = self._clock.mono()
        system, component = message.get_srcSystem(), message.get_srcComponent()
        read_at = self._hub.read_at(link)
        stalled = read_at is not None and now - read_at > STALL_S
        if (system, component) == (self._system, self._hub.component_id):
            if not self._hub.echo(bytes(message.get_msgbuf())):
                self._doubles.append(now)
        elif self._is_pilot(message):
            if message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
                self._receive_pilot(now, message, link, stalled=stalled)
        elif message.type == mavlink.MAV_TYPE_GCS and system != self._system:
            # With our own system id it is a program on board that acts as a ground station.
            self._receive_ground(now, message, link, stalled=stalled)
        self.wake_if_changed()

    def _receive_ground(self, now: float, message: Any, link: str, *, stalled: bool) -> None:
        system, component = message.get_srcSystem(), message.get_srcComponent()
        leaving = message.system_status == mavlink.MAV_STATE_POWEROFF
        signed = bool(message.get_signed())
        with self._lock:
            if leaving:
                self._pilots_gcs.announce_end(system, component, now, signed=signed)
                return
            self._unreached = False
            for stations in (self._pilots_gcs, self._any_gcs):
                if stations is self._any_gcs or counts_as_pilot(system, message.custom_mode, self._settings.pilots):
                    if stalled:
                        stations.cadence.broke(now)
                    late_s = 0.0 if stations.last is None else self._clock.late_s(stations.last.at)
                    stations.heartbeat(StationHeartbeat(now, system, component, link, signed), late_s)

    def _receive_pilot(self, now: float, message: Any, link: str, *, stalled: bool) -> None:
        with self._lock:
            if link not in self._pilot_links:
                self._strays.heartbeat(now, link)
                return
            if stalled:
                self._pilot.stalled(now)
            self._pilot.heartbeat(now, message, link)

    def _receive_radio(self, message: Any, link: str) -> None:
        asked_s = self._settings.heartbeat or default_periods(self._hub.agents)[0]
        with self._lock:
            self._radios.setdefault(link, RadioState(link)).receive(self._clock.mono(), message, asked_s)
        self.wake_if_changed()

    def _receive_time(self, message: Any, link: str) -> None:
        boot_ms = boot_time.boot_ms(message)
        if boot_ms is not None and self._is_pilot(message):
            with self._lock:
                if link not in self._pilot_links:
                    self._strays.booted(self._clock.mono(), boot_ms / 1000.0, link)
                    return
                before = self._pilot.reboots
                self._pilot.booted(self._clock.mono(), boot_ms)
                rebooted = self._pilot.reboots != before
            if rebooted:
                self.wake_if_changed()

    def _receive_reboot(self, message: Any, link: str) -> None:
        if link not in self._pilot_links or not self._is_pilot(message):
            return
        with self._lock:
            if boot_time.has_started(message):
                self._pilot.ready(self._clock.mono())
            elif boot_time.will_reboot(message):
                self._pilot.commanded(self._clock.mono())
        self.wake_if_changed()

    def _is_pilot(self, message: Any) -> bool:
        own = message.get_srcSystem() == self._system
        return bool(own and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1)


def _gone(link: LinkFact) -> bool:
    return not link.open and link.failed >= (GONE_REFUSED if link.code == errno.ECONNREFUSED else GONE)


def _report(radio: RadioFact) -> tuple[object, ...]:
    """The state of a radio, as coarse as checks evaluate it: an unchanged one wakes no check."""
    margins = (None if margin is None else round(margin / 4) for margin in (radio.margin, radio.remmargin))
    errors_s = None if radio.rxerrors_s is None else round(radio.rxerrors_s)
    return radio.link, radio.alone, radio.txbuf // 10, errors_s, *margins
