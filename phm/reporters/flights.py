"""Number the flights: a flight is the time from armed to disarmed. The number survives restarts of PHM."""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import dataclass

NAME = "flight.json"
MAX_BYTES = 1000


@dataclass(frozen=True, slots=True)
class FlightChange:
    """A flight began or ended. continued: it began before this run of PHM. duration_s: at its end; None: its beginning was not seen."""

    number: int
    began: bool
    continued: bool = False
    duration_s: float | None = None

    @property
    def text(self) -> str:
        if self.began:
            return f"flight {self.number} {'continues' if self.continued else 'began'}: the autopilot is armed"
        lasted = "" if self.duration_s is None else f" after {self.duration_s:.0f} s"
        return f"flight {self.number} ended{lasted}: the autopilot is disarmed"


class FlightCounter:
    """Not thread-safe. directory: where the number is kept; when it cannot be kept, numbers begin again after a restart."""

    def __init__(self, directory: str) -> None:
        self._path = os.path.join(directory, NAME)
        self._number, self._open = _load(self._path)
        self._began: float | None = None
        self._known = False
        """The state of the autopilot was known in this run."""

    def update(self, armed: bool | None, now: float) -> FlightChange | None:
        """Take the state of the autopilot; None: it is unknown, and nothing changes. now: monotonic seconds."""
        if armed is None or (self._known and armed is self._open):
            return None
        first, self._known = not self._known, True
        if armed and self._open:
            return FlightChange(self._number, began=True, continued=True) if first else None
        if not armed and not self._open:
            return None
        self._open = armed
        if armed:
            self._number, self._began = self._number + 1, now
        duration_s = None if armed or self._began is None else now - self._began
        self._save()
        return FlightChange(self._number, began=armed, duration_s=duration_s)

    def _save(self) -> None:
        temporary = f"{self._path}.{os.getpid()}.tmp"
        with contextlib.suppress(OSError):
            os.makedirs(os.path.dirname(self._path), exist_ok=True)
            with open(temporary, "w", encoding="ascii") as stream:
                json.dump({"v": 1, "number": self._number, "open": self._open}, stream)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, self._path)


def _load(path: str) -> tuple[int, bool]:
    try:
        with open(path, "rb") as stream:
            found = json.loads(stream.read(MAX_BYTES))
        number, is_open = found["number"], found["open"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return 0, False
    valid = type(number) is int and 0 <= number < 2**31 and type(is_open) is bool
    return (number, is_open) if valid else (0, False)
