"""The control socket: whatever is sent, each answer is one JSON object a line, and the next one who asks is served."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from functools import cache
from pathlib import Path

from hypothesis import strategies as st

from phm.wire import control as wire
from phm.wire.control import MAX_REQUEST
from tests.core.test_control import Daemon
from tests.fuzz.hostile import messages
from tests.fuzz.targets import folder, fuzzed

LIMIT_S = 30.0
REQUESTS = [
    {"do": "ping"}, {"do": "approve", "fault": "ab12-1"}, {"do": "note", "kind": "INJECT", "text": "words"},
]  # fmt: skip
LINES = st.sampled_from(REQUESTS).flatmap(messages) | st.sampled_from([b"x" * MAX_REQUEST, b"", b"[" * 5000, b"\xff"])


@cache
def _daemon() -> Daemon:
    return Daemon(Path(folder()))


def _said(daemon: Daemon, lines: list[bytes]) -> bytes:
    answer = b""
    with daemon.connect() as client, contextlib.suppress(OSError):
        client.settimeout(LIMIT_S)
        client.sendall(b"".join(line + b"\n" for line in lines))
        client.shutdown(socket.SHUT_WR)
        while got := client.recv(65536):
            answer += got
    return answer


@fuzzed("control socket", lines=st.lists(LINES, max_size=4))
def test_any_request_is_answered_and_the_next_one_served(lines: list[bytes]) -> None:
    """Carried out or refused in words, also when the other end is gone already."""
    daemon = _daemon()
    daemon.notes.clear()
    for line in _said(daemon, lines).splitlines():
        answer = json.loads(line)
        assert isinstance(answer["ok"], bool)
        assert isinstance(answer["text"] if answer["ok"] else answer["error"], str)
    assert all(kind == "INJECT" and text.isprintable() for kind, text in daemon.notes)
    end = time.monotonic() + LIMIT_S
    while not daemon.serves():
        assert time.monotonic() < end
    assert wire.ask(str(daemon.run_dir), {"do": "ping"}) == "PHM is here"
