"""A separate thread for system calls that may hang, such as statvfs on a dead network mount."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from phm.core import threads
from phm.facts import CannotTell

T = TypeVar("T")


class _Job(Generic[T]):
    """One call in progress: `done` is set when `value` or `error` is available."""

    def __init__(self, function: Callable[[], T]) -> None:
        self.function = function
        self.done = threading.Event()
        self.value: T | None = None
        self.error: Exception | None = None

    def run(self) -> None:
        try:
            self.value = self.function()
        except Exception as error:  # any exception is passed to the caller of `result`
            self.error = error
        self.done.set()

    def result(self) -> T:
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]  # set by run, and T may itself be None


class BlockingCallWorker:
    """Runs one call at a time with a deadline.

    Invariant: at most one thread and one call. While a call hangs, all others are refused immediately, so a dead mount
    costs only one thread.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock = threading.Lock()
        self._jobs: queue.SimpleQueue[_Job[object] | None] = queue.SimpleQueue()
        """None ends the thread."""
        self._closing = threading.Lock()
        self._closed = False
        self._hanging: _Job[object] | None = None
        self._thread: threading.Thread | None = None

    def call(self, function: Callable[[], T], timeout_s: float) -> T:
        """Return the function's value or raise its exception. Raises CannotTell if it does not return within
        `timeout_s`."""
        if not self._lock.acquire(timeout=timeout_s):
            raise CannotTell(f"another call has kept {self._name} busy for {timeout_s:g} s")
        try:
            if self._hanging is not None and not self._hanging.done.is_set():
                raise CannotTell("an earlier call has not returned from the kernel yet")
            self._hanging = None
            job: _Job[T] = _Job(function)
            with self._closing:
                if self._closed:
                    raise CannotTell("PHM is stopping")
                self._start()
                self._jobs.put(job)  # type: ignore[arg-type]  # the queue does not care for the type of the value
            if not job.done.wait(timeout_s):
                self._hanging = job  # type: ignore[assignment]
                raise CannotTell(f"the kernel did not answer within {timeout_s:g} s")
            return job.result()
        finally:
            self._lock.release()

    def close(self) -> None:
        """Let the thread end when its call returns, without waiting for that; later calls raise CannotTell."""
        with self._closing:
            self._closed = True
            self._jobs.put(None)

    def _start(self) -> None:
        if self._thread is None:
            thread = threading.Thread(target=self._loop, name=f"phm-{self._name}", daemon=True)
            if not threads.start_now(thread):
                raise CannotTell("no thread can be started: the process limit is reached")
            self._thread = thread

    def _loop(self) -> None:
        while (job := self._jobs.get()) is not None:
            job.run()
