"""Queries of the history. Each opens the file for itself and has a deadline; called outside of the event loop."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from phm.gcs.samples import TOPIC
from phm.gcs.web.events import GRADES
from phm.gcs.web.history.faults import MAX_OPEN, FaultEntry, as_of, from_json
from phm.gcs.web.history.store import APPLICATION

Json = dict[str, Any]
QUERY_S = 5.0
MAX_POINTS, MAX_EVENTS, MAX_FAULTS = 2000, 500, 200
SILENT_S = 30.0
"""A longer time without samples interrupts the line of a plot."""
KINDS = {
    "gap": ("s", "heartbeat gap"),
    "level": ("", "worst level (0 unknown, 1 OK, 2 WARN, 3 ERROR)"),
    "rate": ("1/s", "frames received"),
    "cpu": ("%", "CPU"),
    "memory": ("%", "memory"),
    "temperature": ("°C", "temperature"),
    "rssi": ("", "signal here"),
    "remrssi": ("", "signal at the other end"),
    "noise": ("", "noise here"),
    "remnoise": ("", "noise at the other end"),
    "txbuf": ("%", "free transmit buffer"),
}
"""Unit and label of each kind of series."""
UNSEEN_S = 600.0
"""After a longer time in which the ground received nothing, a flight counts as another one."""
"""Kinds of series that begin with this have the rate of the topic that follows."""


def _described(kind: str) -> tuple[str, str]:
    """Unit and label."""
    return ("Hz", f"rate of {kind.removeprefix(TOPIC)}") if kind.startswith(TOPIC) else KINDS.get(kind, ("", ""))


class HistoryError(Exception):
    """The history cannot be read; the message says why."""


class HistoryReader:
    """Reads the history's file. Thread-safe."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def kinds(self, who: str) -> list[Json]:
        with self._open() as connection:
            found = {row[0] for row in connection.execute("SELECT kind FROM series WHERE who = ?", (who,))}
        shown = [kind for kind in KINDS if kind in found] + sorted(kind for kind in found if kind.startswith(TOPIC))
        return [{"kind": kind, "unit": _described(kind)[0], "label": _described(kind)[1]} for kind in shown]

    def series(self, who: str, kind: str, since: float, until: float, points: int) -> Json:
        """Means and maxima over equal times: at most `points` of them. since, until: UTC seconds."""
        width = max((until - since) / max(1, min(points, MAX_POINTS)), 0.001)
        with self._open() as connection:
            rows = connection.execute(
                "SELECT CAST((at - ?) / ? AS INTEGER) AS part, avg(at), avg(value), max(value) FROM sample "
                "WHERE series = (SELECT id FROM series WHERE who = ? AND kind = ?) AND at >= ? AND at <= ? "
                "GROUP BY part ORDER BY part",
                (since, width, who, kind, since, until),
            ).fetchall()
        found: list[list[float | None]] = []
        for _part, at, value, most in rows:
            last = found[-1][0] if found else None
            # Not for heartbeat gaps: there the value says how long it was silent.
            if last is not None and kind != "gap" and at - last > max(SILENT_S, 3 * width):
                found.append([round((at + last) / 2, 3), None, None])
            found.append([round(at, 3), _rounded(value), _rounded(most)])
        return {"agent": who, "kind": kind, "unit": _described(kind)[0], "points": found}

    def events(
        self, *, who: str, event: str, text: str, grade: str, before: int | None, until: float, limit: int
    ) -> Json:
        """Events, newest first. text: in the words or keys. grade: the least. before: an id. until: UTC seconds."""
        limit = max(1, min(limit, MAX_EVENTS))
        wheres, values = ["1"], list[object]()
        least = GRADES.index(grade) if grade in GRADES else 0
        for where, value, wanted in (
            ("who = ?", who, bool(who)),
            ("event = ?", event, bool(event)),
            ("grade >= ?", least, least > 0),
            ("id < ?", before, before is not None),
            ("at <= ?", until, until != math.inf),
            ("(instr(lower(words), ?) OR instr(lower(who), ?))", text.lower(), bool(text)),
        ):
            if wanted:
                wheres.append(where)
                values += [value] * where.count("?")
        # The conditions are those above; what is asked for is bound.
        statement = f"SELECT id, body FROM event WHERE {' AND '.join(wheres)} ORDER BY id DESC LIMIT ?"  # noqa: S608
        with self._open() as connection:
            rows = connection.execute(statement, (*values, limit + 1)).fetchall()
        found = [{**body, "id": key} for key, text in rows[:limit] for body in _bodies(text)]
        return {"events": found, "more": len(rows) > limit}

    def faults(self, who: str, *, since: float = 0.0, until: float = math.inf) -> Json:
        """Faults as they were known at `until`, without those that had ended by `since`, newest first. UTC seconds."""
        limit = MAX_FAULTS if since < until else MAX_OPEN
        with self._open() as connection:
            rows = connection.execute(
                "SELECT body FROM fault WHERE (? = '' OR who = ?) AND at <= ? AND (open = 1 OR changed > ?) ORDER BY at DESC LIMIT ?",
                (who, who, until, since, limit),
            ).fetchall()
        found = [body for (text,) in rows for body in _bodies(text)]
        if until != math.inf:
            found = [
                body for body in (as_of(one, until) for one in found) if body["open"] or body["ended_utc_s"] > since
            ]
        return {"faults": found}

    def flight(self, who: str, until: float = math.inf) -> Json:
        """The last time from arming to disarming of an agent's autopilot, as it was known at `until`, in UTC seconds: `since`, None: none
        is known; `until`, None: it is armed; `seen`: whether the arming was received, else it was armed before `since`."""
        begin = end = None
        seen = False
        with self._open() as connection:
            rows = connection.execute(
                "SELECT at, body FROM event WHERE who = ? AND event = 'autopilot' AND at <= ? ORDER BY id DESC",
                (who.partition("/")[0], until),
            )
            for at, armed in ((at, body.get("armed")) for at, text in rows for body in _bodies(text)):
                unseen_s = 0.0 if begin is None else _longest_gap(connection, who, at, begin)
                if begin is not None and (not armed or unseen_s > UNSEEN_S):
                    seen = not armed and unseen_s <= SILENT_S
                    break
                begin, end = (at, end) if armed else (None, at)
        return {"agent": who, "since": begin, "until": None if begin is None else end, "seen": seen}

    def open_faults(self) -> list[FaultEntry]:
        """Those that were open when the ground stopped; empty if there is no history yet, or it cannot be read."""
        found: list[FaultEntry] = []
        with contextlib.suppress(HistoryError):
            for body in reversed(self.faults("", since=math.inf)["faults"]):
                with contextlib.suppress(KeyError, TypeError, ValueError):
                    found.append(from_json(body))
        return found

    @contextlib.contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        end = time.monotonic() + QUERY_S
        if not self._path.exists():
            raise HistoryError("there is no history yet")
        try:
            with contextlib.closing(sqlite3.connect(self._path, timeout=2.0)) as connection:
                connection.execute("PRAGMA query_only = 1")
                connection.set_progress_handler(lambda: int(time.monotonic() > end), 10_000)
                if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION:
                    raise HistoryError("there is no history yet")
                yield connection
        except (sqlite3.Error, ValueError) as error:
            raise HistoryError(f"the history cannot be read: {error}") from None


def _longest_gap(connection: sqlite3.Connection, who: str, since: float, until: float) -> float:
    """The longest time without a sample of the series that are written while the ground receives anything."""
    rows = connection.execute(
        "SELECT at FROM sample WHERE series IN (SELECT id FROM series WHERE who = ? AND kind IN ('level', 'rate')) "
        "AND at > ? AND at < ? ORDER BY at",
        (who, since, until),
    )
    moments: list[float] = [since, *(at for (at,) in rows), until]
    return max(after - before for before, after in itertools.pairwise(moments))


def _bodies(text: object) -> list[Json]:
    """The object that an entry has; none when it is damaged."""
    try:
        body = json.loads(str(text))
    except (ValueError, RecursionError):
        return []
    return [body] if isinstance(body, dict) else []


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
