"""A thread that observes something from `start` to `stop`."""

from __future__ import annotations

import threading
from collections.abc import Callable


class ObserverThread:
    """Calls `run` with the event that ends it. `join_s`: how long `stop` waits for that."""

    def __init__(self, name: str, run: Callable[[threading.Event], None], join_s: float) -> None:
        self._name, self._run, self._join_s = name, run, join_s
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread; a second start does nothing."""
        if self._thread is None:
            self._ending = threading.Event()
            self._thread = threading.Thread(target=self._run, args=(self._ending,), name=self._name, daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End the thread; a second stop does nothing."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(self._join_s)
            self._thread = None
