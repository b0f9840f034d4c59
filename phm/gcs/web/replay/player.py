"""Plays a record into the page as if it were received now: at any speed, with pause and jumps."""

from __future__ import annotations

import logging
import threading
from bisect import bisect_right
from collections.abc import Callable, Collection, Mapping
from typing import Any

from phm.core import threads
from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import SystemClock
from phm.core.model import Stamp
from phm.gcs.events import GcsEvent
from phm.gcs.fleet_state import FleetState
from phm.gcs.frames import Heartbeat
from phm.gcs.station import Received
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from phm.gcs.web.replay.record import Entry, GroundRecord
from phm.gcs.web.view import dumps

logger = logging.getLogger(__name__)

STEP_S = 0.05
SLOWEST, FASTEST = 0.1, 1000.0
RECENT_S = 60.0
"""After a jump, heartbeats that are older than this are not replayed."""
TICK_S = 0.2
CLOSE_LIMIT_S = 3.0
_HEAD = frozenset(("v", "run", "seq", "utc", "utc_s", "mono", "event"))

Json = dict[str, Any]


class ReplayClock(SystemClock):
    """Shows the time of the record; waits in real time."""

    def __init__(self, moment: Callable[[], tuple[float, float]]) -> None:
        self._moment = moment
        super().__init__()

    def mono(self) -> float:
        return self._moment()[0]

    def utc(self) -> float:
        return self._moment()[1]

    def stamp(self) -> Stamp:
        now, utc = self._moment()
        return Stamp(utc, now)


