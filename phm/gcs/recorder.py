"""Records every event on disk, rotated and capped, with a snapshot every minute, the heartbeats by which `phm report` compares clocks,
and samples for the plots of a replay.

Stamps are of the ground's clocks alone. A line torn by a power cut stays on a separate line, and readers skip it
(`phm.wire.json_log.read`).
"""

from __future__ import annotations

import json
import logging
import threading

from phm.core import threads
from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import Clock
from phm.gcs.events import VERSION
from phm.gcs.samples import Samples
from phm.gcs.station import GroundStation, Received
from phm.gcs.subscriber_queue import SubscriberQueue
from phm.reporters.rotating_file import RotatingFile

logger = logging.getLogger(__name__)

MAX_SIZE, FILES = 20_000_000, 5
"""Bytes of a file, and number of rotated files: 120 MB in all."""
SNAPSHOT_S = 60.0
POLL_S = 0.5
MAX_WAITING = 20_000
"""Frames that wait for the recorder: of 300 agents those of several seconds."""
CLOSE_LIMIT_S = 3.0


class Recorder:
    """Has its own thread, because a failing disk blocks its writer. `close` writes the events that still wait."""

    def __init__(
        self, path: str, station: GroundStation, clock: Clock, *, max_size: int = MAX_SIZE, files: int = FILES
    ) -> None:
        self._station, self._clock, self._queue = station, clock, SubscriberQueue(clock)
        self._lines = RotatingFile(path, max_size=max_size, files=files, clock=clock, lost_line=_lost)
        self._stop = threading.Event()
        self._snapshot_at = clock.mono() + SNAPSHOT_S
        self._thread = threading.Thread(target=self._loop, name="phm-gcs-record", daemon=True)
        self._frames: BoundedQueue[Received] = BoundedQueue(clock, MAX_WAITING)
        self._samples = Samples()
        station.subscribe(self._queue)
        station.watch(self._frames)

    def start(self) -> None:
        threads.start(self._thread)

    def about(self) -> str:
        """A sentence while the record is not complete, else empty."""
        dropped, path = self._queue.dropped, self._lines.path
        problem = self._lines.problem() or (f"{dropped} lines are missing in {path}" if dropped else "")
        return f"record: {problem}" if problem else ""

    def close(self) -> None:
        self._stop.set()
        self._queue.wake()
        if self._thread.ident is not None:
            self._thread.join(CLOSE_LIMIT_S)

    def _loop(self) -> None:
        last = False
        while not last:
            last = self._stop.is_set()
            for item in self._queue.take(0.0 if last else POLL_S):
                self._lines.write(item.line)
            try:
                self._record_state(last=last)
            except Exception:  # a defect there must not end the record of events
                logger.exception("recording samples or a snapshot failed")
        self._lines.close()

    def _record_state(self, *, last: bool) -> None:
        if (received := self._station.received()) is not None:
            self._lines.write(self._station.line(*received))
        self._record_samples(last=last)
        self._lines.retry()
        if self._clock.mono() >= self._snapshot_at or last:
            self._snapshot_at = self._clock.mono() + SNAPSHOT_S
            self._lines.write(self._station.line(*self._station.snapshot()))

    def _record_samples(self, *, last: bool) -> None:
        for received in self._frames.take(0.0):
            self._samples.add(received)
        if found := self._samples.take(self._clock.mono(), last=last):
            self._lines.write(self._station.line(*self._station.record_only("samples", {"samples": found})))


def _lost(count: int, reason: str, last: bytes) -> bytes:
    """Takes the place of the last lost line, with its number and stamps."""
    head = json.loads(last)
    kept = {key: head[key] for key in ("run", "seq", "utc", "utc_s", "mono")}
    return json.dumps({"v": VERSION, **kept, "event": "lost", "lines": count, "reason": reason}).encode("ascii")
