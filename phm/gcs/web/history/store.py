"""The history's file: SQLite, written by one thread in batches, limited in size and age.

A damaged file is set aside and a new one begun: the page must work in the air, and the old file can be looked at later.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import shutil
import sqlite3
import tempfile
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from phm.core import threads
from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import Clock

logger = logging.getLogger(__name__)

MAX_BYTES, MAX_AGE_S = 200_000_000, 30 * 86_400.0
MAX_WAITING = 50_000
"""Maximum number of rows that wait to be written."""
MAX_SERIES = 20_000
FEW, FEW_S = 10, 3600.0
"""When there are too many series, those with fewer samples end after this time without one: a sender can invent any number of names."""
SORTED = 50_000
"""About this many entries are sorted to find the oldest tenth."""
COMMIT_S, PRUNE_S, RETRY_S, OPEN_S = 1.0, 60.0, 10.0, 2.0
SETTLE_S = 600.0
"""In the first minutes of a run nothing is deleted for its age: a wrong clock may still be set, by network or GPS."""
AHEAD_S = 86_400.0
"""An entry that is stamped later than this from now on was written while the clock was wrong, or is: it counts as older than all others
when the file is too large."""
CLOSE_LIMIT_S = 5.0
APPLICATION, VERSION = 0x50484D47, 1
# In one transaction: a file that has the tables also says whose it is.
_SCHEMA = f"""
BEGIN;
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = {VERSION};
CREATE TABLE IF NOT EXISTS series (id INTEGER PRIMARY KEY, who TEXT NOT NULL, kind TEXT NOT NULL, UNIQUE (who, kind));
CREATE TABLE IF NOT EXISTS sample (series INTEGER NOT NULL, at REAL NOT NULL, value REAL, PRIMARY KEY (series, at)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS event (
  id INTEGER PRIMARY KEY AUTOINCREMENT, at REAL NOT NULL, who TEXT NOT NULL, grade INTEGER NOT NULL, event TEXT NOT NULL,
  words TEXT NOT NULL, body TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS event_who ON event (who, id);
CREATE INDEX IF NOT EXISTS event_of ON event (who, event, id);
CREATE TABLE IF NOT EXISTS fault (
  key TEXT PRIMARY KEY, who TEXT NOT NULL, at REAL NOT NULL, changed REAL NOT NULL, open INTEGER NOT NULL, body TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS fault_at ON fault (at);
COMMIT;
"""
SAMPLE = "INSERT OR REPLACE INTO sample (series, at, value) VALUES (?, ?, ?)"
EVENT = "INSERT INTO event (at, who, grade, event, words, body) VALUES (?, ?, ?, ?, ?, ?)"
FAULT = "INSERT OR REPLACE INTO fault (key, who, at, changed, open, body) VALUES (?, ?, ?, ?, ?, ?)"
DELETE = (
    "DELETE FROM sample WHERE at - (at > :ahead) * 1e12 <= :until",
    "DELETE FROM event WHERE at - (at > :ahead) * 1e12 <= :until",
    "DELETE FROM fault WHERE changed - (changed > :ahead) * 1e12 <= :until",
)
"""Entries that are stamped later than `ahead` come before all others, in their order."""
FORGET = "DELETE FROM sample WHERE series IN (SELECT series FROM sample GROUP BY series HAVING count(*) < ? AND max(at) <= ?)"
UNUSED = "DELETE FROM series WHERE NOT EXISTS (SELECT 1 FROM sample WHERE series = series.id)"


_UNUSABLE = (
    sqlite3.IntegrityError, sqlite3.ProgrammingError, sqlite3.InterfaceError, OverflowError, UnicodeError, ValueError,
)  # fmt: skip
"""What writing a row raises that is not fit for the file, such as half a character. The file itself is OK."""
MAX_ASIDES = 3
"""This many damaged files of one run are kept: on a broken disk, each new file would be damaged again."""


class _NotOurs(Exception):
    """The file is a database of another program."""


@dataclass(frozen=True, slots=True)
class HistorySample:
    """One point of a series. who: name of an agent, or `link:` and a name. at: UTC seconds. value: None interrupts the line of the plot."""

    who: str
    kind: str
    at: float
    value: float | None


@dataclass(frozen=True, slots=True)
class HistoryRow:
    """A statement of this module and its values."""

    statement: str
    values: tuple[object, ...]


class HistoryStore:
    """path: None for a file that is removed at the end. idle_s: while `watched` is false, samples are written this often; events and
    faults always within COMMIT_S. `put` never waits; `start` opens the file."""

    def __init__(
        self,
        path: Path | None,
        clock: Clock,
        *,
        max_bytes: int = MAX_BYTES,
        max_age_s: float = MAX_AGE_S,
        idle_s: float = 0.0,
    ) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="phm-gcs-")) if path is None else None
        self.path = path if path is not None else Path(self._folder or "") / "history.db"
        self._clock, self._max_bytes, self._max_age_s, self._idle_s = clock, max_bytes, max_age_s, idle_s
        self.watched = False
        """Whether someone looks at the newest samples."""
        self._urgent, self._write_at = False, 0.0
        self._queue: BoundedQueue[HistorySample | HistoryRow] = BoundedQueue(clock, MAX_WAITING)
        self._left: list[HistorySample | HistoryRow] = []  # taken from the queue, not on disk yet
        self._writing = False  # from before they are taken
        self._series: dict[tuple[str, str], int] = {}
        self._connection: sqlite3.Connection | None = None
        self._problem = self._aside = ""
        self._began, self._prune_at = clock.mono(), 0.0
        self._offset = clock.utc() - clock.mono()
        """UTC minus monotonic seconds, the smallest of this run: by this clock nothing of this run is too old after a step."""
        self._retry_at = float("-inf")
        self._stop, self._tried = threading.Event(), threading.Event()
        self._unusable = self._asides = self._skipped = 0
        self._thread = threading.Thread(target=self._loop, name="phm-gcs-history", daemon=True)

    def start(self) -> None:
        """Start the writer, and wait a moment until the file was opened or has failed to open."""
        if threads.start(self._thread):
            self._clock.wait(self._tried, OPEN_S)

    def put(self, row: HistorySample | HistoryRow) -> None:
        self._queue.put(row)
        self._urgent = self._urgent or isinstance(row, HistoryRow)

    @property
    def waiting(self) -> int:
        """Entries that are not on disk yet; there is room for `room`."""
        return len(self._queue) + len(self._left)

    room = MAX_WAITING - 1

    def problem(self) -> str:
        """A sentence while entries are missing, else empty."""
        dropped = self._queue.dropped + self._unusable
        lost = f"{dropped} entries of the history are missing" if dropped else ""
        many = f"{self._skipped} samples are left out: the history has too many series" if self._skipped else ""
        return "; ".join(filter(None, (self._problem, self._aside, lost, many)))

    def flush(self, limit_s: float) -> bool:
        """Wait until what was put is on disk."""
        end, self._urgent = time.monotonic() + limit_s, True
        while self._writing or len(self._queue) or self._connection is None:
            if time.monotonic() > end or self._stop.is_set():
                return False
            self._clock.wait(self._stop, 0.02)
        return True

    def close(self) -> None:
        self._stop.set()
        self._queue.wake()
        threads.join(self._thread, CLOSE_LIMIT_S)
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    # ------------------------------------------------------------ the thread

    def _loop(self) -> None:
        last = False
        while not last:
            last = self._stop.is_set()
            self._offset = min(self._offset, self._clock.utc() - self._clock.mono())
            try:
                if self._connection is None and (last or self._clock.mono() >= self._retry_at):
                    self._open()
                if self._connection is not None and (last or self._left or self._due()):
                    self._urgent, self._write_at = False, self._clock.mono() + self._idle_s
                    self._writing = True
                    self._left = self._left or list(self._queue.take(0.0))
                    self._write(self._connection, self._left)
                    self._left, self._writing, self._problem = [], False, ""
                    self._prune(self._connection)
            except _NotOurs:
                self._fail(f"{self.path} is a database of another program and was not changed: name another file")
            except sqlite3.OperationalError as error:  # a full disk, a folder that cannot be written
                self._fail(f"the history cannot be written: {error} ({self.path})")
            except sqlite3.DatabaseError as error:
                self._set_aside(str(error))
            except OSError as error:
                self._fail(f"the history cannot be written: {error.strerror or error} ({self.path})")
            self._tried.set()
            if not last:
                self._clock.wait(self._stop, COMMIT_S)
        self._disconnect()

    def _due(self) -> bool:
        return self.watched or self._urgent or self._clock.mono() >= self._write_at

    def _open(self) -> None:
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        os.close(os.open(self.path, os.O_CREAT | os.O_RDWR, 0o600))
        connection = sqlite3.connect(self.path, timeout=2.0)
        try:
            _check_owner(connection)
            connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")  # NORMAL syncs at checkpoints only
            connection.executescript(_SCHEMA)
        except BaseException:
            connection.close()
            raise
        self._connection = connection
        self._load_series(connection)

    def _load_series(self, connection: sqlite3.Connection) -> None:
        self._series = {(who, kind): key for key, who, kind in connection.execute("SELECT id, who, kind FROM series")}

    def _write(self, connection: sqlite3.Connection, rows: Iterable[HistorySample | HistoryRow]) -> None:
        with connection:
            for row in rows:
                try:
                    self._write_one(connection, row)
                except _UNUSABLE as error:
                    self._unusable += 1
                    logger.warning("an entry of the history could not be stored: %s", type(error).__name__)

    def _write_one(self, connection: sqlite3.Connection, row: HistorySample | HistoryRow) -> None:
        if isinstance(row, HistoryRow):
            connection.execute(row.statement, row.values)
            return
        key = self._key(connection, row)
        if key is not None:
            connection.execute(SAMPLE, (key, row.at, row.value))

    def _key(self, connection: sqlite3.Connection, row: HistorySample) -> int | None:
        """The id of a sample's series; None: there are too many series."""
        name = (row.who, row.kind)
        if name not in self._series:
            if len(self._series) >= MAX_SERIES:
                self._skipped += 1
                return None
            connection.execute("INSERT OR IGNORE INTO series (who, kind) VALUES (?, ?)", name)
            found = connection.execute("SELECT id FROM series WHERE who = ? AND kind = ?", name).fetchone()
            self._series[name] = int(found[0])
        return self._series[name]

    def _prune(self, connection: sqlite3.Connection) -> None:
        """Delete what is too old, and the oldest entries while the file is too large."""
        if self._clock.mono() < self._prune_at and self._size(connection) <= self._max_bytes:
            return
        self._prune_at = self._clock.mono() + PRUNE_S
        if self._clock.mono() - self._began >= SETTLE_S:
            _delete(connection, self._clock.mono() + self._offset - self._max_age_s)
        while self._size(connection) > self._max_bytes and not self._stop.is_set():
            ahead = self._clock.utc() + AHEAD_S
            if not _delete(connection, _oldest(connection, ahead), ahead):
                break  # only the names of series are left
        self._forget_series(connection)
        connection.execute("PRAGMA incremental_vacuum").fetchall()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()

    def _forget_series(self, connection: sqlite3.Connection) -> None:
        """Names without samples make room for others."""
        with connection:
            if len(self._series) >= MAX_SERIES:
                connection.execute(FORGET, (FEW, self._clock.mono() + self._offset - FEW_S))
            forgotten = connection.execute(UNUSED).rowcount
        if forgotten:
            self._load_series(connection)
            self._skipped = 0

    def _size(self, connection: sqlite3.Connection) -> int:
        pages = (
            connection.execute("PRAGMA page_count").fetchone()[0]
            - connection.execute("PRAGMA freelist_count").fetchone()[0]
        )
        return int(pages * connection.execute("PRAGMA page_size").fetchone()[0])

    def _fail(self, text: str) -> None:
        if text != self._problem:
            logger.warning("%s", text)
        self._problem, self._retry_at = text, self._clock.mono() + RETRY_S
        self._disconnect()

    def _set_aside(self, reason: str) -> None:
        self._disconnect()
        if self._asides >= MAX_ASIDES:
            self._fail(f"the history is damaged again ({reason}): it is no longer written ({self.path})")
            return
        self._asides += 1
        kept = self.path.with_name(f"{self.path.name}.damaged-{int(self._clock.utc())}")
        try:
            os.replace(self.path, kept)
        except OSError as error:
            self._fail(f"the history is damaged ({reason}) and cannot be renamed: {error.strerror or error}")
            return
        for suffix in ("-wal", "-shm"):
            with contextlib.suppress(OSError):
                os.replace(f"{self.path}{suffix}", f"{kept}{suffix}")
        self._aside = f"the history was damaged ({reason}): it is now {kept.name}, and a new one was started"
        logger.warning("%s", self._aside)

    def _disconnect(self) -> None:
        if self._connection is not None:
            with contextlib.suppress(sqlite3.Error):
                self._connection.close()
        self._connection = None
        self._series = {}


def _oldest(connection: sqlite3.Connection, ahead: float) -> float:
    """The moment until which the oldest tenth of the entries goes. ahead: as in DELETE.

    Of many entries it is an estimate from a random selection: to sort millions of them takes seconds, in which nothing is written.
    """
    entries = connection.execute(
        "SELECT (SELECT count(*) FROM sample) + (SELECT count(*) FROM event) + (SELECT count(*) FROM fault)"
    ).fetchone()[0]
    one_of = max(1, entries // SORTED)
    found = connection.execute(
        "SELECT at - (at > :ahead) * 1e12 AS at FROM ("
        "SELECT at FROM sample WHERE random() % :one_of = 0 UNION ALL SELECT at FROM event "
        "WHERE random() % :one_of = 0 UNION ALL SELECT changed FROM fault WHERE random() % :one_of = 0) "
        "ORDER BY at LIMIT 1 OFFSET :place",
        {"one_of": one_of, "place": entries // one_of // 10, "ahead": ahead},
    ).fetchone()
    return float("-inf") if found is None else float(found[0])


def _delete(connection: sqlite3.Connection, until: float, ahead: float = math.inf) -> int:
    """Delete the entries until this moment; their number. ahead: as in DELETE."""
    with connection:
        return sum(connection.execute(statement, {"until": until, "ahead": ahead}).rowcount for statement in DELETE)


def _check_owner(connection: sqlite3.Connection) -> None:
    """Read whose file it is. Raises _NotOurs, and DatabaseError for a file of another version of PHM."""
    found, version, tables = (
        connection.execute(query).fetchone()[0]
        for query in ("PRAGMA application_id", "PRAGMA user_version", "SELECT count(*) FROM sqlite_master")
    )
    if found == APPLICATION:
        if version != VERSION:
            raise sqlite3.DatabaseError("it was written by another version of PHM")
    elif (found, version, tables) != (0, 0, 0):
        raise _NotOurs
