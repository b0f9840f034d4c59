"""Receives MAVLink frames, updates the fleet's state, and passes its events to subscribers.

It sends one HEARTBEAT a second like any ground station, because an ArduPilot forwards frames only to a link that has sent one,
and a last one with POWEROFF. It sends a command only when the operator requests it.
"""

from __future__ import annotations

import errno
import logging
import threading
import uuid
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from phm import __version__
from phm.core import threads
from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import Clock
from phm.core.model import Stamp
from phm.core.scheduling_delay import WINDOW_S
from phm.core.settings import MavlinkSettings
from phm.gcs import frames
from phm.gcs.events import GcsEvent, encode
from phm.gcs.fleet_state import FleetState
from phm.gcs.frames import Frame
from phm.gcs.ingress_filter import IngressFilter
from phm.gcs.operator import OperatorCommand
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from phm.reporters.received_heartbeats import ReceivedHeartbeats
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from phm.wire.gcs_marker import MONITOR
from phm.wire.status_line import agent_name

logger = logging.getLogger(__name__)

COMPONENT = mavlink.MAV_COMP_ID_MISSIONPLANNER
"""Component id 190, which ground stations use."""
HEARTBEAT_S = 1.0
TICK_S = 0.2
LATE_MOST_S = 5.0
"""The ground's own delays of the last minute extend the time before an agent is lost by at most this much."""
MAX_WAITING = 4096
"""Frames between the endpoints' threads and the station's."""
CLOSE_LIMIT_S = 3.0
MEASURED = (frames.ComputerStatus, frames.NamedValue)
TAKEN = frozenset((errno.EADDRINUSE, errno.EADDRNOTAVAIL, errno.EACCES, errno.EPERM))
"""Errors of a listening port that waiting does not fix."""
_LISTENING = ("udpin:", "tcpin:")


@dataclass(frozen=True, slots=True)
class Received:
    """A frame as it was received, from which link and when. of_agent: it is the heartbeat of a PHM."""

    frame: Frame
    raw: bytes
    link: str
    at: Stamp
    of_agent: bool = False


