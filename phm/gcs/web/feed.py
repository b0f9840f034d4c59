"""Keeps the view of the page up to date with what a ground station receives. One thread.

An agent's row is built again when a frame of its vehicle has arrived, and all rows once a second, because time passes.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Collection, Mapping
from typing import Any, Protocol

from phm import __version__
from phm.core import threads
from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import Clock
from phm.core.model import Slot
from phm.gcs.events import GcsEvent
from phm.gcs.frames import CommandAck, ComputerStatus
from phm.gcs.samples import MAX_SENDERS, sender_name
from phm.gcs.station import Received
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from phm.gcs.web import events, rows
from phm.gcs.web.alarms import AlarmList
from phm.gcs.web.view import View

logger = logging.getLogger(__name__)

FLUSH_S = 0.1
"""Seconds between two messages to the page; changes in between are sent together."""
ALL_S = 1.0
MAX_FRAMES = 8192
MAX_EVENTS = 500
"""Maximum number of events in one message."""
CLOSE_LIMIT_S = 3.0
SLOTS = {str(int(slot)): slot.short for slot in Slot}

Json = dict[str, Any]


class Station(Protocol):
    """What is shown: `phm.gcs.station.GroundStation`, or a replay."""

    run: str
    silent: bool

    def subscribe(self, queue: SubscriberQueue) -> None: ...
    def watch(self, queue: BoundedQueue[Received]) -> None:
        """Also put each received frame into `queue`."""

    def snapshot(self, *, moments: bool = False, only: Collection[int] | None = None) -> tuple[int, GcsEvent]: ...


class FeedListener(Protocol):
    """Takes what arrives, in the thread of the feed; must not wait."""

    def frame(self, received: Received) -> None:
        """A frame was received."""

    def event(self, item: QueuedEvent, line: Mapping[str, Any]) -> None:
        """An event happened. line: the same as in a record."""

    def tick(self, now: float) -> None:
        """Do what is due now. Called several times a second."""


class StationFeed:
    """Reads the queues of the station in its own thread. listeners: receive every frame and event, e.g. the history."""

    def __init__(
        self, station: Station, view: View, clock: Clock, alarms: AlarmList, listeners: Collection[FeedListener] = ()
    ) -> None:
        self._station, self._view, self._clock = station, view, clock
        self._alarms, self._listeners = alarms, tuple(listeners)
        self._events = SubscriberQueue(clock)
        self._frames: BoundedQueue[Received] = BoundedQueue(clock, MAX_FRAMES)
        self._dirty: set[int] = set()
        self._values: dict[str, Json] = {}
        """By the name of the agent, the one that has been silent for the longest time first."""
        self._all_at = float("-inf")
        self.ground: Callable[[], Json] = dict
        """Returns further keys of the ground's state."""
        self._turning = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-web-feed", daemon=True)
        view.run = station.run
        view.put(ground=self._about())
        station.subscribe(self._events)
        station.watch(self._frames)

    def start(self) -> None:
        threads.start(self._thread)

    def close(self) -> None:
        self._stop.set()
        self._frames.wake()
        threads.join(self._thread, CLOSE_LIMIT_S)

    def tick(self) -> None:
        """Take over the frames and events that have arrived."""
        with self._turning:
            self._turn()

    def _turn(self) -> None:
        for received in self._frames.take(0.0):
            self._frame(received)
        lines = [self._event(item) for item in self._events.take(0.0)]
        now = self._clock.mono()
        for listener in self._listeners:
            listener.tick(now)
        changed, self._alarms.changed = self._alarms.changed, set()
        if now - self._all_at >= ALL_S or changed:
            self._all_at = now
            self._put(None)
        elif self._dirty:
            self._put(self._dirty)
        self._dirty = set()
        for start in range(0, len(lines), MAX_EVENTS):
            self._view.add_events(lines[start : start + MAX_EVENTS])

    def reset(self) -> None:
        """After a jump of the time in a replay: nothing before it counts."""
        with self._turning:
            self._frames.take(0.0)
            self._events.take(0.0)
            self._values.clear()
            self._dirty.clear()
            self._alarms.clear()
            self._all_at = float("-inf")
            ground, agents = self._current(None)
            self._view.replace({**ground, **self.ground()}, agents)

    def refresh(self) -> None:
        """Publish the ground's state again, because it has changed."""
        with self._turning:
            self._put(None)

    # ------------------------------------------------------------ the thread

    def _loop(self) -> None:
        while not self._stop.is_set():
            try:
                self.tick()
            except Exception:  # a defect in one row must not end the thread
                logger.exception("updating the page failed")
            self._clock.wait(self._stop, FLUSH_S)

    def _frame(self, received: Received) -> None:
        frame = received.frame
        if not isinstance(frame, CommandAck):
            self._dirty.add(frame.system)
        if isinstance(frame, ComputerStatus):
            name = sender_name(frame.system, frame.component)
            if self._values.pop(name, None) is None and len(self._values) >= MAX_SENDERS:
                del self._values[next(iter(self._values))]  # a sender can invent any number of names
            self._values[name] = {**frame.values(), "at": round(received.at.mono, 2)}
        for listener in self._listeners:
            listener.frame(received)

    def _event(self, item: QueuedEvent) -> Json:
        line = events.from_line(item.line)
        self._alarms.take(item.event, line["who"])
        number = item.event.body.get("agent") or item.event.body.get("system")
        if isinstance(number, int):
            self._dirty.add(number)
        for listener in self._listeners:
            listener.event(item, line)
        return line

    def _put(self, only: Collection[int] | None) -> None:
        ground, agents = self._current(only)
        self._view.put(ground={**ground, **self.ground()}, agents=agents, complete=only is None)

    def _current(self, only: Collection[int] | None) -> tuple[Json, dict[str, Json]]:
        """The keys of the ground, and the rows of agents."""
        _number, event = self._station.snapshot(moments=True, only=only)
        body = dict(event.body)
        now = event.at.mono
        del body["autopilots"]  # they are in the rows
        body["alarms_silent_until"] = self._alarms.silent_until(now)
        body["alarms_left_out"] = self._alarms.left_out
        return body, {agent["name"]: self._row(agent, now) for agent in body.pop("agents")}

    def _row(self, agent: Mapping[str, Any], now: float) -> Json:
        alarm, values = self._alarms.row(agent["name"], now), self._values.get(agent["name"], {})
        return rows.row(agent, alarm=alarm, values=values)

    def _about(self) -> Json:
        """The keys of the ground that do not change."""
        return {
            "page": "gcs",
            "version": __version__,
            "slots": SLOTS,
            "silent": self._station.silent,
            "rate": 1,
            "replay": None,
            "clients": 0,
            "dropped": 0,
            "history": None,
            **self.ground(),
        }
