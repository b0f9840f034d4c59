"""The daemon's side of the control socket (`phm.wire.control`): approvals, notes and holds from this machine.

One thread, few connections, small requests, short deadlines: whoever talks nonsense or nothing is answered with an
error and let go. The socket belongs to PHM's user alone (mode 0600), and the kernel says who is at the other end.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from phm.core import threads
from phm.wire.control import DEADLINE_S, MAX_REQUEST, NAME, address
from phm.wire.text import one_line

logger = logging.getLogger(__name__)

MAX_CONNECTIONS = 4
BACKLOG = 16
"""Who comes when the backlog is full is turned away by the kernel at once."""
MAX_NOTE = 500
KINDS = ("INJECT",)
RETRY_S = 5.0
CLOSING_S = 2.0
TOO_LONG = f"a request has at most {MAX_REQUEST} bytes"
_POLL_S = 0.5
_CREDENTIALS = struct.Struct("3i")


class HoldController(Protocol):
    """Begins and ends holds (`phm.recovery.holds.hold_service.HoldService`): in words and as data, or an exception with its reason."""

    def hold(self, container: str, for_s: float | None, reason: str, by: str) -> tuple[str, dict[str, Any]]: ...

    def release(self, container: str, by: str) -> tuple[str, dict[str, Any]]: ...


class ControlServer:
    """Serves `run_dir/control.sock` until closed. `approve` answers in words or raises an exception with its reason."""

    def __init__(
        self,
        run_dir: str,
        approve: Callable[[str], str] = lambda fault: "",
        note: Callable[[str, str], None] = lambda kind, text: None,
        holds: HoldController | None = None,
    ) -> None:
        self._run_dir, self._approve, self._note, self._holds = run_dir, approve, note, holds
        self._connections: dict[socket.socket, tuple[bytearray, float]] = {}
        self._listener: socket.socket | None = None
        self._inode = 0
        self._started = False
        self._problem = ""
        self.reload: Callable[[], str] | None = None
        """Reloads the configuration; what came of it, as JSON. Other requests wait meanwhile."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="phm-control", daemon=True)

    def serve(
        self, approve: Callable[[str], str], note: Callable[[str, str], None], holds: HoldController | None
    ) -> None:
        """From now on these answer: the configuration was reloaded."""
        self._approve, self._note, self._holds = approve, note, holds

    def start(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._waker, self._woken = socket.socketpair()
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._started = True
        threads.start(self._thread)

    def problem(self) -> str:
        return self._problem

    def close(self) -> None:
        """End the thread and remove the socket; waits at most CLOSING_S."""
        if not self._started:
            return
        self._stop.set()
        with contextlib.suppress(OSError):  # closed before
            self._waker.send(b"x")
        threads.join(self._thread, CLOSING_S)
        self._waker.close()
        path = os.path.join(self._run_dir, NAME)
        with contextlib.suppress(OSError):
            if os.stat(path).st_ino == self._inode:
                os.unlink(path)

    # ------------------------------------------------------------ the thread

    def _serve(self) -> None:
        while not self._stop.is_set() and not self._listen():
            self._stop.wait(RETRY_S)
        while not self._stop.is_set():
            try:
                self._turn()
            except Exception:  # whatever a peer does, the next one is served
                logger.exception("the control socket stumbled")
                self._stop.wait(_POLL_S)
        for peer in list(self._connections):
            self._drop(peer)
        if self._listener is not None:
            self._listener.close()
        self._woken.close()
        self._selector.close()

    def _listen(self) -> bool:
        """Bound under another name, closed to others, and only then put in place: it is never open to anybody else."""
        name = f"{NAME}.{os.getpid()}"
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        try:
            os.makedirs(self._run_dir, exist_ok=True)
            with address(self._run_dir, name) as path:
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(path)
                listener.bind(path)
                os.chmod(path, 0o600)
                listener.listen(BACKLOG)
                self._inode = os.stat(path).st_ino
                os.replace(path, os.path.join(os.path.dirname(path), NAME))
        except OSError as error:
            listener.close()
            self._problem = f"cannot make {os.path.join(self._run_dir, NAME)}: {error.strerror or error}; `phm approve` does not work"
            return False
        self._listener, self._problem = listener, ""
        self._selector.register(listener, selectors.EVENT_READ)
        return True

    def _turn(self) -> None:
        for ready, _events in self._selector.select(_POLL_S):
            peer = ready.fileobj
            assert isinstance(peer, socket.socket)
            if peer is self._listener:
                self._accept(peer)
            elif peer in self._connections:
                self._receive(peer)
        now = time.monotonic()
        for peer in [peer for peer, (_data, end) in self._connections.items() if now >= end]:
            self._refuse(peer, f"no complete request within {DEADLINE_S:g} s")

    def _accept(self, listener: socket.socket) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            peer, _address = listener.accept()
            peer.setblocking(False)
            self._connections[peer] = (bytearray(), time.monotonic() + DEADLINE_S)
            self._selector.register(peer, selectors.EVENT_READ)
            if len(self._connections) > MAX_CONNECTIONS:
                self._refuse(peer, f"at most {MAX_CONNECTIONS} connections at a time")
            elif _user(peer) not in (0, os.geteuid()):
                self._refuse(peer, "only root and PHM's own user may ask")

    def _receive(self, peer: socket.socket) -> None:
        data, _end = self._connections[peer]
        try:
            chunk = peer.recv(MAX_REQUEST)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        if not chunk:
            self._drop(peer)
            return
        data += chunk
        while b"\n" in data and peer in self._connections:
            line, _newline, rest = bytes(data).partition(b"\n")
            data[:] = rest
            self._connections[peer] = (data, time.monotonic() + DEADLINE_S)
            if len(line) < MAX_REQUEST:
                self._answer(peer, line)
            else:
                self._refuse(peer, TOO_LONG)
        if peer in self._connections and len(data) >= MAX_REQUEST:
            self._refuse(peer, TOO_LONG)

    def _answer(self, peer: socket.socket, line: bytes) -> None:
        try:
            request = json.loads(line)
            text, data = self._do(request, f"operator (uid {_user(peer)})")
        except (ValueError, RecursionError):
            self._refuse(peer, "that is no request: one JSON object a line, with `do`")
        except Exception as error:
            self._send(peer, {"ok": False, "error": str(error)})
        else:
            self._send(peer, {"ok": True, "text": text, **data})

    def _do(self, request: Any, by: str) -> tuple[str, dict[str, Any]]:
        """Carry out one request; what was done, in words and as data. ValueError when it is none."""
        if isinstance(request, dict) and request.get("do") in ("hold", "release") and self._holds is not None:
            return _hold(self._holds, request, by)
        return self._do_words(request), {}

    def _do_words(self, request: Any) -> str:
        if not isinstance(request, dict):
            raise ValueError
        words = {key: value for key, value in request.items() if isinstance(value, str)}
        if request == {"do": "ping"}:
            return "PHM is here"
        if request == {"do": "reload"} and self.reload is not None:
            return self.reload()
        if request.keys() == words.keys() == {"do", "fault"} and words["do"] == "approve":
            return self._approve(words["fault"])
        if (
            request.keys() == words.keys() == {"do", "kind", "text"}
            and words["do"] == "note"
            and words["kind"] in KINDS
        ):
            text = one_line(words["text"])[:MAX_NOTE]
            self._note(words["kind"], text)
            return f"noted: {text}"
        raise ValueError

    def _refuse(self, peer: socket.socket, reason: str) -> None:
        self._send(peer, {"ok": False, "error": reason})
        self._drop(peer)

    def _send(self, peer: socket.socket, answer: dict[str, Any]) -> None:
        data = json.dumps(answer).encode("ascii") + b"\n"
        try:
            whole = peer.send(data) == len(data)
        except OSError:
            whole = False
        if not whole:  # a peer that does not read what it asked for
            self._drop(peer)

    def _drop(self, peer: socket.socket) -> None:
        if self._connections.pop(peer, None) is not None:
            self._selector.unregister(peer)
            peer.close()


def _hold(holds: HoldController, request: dict[str, Any], by: str) -> tuple[str, dict[str, Any]]:
    container, reason, for_s = request.get("container"), request.get("reason"), request.get("for_s")
    if request.keys() == {"do", "container"} and request["do"] == "release" and isinstance(container, str):
        return holds.release(container, by)
    known_length = for_s is None or (isinstance(for_s, (int, float)) and not isinstance(for_s, bool))
    if request.keys() != {"do", "container", "for_s", "reason"} or request["do"] != "hold" or not known_length:
        raise ValueError
    if not isinstance(container, str) or not isinstance(reason, str):
        raise ValueError
    return holds.hold(container, for_s, reason, by)


def _user(peer: socket.socket) -> int:
    """The user id at the other end, as the kernel knows it."""
    credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _pid, uid, _gid = _CREDENTIALS.unpack(credentials)
    return int(uid)