class Player:
    """Takes the place of a ground station (`phm.gcs.web.feed.Station`). on_jump, on_change: called after a jump, and after another
    change of the replay, without the lock."""

    run = "replay"
    silent = True

    def __init__(self, record: GroundRecord, speed: float = 1.0) -> None:
        self._record, self._speed = record, min(max(speed, SLOWEST), FASTEST)
        self._playing, self._now, self._next = True, 0.0, 0
        self._real = SystemClock()
        self.clock = ReplayClock(self.moment)
        self.on_jump: Callable[[], None] = lambda: None
        self.on_change: Callable[[], None] = lambda: None
        self._queues: tuple[SubscriberQueue, ...] = ()
        self._watchers: tuple[BoundedQueue[Received], ...] = ()
        self._store, self._ticked, self._seq = FleetState((), record.ids), 0.0, 0
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-replay", daemon=True)

    # ------------------------------------------------------------ as a station

    def subscribe(self, queue: SubscriberQueue) -> None:
        """Put each event of the record into `queue` while it is played."""
        self._queues = (*self._queues, queue)

    def watch(self, queue: BoundedQueue[Received]) -> None:
        """Also put each received frame of the record into `queue` while it is played."""
        self._watchers = (*self._watchers, queue)

    def snapshot(self, *, moments: bool = False, only: Collection[int] | None = None) -> tuple[int, GcsEvent]:
        with self._lock:
            at = self._stamp()
            body = {
                "system": self._record.ids[0],
                "component": self._record.ids[1],
                **self._store.snapshot(at, moments=moments, only=only),
                "problems": [],
                "frames_refused": 0,
            }
            return self._seq, GcsEvent(at, "snapshot", body)

    # ------------------------------------------------------------ control

    def moment(self) -> tuple[float, float]:
        return self._now, self._record.utc(self._now)

    def start(self) -> None:
        threads.start(self._thread)

    def close(self) -> None:
        self._stop.set()
        threads.join(self._thread, CLOSE_LIMIT_S)

    def state(self) -> Json:
        """The keys of the ground that describe the replay."""
        with self._lock:
            record, speed = self._record, self._speed
            replay = {
                "from_utc": round(record.utc(0.0), 3),
                "to_utc": round(record.utc(record.end), 3),
                "at_utc": round(record.utc(self._now), 3),
                "speed": speed,
                "playing": self._playing,
            }
            return {"page": "replay", "replay": replay, "rate": speed if self._playing else 0}

    def control(self, body: Mapping[str, Any]) -> None:
        """Play, pause, seek to `utc`, or set the speed. Raises ValueError for anything else."""
        changed = self.on_change
        with self._lock:
            match body.get("do"):
                case "play":
                    if self._now >= self._record.end:
                        self._jump(0.0)
                        changed = self.on_jump
                    self._playing = True
                case "pause":
                    self._playing = False
                case "seek":
                    self._jump(self._record.at(_number(body.get("utc"), "utc", -1e11, 1e11)))
                    changed = self.on_jump
                case "speed":
                    self._speed = _number(body.get("speed"), "speed", SLOWEST, FASTEST)
                case _:
                    raise ValueError("do must be play, pause, seek or speed")
        changed()

    # ------------------------------------------------------------ the thread

    def _loop(self) -> None:
        before = self._real.mono()
        while not self._stop.is_set():
            now = self._real.mono()
            try:
                if self.tick(now - before):
                    self.on_change()
            except Exception:  # one damaged line must not end the replay
                logger.exception("replaying a line failed")
            before = now
            self._real.wait(self._stop, STEP_S)

    def tick(self, real_s: float) -> bool:
        """Play what belongs to the next `real_s` seconds. Return whether this was the end."""
        with self._lock:
            if not self._playing:
                return False
            end = min(self._now + real_s * self._speed, self._record.end)
            while self._next < len(self._record.entries) and self._record.times[self._next] <= end:
                entry = self._record.entries[self._next]
                self._next += 1
                self._now = entry.at
                self._tick(entry.at)
                self._play(entry)
            self._now = end
            self._tick(end)
            self._playing = end < self._record.end
            return not self._playing

    def _play(self, entry: Entry) -> None:
        self._take(entry)
        for frame, link in entry.frames:
            beat = isinstance(frame, Heartbeat) and self._store.is_agent(frame)
            for queue in self._watchers:
                queue.put(Received(frame, b"", link, self._stamp(), beat))
        if entry.line is None or entry.line["event"] == "snapshot":
            return
        self._seq = int(entry.line.get("seq") or self._seq)
        body = {key: value for key, value in entry.line.items() if key not in _HEAD}
        at = Stamp(float(entry.line["utc_s"]), entry.at)
        item = QueuedEvent(
            self._seq,
            GcsEvent(at, str(entry.line["event"]), body),
            dumps({**entry.line, "mono": round(entry.at, 6)}).encode("ascii"),
        )
        for events in self._queues:
            events.put(item)

    def _take(self, entry: Entry) -> None:
        """What the fleet's state learns from it; the events that follow are in the record."""
        stamp = Stamp(self._record.utc(entry.at), entry.at)
        try:
            for frame, link in entry.frames:
                self._store.receive(frame, link, stamp)
        except Exception:  # frames are made from a file that anybody may have changed: a jump must end all the same
            logger.exception("a line of the record cannot be replayed")
        if entry.links is not None:
            name, is_open, error = entry.links
            self._store.links({**self._store.fleet.links, name: (is_open, error)}, stamp)

    def _tick(self, at: float) -> None:
        if at - self._ticked >= TICK_S:
            self._ticked = at
            self._store.tick(Stamp(self._record.utc(at), at))

    def _jump(self, at: float) -> None:
        """Jump to a moment: the state is built from all lines before it."""
        self._store, self._ticked = FleetState((), self._record.ids), 0.0
        self._next = bisect_right(self._record.times, at)
        for entry in self._record.entries[: self._next]:
            if entry.line is not None or at - entry.at <= RECENT_S:
                self._take(entry)
        self._now = at
        self._store.tick(self._stamp())

    def _stamp(self) -> Stamp:
        return Stamp(self._record.utc(self._now), self._now)


def _number(value: object, name: str, least: float, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
        raise ValueError(f"{name} must be a number from {least:g} to {most:g}")
    return float(value)
