"""A fleet state on a fake clock, and frames as real agents send them."""

from __future__ import annotations

import socket
from typing import Any

from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import SystemClock
from phm.core.model import Level, Slot
from phm.gcs.events import GcsEvent, encode
from phm.gcs.fleet_state import FleetState
from phm.gcs.frames import Frame, Heartbeat, StatusText, TunnelPayload
from phm.gcs.station import Received
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from phm.testing import FakeClock
from phm.transport.dialect import mavlink
from phm.wire import status_word, tunnel
from phm.wire.tunnel import TunnelMessage

ACTIVE, EMERGENCY = 4, 6
HEALTHY = dict.fromkeys(list(Slot)[:9], Level.OK)


def phm_heartbeat(
    agent: int, levels: dict[Slot, Level] | None = None, *, state: int = ACTIVE, component: int = 193
) -> Heartbeat:
    """A heartbeat of PHM: slots 1 to 9 OK except the given ones."""
    word = status_word.encode({**HEALTHY, **(levels or {})})
    return Heartbeat(agent, component, 18, 8, 0, word, state)


def autopilot(agent: int, *, armed: bool = False, mode: int = 5) -> Heartbeat:
    """A heartbeat of an ArduPilot copter."""
    return Heartbeat(agent, 1, 2, 3, 128 if armed else 0, mode, ACTIVE)


def text_frame(agent: int, text: str, severity: int = 2, component: int = 193) -> StatusText:
    return StatusText(agent, component, severity, text)


def tunnel_frame(agent: int, message: TunnelMessage) -> TunnelPayload:
    return TunnelPayload(agent, 193, tunnel.PAYLOAD_TYPE, tunnel.encode(message))


class Ground:
    """A fleet state and a clock. `news` has all events so far."""

    def __init__(self, expected: tuple[int, ...] = ()) -> None:
        self.clock, self.store, self.news = FakeClock(), FleetState(expected, own=(254, 190)), list[GcsEvent]()
        self.store.links({"gcs": (True, "")}, self.clock.stamp())
        self.store.tick(self.clock.stamp())

    def receive(self, *frames: Frame) -> list[GcsEvent]:
        """The events that these frames cause."""
        found = [news for frame in frames for news in self.store.receive(frame, "gcs", self.clock.stamp())]
        self.news += found
        return found

    def wait(self, seconds: float, *repeated: Frame, every: float = 2.0) -> list[GcsEvent]:
        """Advance the time, receive `repeated` at this interval in seconds, and return the events."""
        found: list[GcsEvent] = []
        steps = round(seconds / 0.25)
        for step in range(1, steps + 1):
            self.clock.advance(0.25)
            if repeated and step % round(every / 0.25) == 0:
                found += self.receive(*repeated)
            ticked = self.store.tick(self.clock.stamp())
            self.news += ticked
            found += ticked
        return found

    def agent(self, number: int, component: int = 193) -> dict[str, Any]:
        """The snapshot of an agent."""
        agents = self.store.snapshot(self.clock.stamp())["agents"]
        return next(one for one in agents if (one["agent"], one["component"]) == (number, component))

    def snapshot(self) -> dict[str, Any]:
        return self.store.snapshot(self.clock.stamp())


def events(news: list[GcsEvent], event: str) -> list[dict[str, Any]]:
    """Bodies of the events of one kind."""
    return [dict(one.body) for one in news if one.event == event]


class Source:
    """A station for those who take events: its snapshot is the number of the last one."""

    def __init__(self) -> None:
        self._queues: list[SubscriberQueue] = []
        self._number, self._clock = 0, SystemClock()

    def subscribe(self, queue: SubscriberQueue) -> None:
        self._queues.append(queue)

    def snapshot(self) -> tuple[int, GcsEvent]:
        return self._number, GcsEvent(self._clock.stamp(), "snapshot", {"agents": []})

    def watch(self, queue: BoundedQueue[Received]) -> None:
        """It receives no frames."""

    def received(self) -> None:
        """Nothing."""

    def line(self, number: int, news: GcsEvent) -> bytes:
        return encode(news, "run", number)

    def say(self, text: str = "x") -> int:
        self._number += 1
        news = GcsEvent(self._clock.stamp(), "said", {"text": text})
        for queue in self._queues:
            queue.put(QueuedEvent(self._number, news, self.line(self._number, news)))
        return self._number


class Wire:
    """A socket of another program that sends to the station and receives from it."""

    def __init__(self, port: int) -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.settimeout(0.2)
        self._to = ("127.0.0.1", port)
        self._decoder = mavlink.MAVLink(None)

    def send(self, data: bytes) -> None:
        self.sock.sendto(data, self._to)

    def receive(self) -> list[Any]:
        try:
            return self._decoder.parse_buffer(self.sock.recv(65535)) or []
        except TimeoutError:
            return []
