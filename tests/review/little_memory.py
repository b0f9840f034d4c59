"""Reads a recording in a process without much memory. Imports little: each such process imports it again."""

from __future__ import annotations

import resource
import tempfile
from pathlib import Path
from typing import Any

from phm.review import source_mcap
from phm.review.events import Event
from phm.review.lines import FileSegment, Problems

MOST_MB = 450
"""More than the reader needs with its libraries; the bombs would unpack to more."""


def read_mcap(content: bytes) -> tuple[list[Event], list[str]]:
    with tempfile.NamedTemporaryFile() as file:
        file.write(content)
        file.flush()
        found = Problems()
        return list(source_mcap.read(FileSegment(file.name), found)), [what for what, _ in found.found]


def problems_in_little_memory(content: bytes, answer: Any) -> None:
    """Sends what is wrong with the recording to the pipe `answer`."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + (MOST_MB << 20)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    answer.send(read_mcap(content)[1])
