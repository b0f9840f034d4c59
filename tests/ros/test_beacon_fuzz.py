"""Beacons from any participant in the DDS domain: CDR, text, the registry, and the pipe to the daemon."""

from __future__ import annotations

import contextlib
import json
import struct

import pytest
from hypothesis import strategies as st

from phm.beacon import BEACON_FORMAT
from phm.probes.ros.beacon_registry import BeaconRegistry, portions
from phm.probes.ros.beacon_text import log_texts
from phm.probes.ros.protocol import LINE_LIMIT, SelfReportUpdate, decode, encode
from phm.probes.ros.self_reports import SelfReports
from tests.fuzz.hostile import corrupted, messages
from tests.fuzz.targets import fuzzed

pytestmark = [pytest.mark.ros, pytest.mark.one_distribution]

NODE = {"birth": "w.1", "beats": 5, "turns": 3, "late_s": 0.0}
SAID = {
    "witness": "w",
    "period_s": 0.2,
    "nodes": {"/agent_1/a": NODE, "/agent_1/b": NODE},
    "views": {"/agent_1/b": {"alive": True, "age_s": 0.4, "late_s": 0.0}},
}


def cdr(name: str, text: str, order: str = "<") -> bytes:
    """A serialized rcl_interfaces/msg/Log, as far as the child reads it."""
    data = (b"\0\1" if order == "<" else b"\0\0") + b"\0\0" + bytes(9)
    for word in (name.encode(), text.encode()):
        data += bytes(-len(data) % 4) + struct.pack(f"{order}I", len(word) + 1) + word + b"\0"
    return data


WRITERS = st.sampled_from([None, b"1", b"2"])
VALID = [cdr(BEACON_FORMAT, json.dumps(SAID)), cdr(BEACON_FORMAT, json.dumps(SAID), ">")]


@fuzzed("beacon CDR", data=st.sampled_from(VALID).flatmap(corrupted) | st.binary(max_size=300))
def test_any_bytes_are_two_strings_or_rejected(data: bytes) -> None:
    """With ValueError or struct.error, which the child counts."""
    with contextlib.suppress(ValueError, struct.error):
        texts = log_texts(data)
        assert all(isinstance(text, str) for text in texts)
        assert sum(map(len, texts)) <= len(data)


@fuzzed("beacon", said=st.lists(st.tuples(messages(SAID), st.floats(0, 100), WRITERS), max_size=6))
def test_any_beacon_is_rejected_or_reported(said: list[tuple[bytes, float, bytes | None]]) -> None:
    """Nothing raises, and an accepted beacon passes the pipe and is kept by the daemon."""
    nodes = frozenset({"/agent_1/a"})
    ledger, kept = BeaconRegistry(nodes, lambda: {b"1": "/agent_1/a"}), SelfReports()
    for text, at_s, writer in said:
        ledger.add(BEACON_FORMAT, text.decode("utf-8", "replace"), at_s, writer)
        news = ledger.changes(at_s)
        for part in portions(news, nodes) if news is not None else ():
            line = encode(part)
            assert len(line) <= LINE_LIMIT
            back = decode(line)
            assert isinstance(back, SelfReportUpdate)
            assert back == part
            kept.differs(back)
            kept = kept.with_update(back, at_s)
            kept.since(at_s + 1)
