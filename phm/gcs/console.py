"""Shows events as lines of text or of JSON, and the table once. The live table is `live`."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable

from rich.console import Console

from phm.core.clock import Clock
from phm.gcs import table
from phm.gcs.events import describe_with_time
from phm.gcs.station import GroundStation
from phm.gcs.subscriber_queue import SubscriberQueue

POLL_S = 0.2
NOT_OK = frozenset(("ERROR", "LOST", "UNKNOWN"))

Print = Callable[[str], None]


class ConsoleView:
    """Runs in the calling thread.

    notes: messages about the program itself; `warn` prints one where there is no table to show it in.
    """

    def __init__(
        self, station: GroundStation, clock: Clock, echo: Print, notes: Callable[[], list[str]], warn: Print
    ) -> None:
        self._station, self._clock, self._echo, self._notes, self._warn = station, clock, echo, notes, warn
        self._warned: set[str] = set()
        self._queue = SubscriberQueue(clock)
        station.subscribe(self._queue)

    def lines(self, stop: threading.Event, end: float | None, *, as_json: bool) -> None:
        """Print a line for each event until `stop` is set, or the clock is at `end`."""
        while not self._over(stop, end):
            self.rest(POLL_S, as_json=as_json)
            self._warn_once()

    def rest(self, timeout_s: float, *, as_json: bool) -> None:
        """Print the events that wait, or arrive within the time."""
        for item in self._queue.take(timeout_s):
            text = item.line.decode("ascii") if as_json else describe_with_time(item.event)
            if text:
                self._echo(text)

    def once(self, console: Console, *, as_json: bool) -> bool:
        """Print the status of all agents; whether there is one, and all are OK."""
        number, event = self._station.snapshot()
        if as_json:
            self._echo(self._station.line(number, event).decode("ascii"))
        else:
            console.print(table.render(event.body, width=console.width, notes=self._notes()))
        hows = {agent["how"] for agent in event.body["agents"]}
        return bool(hows) and not hows & NOT_OK

    def _warn_once(self) -> None:
        """Print each note when it appears, not again when only a number in it changes."""
        notes = {re.sub(r"\d+", "#", note): note for note in self._notes()}
        for kind in notes.keys() - self._warned:
            self._warn(notes[kind])
        self._warned = set(notes)

    def _over(self, stop: threading.Event, end: float | None) -> bool:
        return stop.is_set() or (end is not None and self._clock.mono() >= end)