class GroundStation:
    """Receives on all links; `start` opens them. Raises InvalidKey."""

    def __init__(
        self,
        settings: MavlinkSettings,
        system: int,
        clock: Clock,
        expected: Iterable[int] = (),
        *,
        silent: bool = False,
        pilot: bool = False,
    ) -> None:
        """system: our own MAVLink id. silent: send nothing at all. pilot: agents report the loss of this station."""
        self.ids = (system, settings.component_id)
        self.run = uuid.uuid4().hex[:12]
        self.silent = silent
        self._urls, self._clock = [entry.key for entry in settings.endpoints], clock
        self._mode = 0 if pilot else MONITOR
        # Each PHM with the key signs all that it sends.
        signed = settings.signing.key is not None and settings.signing.unsigned != "all"
        self._signed = signed
        """Unsigned frames are not PHM's."""
        self._store, self._hub = FleetState(expected, self.ids, signed=signed), MavlinkHub(settings, system, clock)
        self.expected = frozenset(agent_name(number) for number in self._store.fleet.expected)
        """Names of the agents that are reported as missing even if never received."""
        self._filter = IngressFilter()
        self._frames: BoundedQueue[Received] = BoundedQueue(clock, MAX_WAITING, refuse_new=True)
        self._queues: tuple[SubscriberQueue, ...] = ()
        self._watchers: tuple[BoundedQueue[Received], ...] = ()
        self._number = 0
        self.commands_sent = 0
        self._problems: tuple[str, ...] = ()
        self._twin = ""
        self._tick_at = self._beat_at = float("-inf")
        self._lock, self._limits = threading.Lock(), threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-gcs", daemon=True)
        self._received = ReceivedHeartbeats(None, clock)
        self._hub.listen(self._receive, frames.IDS)
        self._hub.on_heartbeat_sent(lambda number: self._received.receive(*self.ids, number))

    def start(self) -> None:
        body = {"version": __version__, "system": self.ids[0], "component": self.ids[1], "links": self._urls}
        with self._lock:
            self._publish([GcsEvent(self._clock.stamp(), "start", body)])
        self._hub.start()
        threads.start(self._thread)

    def close(self) -> None:
        """Close all links within seconds, even if one hangs."""
        self._stop.set()
        self._frames.wake()
        if self._thread.ident is not None:
            self._thread.join(CLOSE_LIMIT_S)
        self._heartbeat(mavlink.MAV_STATE_POWEROFF)
        self._hub.close()
        with self._lock:
            self._publish([GcsEvent(self._clock.stamp(), "end", {})])

    def taken(self, timeout_s: float) -> str:
        """Why a listening port cannot be opened, empty if all can; waits until each was tried."""
        listening = {url for url in self._urls if url.startswith(_LISTENING)}
        end = self._clock.mono() + timeout_s
        while True:
            facts = [link for link in self._hub.links() if link.name in listening]
            for link in facts:
                if not link.open and link.code in TAKEN:
                    return f"{link.name}: {link.error}"
            if len(facts) == len(listening) or self._clock.mono() >= end:
                return ""
            self._clock.wait(self._stop, 0.02)

    def command(
        self, system: int, component: int, command: OperatorCommand, confirmation: int, nonce: float, link: str = ""
    ) -> None:
        """Send a command to one agent, on the link by which it is received; never waits. confirmation: counts repetitions from 0.
        nonce: of the request, an integer below `LARGEST`; an agent takes equal commands within seconds for one."""
        self.commands_sent += 1
        rest = (float(command.name_hash), command.for_s, 0.0, 0.0, nonce)
        self._hub.send(
            mavlink.MAVLink_command_long_message(
                system, component, command.command, confirmation, *map(float, command.params), *rest
            ),
            link=link,
        )

    def forget_containers(self, system: int, component: int) -> None:
        """Forget which containers an agent has named, before it is asked again."""
        with self._lock:
            agent = self._store.fleet.agents.get((system, component))
            if agent is not None:
                agent.forget_containers()

    def subscribe(self, queue: SubscriberQueue) -> None:
        """Put all events into this queue from now on."""
        with self._lock:
            self._queues = (*self._queues, queue)

    def watch(self, queue: BoundedQueue[Received]) -> None:
        """Put all accepted frames into this queue from now on: heartbeats that change nothing are no events."""
        with self._lock:
            self._watchers = (*self._watchers, queue)

    def snapshot(self, *, moments: bool = False, only: Collection[int] | None = None) -> tuple[int, GcsEvent]:
        """The state of all agents, and the number of the last event in it. moments, only: as in `snapshot.fleet_json`."""
        with self._lock:
            at = self._clock.stamp()
            body = {
                "system": self.ids[0],
                "component": self.ids[1],
                **self._store.snapshot(self._judged_at(at), moments=moments, only=only),
                "problems": list(self._problems),
                "frames_refused": self._filter.refused + self._frames.dropped,
            }
            return self._number, GcsEvent(at, "snapshot", body)

    def received(self) -> tuple[int, GcsEvent] | None:
        """The heartbeats that were received and sent since the last call, in the numbering of the agents' logs, at most every 10 s;
        and the number of the last event before. None: there is nothing yet."""
        found = self._received.take()
        return self.record_only("received", {"frames": found}) if found else None

    def record_only(self, event: str, body: Mapping[str, Any]) -> tuple[int, GcsEvent]:
        """An event for the record alone, and the number of the last event before."""
        with self._lock:
            return self._number, GcsEvent(self._clock.stamp(), event, body)

    def line(self, number: int, event: GcsEvent) -> bytes:
        """The event as one line of JSON, without the line end."""
        return encode(event, self.run, number)

    # ------------------------------------------------------------ from the endpoints' threads

    def _receive(self, message: Any, link: str) -> None:
        sender = (message.get_srcSystem(), message.get_srcComponent())
        raw, at = bytes(message.get_msgbuf()), self._clock.stamp()
        if sender == self.ids:
            if not self._hub.echo(raw):
                self._twin = (
                    f"another program sends as system {sender[0]} component {sender[1]}, and routers drop one of the "
                    "two: give this one another id (--id)"
                )
            return
        frame = frames.parse(message)
        signed = bool(message.get_signed())
        if frame is None or (isinstance(frame, MEASURED) and self._signed and not signed):
            return
        with self._limits:
            allowed = self._filter.allow(sender, at.mono, signed=signed)
        if allowed:
            if isinstance(frame, frames.Heartbeat):
                self._received.receive(*sender, message.get_seq())
            self._frames.put(Received(frame, raw, link, at))

    # ------------------------------------------------------------ the station's thread

    def _loop(self) -> None:
        while not self._stop.is_set():
            try:
                self._turn()
            except Exception:  # a defect must not end the thread
                logger.exception("a turn of the ground station failed")
            self._frames.wait(TICK_S)

    def _turn(self) -> None:
        for one in self._frames.take(0.0):
            try:
                self._process(one)
            except Exception:  # a defect in handling one frame must not lose the others
                logger.exception("processing a received frame failed")
        now = self._clock.mono()
        if now - self._beat_at >= HEARTBEAT_S:
            self._beat_at = now
            self._heartbeat(mavlink.MAV_STATE_ACTIVE)
        if now - self._tick_at >= TICK_S:
            self._tick_at = now
            self._tick()

    def _process(self, one: Received) -> None:
        if self._filter.is_copy(one.raw, one.link, one.at.mono):
            return
        with self._lock:
            self._publish(self._store.receive(one.frame, one.link, one.at))
        beat = isinstance(one.frame, frames.Heartbeat) and self._store.is_agent(one.frame)
        for queue in self._watchers:
            queue.put(replace(one, of_agent=beat) if beat else one)

    def _heartbeat(self, state: int) -> None:
        if not self.silent:
            kind, autopilot = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID
            self._hub.send(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, self._mode, state, 3))

    def _tick(self) -> None:
        links = {link.name: (link.open, link.error) for link in self._hub.links()}
        problems = tuple(filter(None, (self._twin, self._hub.problem())))
        with self._lock:
            at = self._clock.stamp()
            events = self._store.links(links, at)
            events += [GcsEvent(at, "problem", {"text": text}) for text in problems if text not in self._problems]
            self._problems = problems
            self._publish([*events, *(replace(one, at=at) for one in self._store.tick(self._judged_at(at)))])

    def _judged_at(self, at: Stamp) -> Stamp:
        """The moment up to which silence counts: earlier by the time in which the ground did not run recently, because frames that
        arrived meanwhile may not be read yet."""
        return Stamp(at.utc, at.mono - self._clock.late_s(at.mono - WINDOW_S, LATE_MOST_S))

    def _publish(self, events: Iterable[GcsEvent]) -> None:
        """With the lock held, so that no event is missing between a snapshot and the events after it."""
        for one in events:
            self._number += 1
            item = QueuedEvent(self._number, one, encode(one, self.run, self._number))
            for queue in self._queues:
                queue.put(item)
