"""Recordings of rosbag2 in SQLite (`.db3`), each file on its own; `metadata.yaml` is not needed.

Not by rosbags: it chooses by the file's name, sorts all messages first, and reads whatever the file defines as a table.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from phm.review.events import Event
from phm.review.lines import Piece, Problems
from phm.review.recording import MOST_MESSAGE, MOST_TOPICS, Recording
from phm.review.source_mcap import first_bytes
from phm.review.unpack import ZSTD

MAGIC = b"SQLite format 3\0"
TOPICS = "SELECT id, name, type, serialization_format FROM topics NOT INDEXED LIMIT ?"
MESSAGES = """SELECT topic_id, timestamp,
CASE WHEN instr(?, printf(',%d,', topic_id)) AND length(data) <= ? THEN data END FROM messages NOT INDEXED"""
LEAST_ROW = 4
"""Bytes of a row in the file, at least: a damaged file could show the same rows again and again."""


def fits(path: Path, head: bytes) -> bool:
    if head.startswith(ZSTD):
        return first_bytes(path, head).startswith(MAGIC)
    if not head.startswith(MAGIC):
        return False
    try:
        with closing(_opened(str(path))) as database:
            return _names(database) == {"topics", "messages"}
    except sqlite3.Error:
        return b"topic" in head and b"messages" in head


def read(piece: Piece, problems: Problems) -> Iterator[Event]:
    found = Recording(piece.path, problems)
    try:
        path = Path(piece.path)
        with path.open("rb") as stream:
            if stream.read(4) == ZSTD:
                found.problem("a database that is compressed as a whole: unpack it first, e.g. with `zstd -d`")
                return
        log = Path(f"{piece.path}-wal")
        if log.is_file() and log.stat().st_size:
            found.problem(f"{log.name} beside it is not read: the last messages may be missing")
        with closing(_opened(piece.path)) as database:
            _read(database, found, path.stat().st_size)
    except (sqlite3.Error, OSError) as error:
        found.problem(f"damaged or unreadable from here on: {error}")
    yield from found.events()


def _read(database: sqlite3.Connection, found: Recording, size: int) -> None:
    if not _plain(database, "topics", {"id", "name", "type", "serialization_format"}) or not _plain(
        database, "messages", {"topic_id", "timestamp", "data"}
    ):
        found.problem("not the tables of rosbag2")
        return
    # Row by row in the order of the file, which is that of the recorder: no index of the file, no sorting.
    for number, name, kind, encoding in database.execute(TOPICS, (MOST_TOPICS + 1,)):
        if isinstance(number, int):
            found.topic(number, _text(name), _text(kind), _text(encoding))
    wanted = "".join(f",{number}," for number, topic in found.topics.items() if topic.reads)
    for count, (number, stamp, body) in enumerate(database.execute(MESSAGES, (wanted, MOST_MESSAGE))):
        if count > size // LEAST_ROW:
            found.problem("more messages than fit into the file: the rest is left out")
            return
        if not isinstance(number, int) or not isinstance(stamp, int):
            found.problem("messages without a topic or a time, left out")
            continue
        found.take(number, stamp / 1e9, body if isinstance(body, bytes) else None)


def _opened(path: str) -> sqlite3.Connection:
    """Never writes, and runs nothing that the file defines."""
    database = sqlite3.connect(f"file:{quote(os.fsencode(path))}?mode=ro&immutable=1", uri=True)
    database.text_factory = lambda data: data.decode("utf-8", "replace")
    database.execute("PRAGMA trusted_schema = OFF")
    database.execute("PRAGMA mmap_size = 0")
    return database


def _names(database: sqlite3.Connection) -> set[str]:
    found = database.execute("SELECT name FROM sqlite_master WHERE name IN ('topics', 'messages') LIMIT 3")
    return {str(row[0]) for row in found}


def _plain(database: sqlite3.Connection, name: str, columns: set[str]) -> bool:
    """Whether it is an ordinary table with these columns: no view, no virtual table, no column that is computed."""
    query = "SELECT type, sql FROM sqlite_master WHERE name = ? LIMIT 2"
    rows = database.execute(query, (name,)).fetchall()
    if len(rows) != 1 or rows[0][0] != "table" or not _text(rows[0][1]).upper().startswith("CREATE TABLE"):
        return False
    known = database.execute(f"PRAGMA table_xinfo({name})").fetchall()
    return columns <= {str(row[1]) for row in known} and not any(row[6] for row in known)


def _text(value: object) -> str:
    return value[:400] if isinstance(value, str) else ""
