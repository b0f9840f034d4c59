"""Recordings of ROS 2 with bytes that were changed, removed or added, in each storage."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from hypothesis import strategies as st
from mcap.writer import CompressionType

from phm.review import source_mcap, source_rosbag2
from phm.review.lines import FileSegment, Problems
from phm.review.sources import source_of
from tests.fuzz.targets import fuzzed
from tests.review import bags

KINDS = ("db3", *(kind.name for kind in CompressionType))
EDITS = st.tuples(st.floats(0.0, 1.0), st.integers(0, 300), st.binary(max_size=300))


@cache
def whole(kind: str) -> bytes:
    """A good recording in this storage."""
    with tempfile.TemporaryDirectory() as folder:
        some = bags.flight()[::20]
        if kind == "db3":
            return bags.rosbag2(Path(folder, "bag"), some).read_bytes()
        return bags.mcap(Path(folder, "x.mcap"), some, CompressionType[kind]).read_bytes()


@fuzzed("recordings", kind=st.sampled_from(KINDS), edits=st.lists(EDITS, min_size=1, max_size=6))
def test_any_recording_is_read(kind: str, edits: list[tuple[float, int, bytes]]) -> None:
    """Nothing raises, and what is kept of an entry is limited."""
    content = bytearray(whole(kind))
    for part, length, added in edits:
        begin = int(part * len(content))
        content[begin : begin + length] = added
    with tempfile.NamedTemporaryFile() as file:
        file.write(content)
        file.flush()
        read = source_rosbag2.read if kind == "db3" else source_mcap.read
        assert all(len(event.text) <= 400 for event in read(FileSegment(file.name), Problems()))
        source_of(Path(file.name))
