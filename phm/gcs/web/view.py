"""What the page shows, as JSON: a row for each agent, and what is not about one agent. Changes go to listeners as differences.

One thread puts; any thread reads. A listener is called in the thread that puts, and must not wait.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from phm.core.clock import Clock

Json = dict[str, Any]
Listener = Callable[[int, bytes], None]
"""Takes the number of a message and the message, as a server-sent event."""


def dumps(value: object) -> str:
    """JSON in ASCII without line ends: a name received by radio stays a string."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False, default=str)


def message(kind: str, body: object) -> bytes:
    """A server-sent event as bytes."""
    return f"event: {kind}\ndata: {dumps(body)}\n\n".encode("ascii")


class View:
    """Holds the state that the page shows. run: id of the run whose data this is."""

    def __init__(self, clock: Clock, run: str = "") -> None:
        self._clock, self.run = clock, run
        self._ground: Json = {}
        self._agents: dict[str, Json] = {}
        self._number = 0
        """The number of the last message."""
        self._seq = 0
        """The number of the last event."""
        self._listeners: tuple[Listener, ...] = ()
        self._full: tuple[int, bytes] | None = None
        self._lock = threading.Lock()
        self.moment: Callable[[], tuple[float, float]] = self._now
        """Monotonic seconds and UTC seconds as the page is to see them: those of the record while one is replayed."""

    def listen(self, listener: Listener) -> None:
        with self._lock:
            self._listeners = (*self._listeners, listener)

    def put(
        self,
        *,
        ground: Mapping[str, Any] | None = None,
        agents: Mapping[str, Mapping[str, Any] | None] | None = None,
        complete: bool = False,
    ) -> None:
        """Take over keys of the ground and complete rows of agents; None: the agent is gone. complete: so are all agents that are
        not among these."""
        with self._lock:
            changed_ground = _changed(self._ground, ground or {})
            self._ground.update(changed_ground)
            rows: dict[str, Json | None] = {}
            for name, row in (agents or {}).items():
                if row is None:
                    if self._agents.pop(name, None) is not None:
                        rows[name] = None
                    continue
                old = self._agents.get(name)
                changed = dict(row) if old is None else _changed(old, row)
                if changed:
                    rows[name] = changed
                    self._agents[name] = {**(old or {}), **changed}
            if complete:
                for name in [name for name in self._agents if name not in (agents or {})]:
                    del self._agents[name]
                    rows[name] = None
            if changed_ground or rows:
                parts = {"ground": changed_ground, "agents": rows}
                self._publish("delta", {**self._stamps(), **{key: part for key, part in parts.items() if part}})

    def replace(self, ground: Mapping[str, Any], agents: Mapping[str, Mapping[str, Any]]) -> None:
        """Begin again, after a jump of the time: everyone gets the complete state."""
        with self._lock:
            self._ground, self._agents = {**self._ground, **ground}, {name: dict(row) for name, row in agents.items()}
            self._publish("full", self._state())

    def add_events(self, events: Sequence[Mapping[str, Any]]) -> None:
        """Publish new events, in order."""
        if events:
            with self._lock:
                self._seq = max(self._seq, int(events[-1].get("seq", 0)))
                self._publish("events", {"events": list(events)})

    def publish(self, kind: str, body: Mapping[str, Any]) -> None:
        """Publish a message that is not part of the state."""
        with self._lock:
            self._publish(kind, body)

    def state(self) -> Json:
        """A copy of the complete state."""
        with self._lock:
            return json.loads(dumps(self._state()))  # type: ignore[no-any-return]

    def row(self, name: str) -> Json | None:
        """A copy of the row of an agent."""
        with self._lock:
            row = self._agents.get(name)
            return None if row is None else dict(row)

    def full(self) -> tuple[int, bytes]:
        """The complete state as a message, and the number of the last message that is in it."""
        with self._lock:
            if self._full is None or self._full[0] != self._number:
                self._full = (self._number, message("full", self._state()))
            return self._full

    # ------------------------------------------------------------ with the lock held

    def _publish(self, kind: str, body: object) -> None:
        self._number += 1
        data = message(kind, body)
        for listener in self._listeners:
            listener(self._number, data)

    def _state(self) -> Json:
        return {
            **self._stamps(),
            "run": self.run,
            "seq": self._seq,
            "ground": self._ground,
            "agents": self._agents,
        }

    def _stamps(self) -> Json:
        now, utc = self.moment()
        return {"now": round(now, 3), "utc": round(utc, 3)}

    def _now(self) -> tuple[float, float]:
        at = self._clock.stamp()
        return at.mono, at.utc


def _changed(old: Mapping[str, Any], new: Mapping[str, Any]) -> Json:
    return {key: value for key, value in new.items() if key not in old or old[key] != value}
