"""Recordings in MCAP, of rosbag2 or any other program, also compressed as a whole by gzip or zstd."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

from phm.core.extras import remedy
from phm.review.decompression import damages, first_bytes, opened
from phm.review.events import Event
from phm.review.lines import FileSegment, Problems
from phm.review.recording import MOST_MESSAGE, MOST_TOPICS, Recording

MAGIC = b"\x89MCAP0\r\n"
MISSING = f"needs mcap: {remedy('report')}"


def fits(path: Path, head: bytes) -> bool:
    return first_bytes(path, head).startswith(MAGIC)


def read(segment: FileSegment, problems: Problems) -> Iterator[Event]:
    """The whole file is read before the first event: whose they are may come late."""
    found = Recording(segment.path, problems)
    try:
        from phm.review import mcap_stream

        with open(segment.path, "rb") as plain:
            channels = list(itertools.islice(mcap_stream.described(plain), MOST_TOPICS))
        for channel in channels:
            found.topic(*channel)
        with opened(segment.path) as stream:
            for row in mcap_stream.rows(stream, found.problem):
                if isinstance(row, mcap_stream.ChannelRow):
                    found.topic(*row)
                    continue
                topic = found.topics.get(row.channel)
                wanted = topic is not None and topic.reads and len(row.data) <= MOST_MESSAGE
                found.take(row.channel, row.log_time / 1e9, bytes(row.data) if wanted else None)
    except ImportError:
        found.problem(MISSING)
    except damages() as error:
        found.problem(f"damaged or unreadable from here on: {error or type(error).__name__}")
    yield from found.events()
