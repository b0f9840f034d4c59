"""The control socket: for any request each response line is one JSON object, and the next client is served."""

from __future__ import annotations

import contextlib
import json
import socket
from functools import cache
from pathlib import Path

from hypothesis import strategies as st

from phm.recovery.holds.hold_service import HoldService
from phm.wire import control as wire
from phm.wire.control import MAX_REQUEST
from tests.commands.test_control_server import Daemon
from tests.fakes.until import until
from tests.fuzz.hostile import messages
from tests.fuzz.targets import folder, fuzzed
from tests.recovery.holds.scene import Scene

LIMIT_S = 60.0
MAX_HOLD_S = 4 * 3600.0
REQUESTS = [
    {"do": "ping"},
    {"do": "approve", "fault": "ab12-1"},
    {"do": "note", "text": "words"},
    {"do": "reload"},
    {"do": "hold", "container": "app", "for_s": 60.0, "reason": "new firmware"},
    {"do": "hold", "container": "", "for_s": None, "reason": ""},
    {"do": "release", "container": "app"},
    {"do": "release", "container": ""},
]
LINES = (
    st.sampled_from(REQUESTS).flatmap(messages)
    | st.sampled_from([json.dumps(request).encode("ascii") for request in REQUESTS])
    | st.sampled_from([b"x" * MAX_REQUEST, b"", b"[" * 5000, b"\xff"])
)


@cache
def _holds() -> HoldService:
    return Scene().service


@cache
def _daemon() -> Daemon:
    daemon = Daemon(Path(folder()), _holds())
    daemon.reload = lambda: json.dumps({"changed": []})
    return daemon


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
    """Executed or refused with a reason, even if the client is gone already."""
    daemon = _daemon()
    daemon.notes.clear()
    for line in _said(daemon, lines).splitlines():
        answer = json.loads(line)
        assert isinstance(answer["ok"], bool)
        assert isinstance(answer["text"] if answer["ok"] else answer["error"], str)
    assert all(kind == "NOTE" and text.isprintable() for kind, text in daemon.notes)
    for hold in _holds().snapshot():
        assert (
            hold["container"] in (None, "app", "cam")
            and 0 < hold["left_s"] <= MAX_HOLD_S
            and hold["reason"].isprintable()
        )
    until(daemon.serves, "the server to answer")
    assert wire.ask(str(daemon.run_dir), {"do": "ping"}) == "PHM is running"
