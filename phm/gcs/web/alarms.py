"""CRITICAL lines that are not acknowledged, and agents that are silenced for a time. Thread-safe; the caller brings time."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from phm.gcs.alarms import CRITICAL, MAX_AGENTS
from phm.gcs.events import GcsEvent

SHORTEST_S, LONGEST_S = 1.0, 24 * 3600.0


@dataclass(slots=True)
class _Alarm:
    """at: monotonic seconds of the first line that is not acknowledged."""

    count: int = 0
    at: float = 0.0
    silent_until: float = 0.0


class AlarmList:
    """Holds the alarm of each agent, by its name."""

    def __init__(self, expected: Iterable[str] = ()) -> None:
        """expected: names of agents whose alarms are kept, however many others there are."""
        self._expected = frozenset(expected)
        self._alarms: dict[str, _Alarm] = {}
        self.left_out = 0
        """Alarms for which there was no room, until all are acknowledged."""
        self._all_silent_until = 0.0
        self._lock = threading.Lock()
        self.changed: set[str] = set()
        """Agents whose alarm has changed since this was emptied; empty name: all."""

    def take(self, event: GcsEvent, name: str) -> None:
        """Count an event if it is an alarm. name: the agent that it is about."""
        body = event.body
        if event.event != "text" or not body["phm"] or body["repeat"] or body["severity"] > CRITICAL or not name:
            return
        with self._lock:
            alarm = self._place(name, event.at.mono)
            alarm.at = event.at.mono if not alarm.count else alarm.at
            alarm.count += 1
            self.changed.add(name)

    def row(self, name: str, now: float) -> dict[str, Any] | None:
        """The alarm in an agent's row; None: it has no alarm and is not silenced."""
        with self._lock:
            alarm = self._alarms.get(name) or _Alarm()
            until = max(alarm.silent_until, self._all_silent_until)
            if not alarm.count and until <= now:
                return None
            silent = round(until, 2) if until > now else None
            return {
                "count": alarm.count,
                "at": round(alarm.at, 2) if alarm.count else None,
                "silent_until": silent,
                "expected": name in self._expected,
            }

    def silent_until(self, now: float) -> float | None:
        """Until when all agents are silenced; None: they are not. The silence of one agent is in its row alone."""
        with self._lock:
            return round(self._all_silent_until, 2) if self._all_silent_until > now else None

    def control(self, body: Mapping[str, Any], now: float) -> None:
        """`acknowledge`, `silence` for `for_s`, `unsilence`; agent null: all. Raises ValueError."""
        what, name, for_s = body.get("do"), body.get("agent"), body.get("for_s")
        if what not in ("acknowledge", "silence", "unsilence"):
            raise ValueError("do must be acknowledge, silence or unsilence")
        if name is not None and not isinstance(name, str):
            raise ValueError("agent must be a name, or null for all agents")
        if what == "silence" and (
            isinstance(for_s, bool) or not isinstance(for_s, (int, float)) or not SHORTEST_S <= for_s <= LONGEST_S
        ):
            raise ValueError(f"for_s must be {SHORTEST_S:g} to {LONGEST_S:g} seconds")
        with self._lock:
            if what == "acknowledge":
                for alarm in self._chosen(name):
                    alarm.count = 0
                self.left_out = 0 if name is None else self.left_out
            else:
                self._silence(name, now + float(for_s or 0.0) if what == "silence" else 0.0, now)
            self.changed.add(name or "")

    def clear(self) -> None:
        """Forget all alarms, because the time has jumped."""
        with self._lock:
            self._alarms.clear()
            self._all_silent_until, self.left_out = 0.0, 0

    def _chosen(self, name: str | None) -> list[_Alarm]:
        return [alarm for known, alarm in self._alarms.items() if name in (None, known)]

    def _place(self, name: str, now: float) -> _Alarm:
        """The alarm of an agent. For a new one without room another goes: one that says nothing any more, else one of an agent that is
        not expected, since a sender can invent any number of agents; of these the oldest."""
        if name not in self._alarms and len(self._alarms) >= MAX_AGENTS:

            def rank(held: str) -> tuple[bool, bool, float]:
                alarm = self._alarms[held]
                return alarm.count > 0 or alarm.silent_until > now, held in self._expected, alarm.at

            self.left_out += self._alarms.pop(min(self._alarms, key=rank)).count > 0
        return self._alarms.setdefault(name, _Alarm())

    def _silence(self, name: str | None, until: float, now: float) -> None:
        if name is None:
            self._all_silent_until = until
            for alarm in self._alarms.values():
                alarm.silent_until = 0.0 if not until else alarm.silent_until
        else:
            self._place(name, now).silent_until = until
