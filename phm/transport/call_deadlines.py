"""Wall-clock deadlines for calls over sockets: one thread shuts down the sockets of overdue calls.

The timeout of a socket counts from byte to byte, so a peer that sends one byte a second blocks a
reader forever. Here a call registers the sockets it uses, and `shutdown` wakes the reader with an end
of file. The call itself runs in the calling thread, so nothing is left behind when it is interrupted.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import socket
import threading
from collections.abc import Iterator

from phm.core import threads
from phm.core.clock import Clock

_MAX_STALE = 256
"""Finished calls that may stay in the heap before it is cleaned."""


def shut_down(sock: socket.socket) -> None:
    """Wake the thread that reads or writes `sock`; harmless when it is closed or not connected."""
    with contextlib.suppress(OSError, ValueError):
        sock.shutdown(socket.SHUT_RDWR)


class PendingCall:
    """One call to the outside and the sockets that it uses.

    Invariant: a socket is shut down only between `attach` and `finish`, so sockets of later calls are safe.
    """

    def __init__(self, began: float, limit_s: float) -> None:
        self.began, self.limit_s = began, limit_s
        self.expired = False
        self.failure: OSError | None = None
        """Why a connection could not be opened: the libraries above wrap the error and lose it."""
        self._done = False
        self._sockets: list[socket.socket] = []
        self._lock = threading.Lock()

    @property
    def done(self) -> bool:
        return self._done

    def attach(self, sock: socket.socket) -> None:
        with self._lock:
            self._sockets.append(sock)
            if self.expired:
                shut_down(sock)

    def expire(self) -> None:
        with self._lock:
            if self._done:
                return
            self.expired = True
            for sock in self._sockets:
                shut_down(sock)

    def finish(self) -> tuple[socket.socket, ...]:
        """End the deadline. Returns the sockets, which the caller may continue to use."""
        with self._lock:
            self._done = True
            sockets, self._sockets = tuple(self._sockets), []
            return sockets


class CallDeadlines:
    """Interrupts calls at their deadline. The thread starts with the first call and ends with `close`."""

    def __init__(self, clock: Clock, name: str) -> None:
        self._clock, self._name = clock, name
        self._heap: list[tuple[float, int, PendingCall]] = []
        self._numbers = itertools.count()
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._thread: threading.Thread | None = None
        self._closed = False

    @contextlib.contextmanager
    def watch(self, limit_s: float) -> Iterator[PendingCall]:
        """A call that expires `limit_s` seconds from now. Time in which PHM does not run is added: the answer may have arrived
        meanwhile."""
        call = PendingCall(self._clock.mono(), limit_s)
        self._add(call)
        try:
            yield call
        finally:
            call.finish()

    def close(self) -> None:
        """Expire all running calls and end the thread."""
        with self._lock:
            self._closed = True
            calls = [call for _, _, call in self._heap]
            self._heap.clear()
        for call in calls:
            call.expire()
        self._wake.set()

    def _add(self, call: PendingCall) -> None:
        with self._lock:
            if self._closed:
                call.expired = True
                return
            if len(self._heap) > _MAX_STALE:
                self._heap = [entry for entry in self._heap if not entry[2].done]
                heapq.heapify(self._heap)
            self._push(call.began + call.limit_s, call)
            first = self._heap[0][2] is call
            if self._thread is None:
                self._thread = threading.Thread(target=self._loop, name=self._name, daemon=True)
                threads.start(self._thread)
        if first:
            self._wake.set()

    def _push(self, due: float, call: PendingCall) -> None:
        heapq.heappush(self._heap, (due, next(self._numbers), call))

    def _loop(self) -> None:
        while True:
            self._wake.clear()
            with self._lock:
                if self._closed:
                    return
                overdue, wait_s = self._collect(self._clock.mono())
            for call in overdue:
                call.expire()
            self._clock.wait(self._wake, wait_s)

    def _collect(self, now: float) -> tuple[list[PendingCall], float | None]:
        """The overdue calls, removed from the heap, and the seconds until the next deadline."""
        overdue = []
        while self._heap and (self._heap[0][2].done or self._heap[0][0] <= now):
            due, _, call = heapq.heappop(self._heap)
            late_due = call.began + call.limit_s + self._clock.late_s(call.began, call.limit_s)
            if not call.done and late_due > max(due, now):
                self._push(late_due, call)
            elif not call.done:
                overdue.append(call)
        return overdue, (self._heap[0][0] - now if self._heap else None)
