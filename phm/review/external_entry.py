"""What records of others say of a vehicle: modes, arming, errors, failsafes and texts, on the time axis of PHM's events."""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Iterator
from typing import NamedTuple

from phm.review.decompression import GZIP
from phm.review.events import LATEST_S, WORDS, Event
from phm.review.lines import BLOCK, Problems
from phm.wire.text import one_line

RECORDED = frozenset(("diagnostic", "rosout", "topic", "gap"))
KINDS = frozenset(("mode", "arming", "error", "failsafe", "statustext")) | RECORDED
"""`event` of such an event; those of recordings of ROS 2 may have the system 0, not known."""
LEVELS = frozenset((*WORDS.values(), "STALE"))
MOST = 50_000
"""Maximum number of entries of all files; more are counted and left out."""
MOST_SYSTEMS = 256
MOST_TEXT, MOST_BY = 200, 20
EARLIEST_S = 946_684_800.0
"""2000-01-01: an earlier time is a clock that was never set."""
UNPLACED_S = EARLIEST_S + 1.0
"""The boot of an autopilot whose log does not say when it was: far from each flight, so most evidence is needed to place it."""
NO_TIME = "no time of a GPS, and no lines of PHM that show when it was recorded (docs/reference/report.md): left out"
_OURS = re.compile(r"A\d{1,3} ([A-Z]+)\b")
_STEERING = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)|[@-Z\\\]^_])")
"""Escape sequences of a terminal: PX4 and nodes of ROS 2 colour their texts."""
MOST_READ = 4000
_FORWARDED = re.compile(r"SRC=(\d{1,3}/\d{1,3}):(.*)", re.DOTALL)


class ExternalEntry(NamedTuple):
    """One entry. t: UTC seconds by the record's own clock, until the clocks are compared. by: system/component of a text's sender.
    file: path. began: armed or disarmed. placed: False: t counts from an arbitrary moment, and is of no use until lines of PHM in
    the file say when it was."""

    t: float
    system: int
    what: str
    text: str
    level: str
    by: str
    file: str
    began: bool
    placed: bool = True

    @classmethod
    def of(cls, event: Event, file: str) -> ExternalEntry | None:
        """The entry; None: it has no possible time or system."""
        least = 0 if event.event in RECORDED else 1
        if not EARLIEST_S < event.utc_s < LATEST_S or event.system is None or not least <= event.system < MOST_SYSTEMS:
            return None
        text = one_line(plain(event.text)[:MOST_TEXT])
        # A hostile line of JSON comes here too: none of its texts is kept unchanged.
        level = event.level if event.level in LEVELS else ""
        by = one_line(str(event.by)[:MOST_BY])
        return cls(event.utc_s, event.system, event.event, text, level, by, file, event.began, event.placed)


def plain(text: str) -> str:
    """Without escape sequences, and without the tabulator by which PX4 marks texts that are also an event."""
    return _STEERING.sub("", text[:MOST_READ]).rstrip()


def text_event(system: int, utc_s: float, text: str, by: str = "", level: str = "") -> Event:
    """A text of the vehicle. A line of PHM, as ArduPilot logs it too, has the level that it states."""
    text = plain(text)
    if forwarded := _FORWARDED.match(text):
        by, text = forwarded.groups()
    if ours := _OURS.match(text):
        level = WORDS.get(ours.group(1), level)
    return Event("statustext", system=system, utc_s=utc_s, text=text[:MOST_TEXT], by=by, level=level)


def blocks(path: str, problems: Problems) -> Iterator[bytes]:
    """The file in blocks of 1 MB, decompressed if it is compressed by gzip."""
    try:
        with open(path, "rb") as plain:
            packed = plain.read(2) == GZIP
            plain.seek(0)
            stream = gzip.GzipFile(fileobj=plain) if packed else plain
            while block := stream.read(BLOCK):
                yield block
    except (OSError, EOFError, zlib.error) as error:
        problems.add(f"damaged or unreadable from here on: {error or type(error).__name__}", path)
