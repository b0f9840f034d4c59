"""Shows the news to whoever started the program: a live table, lines of words, or lines of JSON."""

from __future__ import annotations

import re
import threading
from collections import deque
from collections.abc import Callable

from rich.console import Console, RenderableType
from rich.live import Live

from phm.core.clock import Clock
from phm.gcs import table
from phm.gcs.events import describe_with_time
from phm.gcs.station import GroundStation
from phm.gcs.subscriber_queue import SubscriberQueue

REDRAW_S = 0.5
LOOK_S = 0.2
KEPT_LINES = 20
NOT_WELL = frozenset(("ERROR", "LOST", "UNKNOWN"))

Print = Callable[[str], None]


class ConsoleView:
    """All of it runs in the thread that calls.

    notes: what the program has to say about itself; `warn` prints one where there is no table to show it in.
    """

    def __init__(
        self, station: GroundStation, clock: Clock, echo: Print, notes: Callable[[], list[str]], warn: Print
    ) -> None:
        self._station, self._clock, self._echo, self._notes, self._warn = station, clock, echo, notes, warn
        self._warned: set[str] = set()
        self._queue = SubscriberQueue(clock)
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)
        station.subscribe(self._queue)

    def lines(self, stop: threading.Event, end: float | None, *, as_json: bool) -> None:
        """A line for each piece of news until `stop`, or until the clock is at `end`."""
        while not self._over(stop, end):
            self.rest(LOOK_S, as_json=as_json)
            self._warn_once()

    def rest(self, timeout_s: float, *, as_json: bool) -> None:
        """What waits to be shown, or comes within the time."""
        for item in self._queue.take(timeout_s):
            text = item.line.decode("ascii") if as_json else describe_with_time(item.news)
            if text:
                self._echo(text)

    def live(self, stop: threading.Event, end: float | None, console: Console) -> None:
        """The table in place."""
        with Live(self._table(console), console=console, screen=True, auto_refresh=False) as live:
            while not self._over(stop, end):
                self._clock.wait(stop, REDRAW_S)
                live.update(self._table(console), refresh=True)

    def once(self, console: Console, *, as_json: bool) -> bool:
        """How all are, printed; whether every agent is well, and there is one."""
        number, news = self._station.snapshot()
        if as_json:
            self._echo(self._station.line(number, news).decode("ascii"))
        else:
            console.print(table.render(news.body, notes=self._notes()))
        hows = {agent["how"] for agent in news.body["agents"]}
        return bool(hows) and not hows & NOT_WELL

    def _warn_once(self) -> None:
        """Each note when it appears, not again for each new count in it; again when it comes back."""
        notes = {re.sub(r"\d+", "#", note): note for note in self._notes()}
        for kind in notes.keys() - self._warned:
            self._warn(notes[kind])
        self._warned = set(notes)

    def _table(self, console: Console) -> RenderableType:
        self._lines.extend(text for item in self._queue.take(0.0) if (text := describe_with_time(item.news)))
        body = self._station.snapshot()[1].body
        return table.render(body, list(self._lines), height=console.height, notes=self._notes())

    def _over(self, stop: threading.Event, end: float | None) -> bool:
        return stop.is_set() or (end is not None and self._clock.mono() >= end)
