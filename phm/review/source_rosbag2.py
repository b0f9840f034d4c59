"""Recordings of rosbag2 in SQLite (`.db3`, also compressed as a whole), each file on its own; `metadata.yaml` is not needed.

Not by rosbags: it chooses by the file's name, sorts all messages first, and reads whatever the file defines as a table.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import IO
from urllib.parse import quote

from phm.core.extras import remedy
from phm.review.decompression import GZIP, ZSTD, damages, first_bytes, opened
from phm.review.events import Event
from phm.review.lines import BLOCK, FileSegment, Problems
from phm.review.recording import MOST_MESSAGE, MOST_TOPICS, Recording

MAGIC = b"SQLite format 3\0"
TOPICS = "SELECT id, name, type, serialization_format FROM topics NOT INDEXED LIMIT ?"
MESSAGES = """SELECT topic_id, timestamp,
CASE WHEN instr(?, printf(',%d,', topic_id)) AND length(data) <= ? THEN data END FROM messages NOT INDEXED"""
LEAST_ROW = 4
"""Bytes of a row in the file, at least: a damaged file could show the same rows again and again."""
FREE_SHARE = 0.25
"""Of the free space of the temporary folder, for an unpacked database: several files may be read at the same time."""


def fits(path: Path, head: bytes) -> bool:
    if head.startswith((GZIP, ZSTD)):
        return first_bytes(path, head).startswith(MAGIC)
    if not head.startswith(MAGIC):
        return False
    try:
        with closing(_opened(str(path))) as database:
            return _names(database) == {"topics", "messages"}
    except sqlite3.Error:
        return b"topic" in head and b"messages" in head


def read(segment: FileSegment, problems: Problems) -> Iterator[Event]:
    found = Recording(segment.path, problems)
    try:
        log = Path(f"{segment.path}-wal")
        if log.is_file() and log.stat().st_size:
            found.problem(f"{log.name} beside it is not read: the last messages may be missing")
        with _database_file(segment.path, found) as path, closing(_opened(path)) as database:
            if _is_torn(path):
                found.problem("the end of the file is missing")
            _read(database, found, os.path.getsize(path))
    except ImportError:
        found.problem(f"a compressed database: needs zstandard: {remedy('report')}")
    except (sqlite3.Error, OSError) as error:
        found.problem(f"damaged or unreadable from here on: {error}")
    yield from found.events()


@contextmanager
def _database_file(path: str, found: Recording) -> Iterator[str]:
    """The file itself, or a temporary one with what it unpacks to: SQLite reads only files."""
    with open(path, "rb") as stream:
        if not stream.read(4).startswith((GZIP, ZSTD)):
            yield path
            return
    with tempfile.TemporaryDirectory(prefix="phm-report-") as folder:
        unpacked = os.path.join(folder, "unpacked.db3")
        try:
            with opened(path) as packed, open(unpacked, "wb") as target:
                _copy(packed, target, int(FREE_SHARE * shutil.disk_usage(folder).free))
        except damages() as error:  # what came before it can be read
            found.problem(f"damaged or unreadable from here on: {error or type(error).__name__}")
        yield unpacked


def _copy(packed: IO[bytes], target: IO[bytes], most: int) -> None:
    while block := packed.read(BLOCK):
        most -= len(block)
        if most < 0:
            raise ValueError(f"it needs more than a quarter of the free space of {tempfile.gettempdir()} (TMPDIR)")
        target.write(block)


def _is_torn(path: str) -> bool:
    """Whether the file is shorter than its header says (https://www.sqlite.org/fileformat2.html#the_database_header). SQLite reports
    only some of these, and zstandard none.
    """
    with open(path, "rb") as stream:
        head = stream.read(100)
    if len(head) < 100:
        return True
    page, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    valid = head[24:28] == head[92:96]  # else an old program wrote it, which does not count pages
    return valid and os.path.getsize(path) < pages * (65536 if page == 1 else page)


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
