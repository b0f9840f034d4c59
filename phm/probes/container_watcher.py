"""Follows the configured containers through the engine's event stream and regular comparisons with its state.

The stream is fast but loses events (the engine drops a slow reader and keeps only 256). So every few seconds and after
every reconnect the containers are inspected and compared with the expected state; each lost event is published as a
separate event.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

from phm.core import threads
from phm.core.backoff import Backoff
from phm.core.clock import Clock
from phm.core.settings import ContainerSettings, DockerSettings
from phm.facts import CannotTell, EventStreamFact
from phm.probes.docker_event import FILTERS, DockerEvent
from phm.probes.docker_facts import TimeBudget, find
from phm.probes.docker_reconcile import ExpectedState
from phm.probes.event_decoder import EventDecoder
from phm.transport.docker import DockerEngine, EngineTimeout, EventStream

logger = logging.getLogger(__name__)

BACKOFF_S = 0.1
BACKOFF_MAX_S = 5.0
CONFIRM_S = 0.2
"""A difference is checked again after this time: the event that explains it may still arrive."""
BEHIND_S = 10.0
"""A reader behind for longer than this hangs or never catches up: `caught_up` no longer waits for it."""
BEHIND_POLL_S = 0.005
MISSED_S = 2.0
"""The engine replays events of the time in which the stream was closed, from its last 256, including those of health
checks. After a longer interruption some may be missing."""


class ContainerWatcher:
    """Two threads: one follows the stream, one compares.

    `on_event` is called from both, one call at a time; `on_turn` when the stream broke, could not be opened, or is open
    again, usually because the engine stopped or started; `on_other` when a container that is not configured was started,
    ended or renamed.
    """

    def __init__(
        self,
        engine: DockerEngine,
        containers: Sequence[ContainerSettings],
        settings: DockerSettings,
        clock: Clock,
        on_event: Callable[[DockerEvent], None],
        on_turn: Callable[[], None] = lambda: None,
        on_other: Callable[[], None] = lambda: None,
    ) -> None:
        self._engine, self._clock, self._on_event, self._on_turn = engine, clock, on_event, on_turn
        self._on_other = on_other
        self._containers = {entry.key: entry for entry in containers}
        self._decoder = EventDecoder(containers, clock)
        self._compare_s = settings.compare
        self._publishing = threading.Lock()
        self._stopping, self._compare_now = threading.Event(), threading.Event()
        self._stream: EventStream | None = None
        self._connected = False
        self._opened_at: float | None = None
        self.fact = EventStreamFact(False, clock.mono())
        self._compared_at: float | None = None
        self._behind_since: float | None = None
        self._threads = [
            threading.Thread(target=self._follow, name="phm-docker-events", daemon=True),
            threading.Thread(target=self._compare, name="phm-docker-compare", daemon=True),
        ]

    def start(self) -> None:
        for thread in self._threads:
            threads.start(thread)

    def stop(self) -> None:
        """End both threads. Waits at most for a call in progress."""
        self._stopping.set()
        self._compare_now.set()
        stream = self._stream
        if stream is not None:
            stream.close()
        for thread in self._threads:
            threads.join(thread, self._engine.timeout_s + 1)

    def healthy(self) -> bool:
        """Whether the stream is open, and the last successful comparison is not older than three periods."""
        at = self._compared_at
        limit_s = 3 * self._compare_s + self._engine.timeout_s
        return self._connected and at is not None and self._clock.mono() - at <= limit_s

    def caught_up(self) -> bool:
        """Whether `on_event` has returned for every event that the engine had sent at the time of the call."""
        stream = self._stream
        if stream is None or stream.caught_up():
            self._behind_since = None
            return True
        now, since = self._clock.mono(), self._behind_since
        if since is None:
            self._behind_since = now
        return since is not None and now - since > BEHIND_S

    def catch_up(self) -> None:
        """Wait until caught up, usually not at all, and at most BEHIND_S."""
        while not self.caught_up() and not self._stopping.is_set():
            self._clock.wait(self._stopping, BEHIND_POLL_S)

    # ------------------------------------------------------------ the stream

    def _follow(self) -> None:
        backoff = Backoff(BACKOFF_S, BACKOFF_MAX_S)
        while not self._stopping.is_set():
            opened_at = self._clock.mono()
            try:
                self._read_stream()
                silent = False
            except EngineTimeout:
                silent = self._connected  # no event for a long time: not a failure
            except CannotTell as error:
                silent = False
                logger.debug("event stream: %s", error)
            except Exception:  # a defect in reading must not end the thread
                silent = False
                logger.exception("the event stream could not be read")
            if self._connected:
                self._connected, self.fact = False, replace(self.fact, open=False, since=self._clock.mono())
            if not silent:
                self._turned()
            # Do not reopen a stream ten times a second if it is dropped as soon as it is opened.
            if silent or self._clock.mono() - opened_at > BACKOFF_MAX_S:
                backoff.reset()
            if not self._stopping.is_set():
                self._clock.wait(self._stopping, backoff.next_s())

    def _read_stream(self) -> None:
        opened_at = self._clock.mono()
        with self._engine.events(self._decoder.since or self._since_opened(opened_at), FILTERS) as stream:
            self._stream = stream
            if self._stopping.is_set():
                return
            self._opened_at = opened_at if self._opened_at is None else self._opened_at
            self._connected, self.fact = True, self._reopened(opened_at)
            self._turned()
            self._compare_now.set()
            for raw in stream:
                others = self._decoder.others
                event = self._decoder.decode(raw)
                if event is not None:
                    self._publish(event)
                if self._decoder.others != others:
                    self._notify(self._on_other)

    def _since_opened(self, now: float) -> str:
        """From when to replay events if none has arrived yet: since the stream was first open. Empty: it never was."""
        return "" if self._opened_at is None else f"{self._clock.utc() - (now - self._opened_at):.9f}"

    def _reopened(self, opened_at: float) -> EventStreamFact:
        replayed = self.fact.complete_since <= opened_at and opened_at - self.fact.since <= MISSED_S
        now = self._clock.mono()
        return EventStreamFact(True, now, self.fact.complete_since if replayed else now)

    # ------------------------------------------------------------ the comparison

    def _compare(self) -> None:
        while not self._stopping.is_set():
            self._compare_now.clear()
            try:
                complete = self._compare_all()
            except Exception:  # a defect in comparing must not end the thread
                complete = False
                logger.exception("containers could not be compared")
            if complete:
                self._compared_at = self._clock.mono()
            if not self._stopping.is_set():
                self._clock.wait(self._compare_now, self._compare_s)

    def _compare_all(self) -> bool:
        """Whether the engine answered about every container."""
        answered = [self._compare_one(key) for key in self._containers if not self._stopping.is_set()]
        return all(answered)

    def _compare_one(self, key: str) -> bool:
        """Publish what the stream missed about one container; False if the engine did not answer."""
        seen = self._observe(key)
        if seen is not None and self._decoder.differs(key, seen[1]):
            self._clock.wait(self._stopping, CONFIRM_S)
            seen = self._observe(key)
        if seen is None:
            return False
        for event in self._decoder.compared(key, *seen):
            self._publish(event)
        return True

    def _observe(self, key: str) -> tuple[int, ExpectedState] | None:
        """The number of events about the container before the inspection, and its result."""
        count = self._decoder.count(key)
        try:
            fact = find(self._engine, self._containers[key], TimeBudget(self._clock, self._engine.timeout_s))
        except CannotTell as error:
            logger.debug("comparison of %s: %s", key, error)
            return None
        if fact is not None:
            self._decoder.learn_stop(key, fact.stop_signal, fact.stop_timeout_s)
        return count, ExpectedState.of(fact)

    def _turned(self) -> None:
        self._notify(self._on_turn)

    def _notify(self, listener: Callable[[], None]) -> None:
        if self._stopping.is_set():
            return
        try:
            listener()
        except Exception:  # a defect of the listener must not end the thread
            logger.exception("the listener of the event stream failed")

    def _publish(self, event: DockerEvent) -> None:
        with self._publishing:
            if self._stopping.is_set():
                return
            try:
                self._on_event(event)
            except Exception:  # a defect of the listener must not lose the next event
                logger.exception("an event could not be delivered: %s", event)
