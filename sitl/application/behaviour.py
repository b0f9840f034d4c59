"""What a node of the demo application does; signals change it, and a second one of the same kind changes it back.

Three cannot be changed back: a deadlock and a leak last until the process ends, and the blocking callback returns after BLOCK_S.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType

SIGNALS = {
    signal.SIGUSR1: "silent",
    signal.SIGUSR2: "halved",
    signal.SIGHUP: "unsubscribed",
    signal.SIGRTMIN + 1: "careless",
    signal.SIGRTMIN + 2: "deadlocked",
    signal.SIGRTMIN + 3: "blocked",
    signal.SIGRTMIN + 4: "leaking",
    signal.SIGRTMIN + 5: "frozen",
    signal.SIGRTMIN + 6: "shifted",
    signal.SIGRTMIN + 7: "lossy",
}
BLOCK_S = 30.0
LEAK = Path("/tmp/leak")
"""Holds the speed of a leak in bytes per second."""
LEAK_BYTES_S = 4 * 2**20
LEAK_STEP_S = 0.25
MOST_BYTES = 2**30
"""It ends at this size, should nothing limit it."""


@dataclass
class Behaviour:
    """silent: no topic. halved: every second message. unsubscribed: no subscriptions. careless: topics as best effort.

    Of the topic `reading` (`sitl.application.reading`): frozen: the same value in each message. shifted: stamps an hour ahead.
    lossy: the counter leaves out every second number.
    """

    silent: bool = False
    halved: bool = False
    unsubscribed: bool = False
    careless: bool = False
    deadlocked: bool = False
    blocked: bool = False
    leaking: bool = False
    frozen: bool = False
    shifted: bool = False
    lossy: bool = False

    def listen(self) -> None:
        """Take the signals. rclpy's own handlers are for SIGINT and SIGTERM alone."""
        for number, name in SIGNALS.items():
            signal.signal(number, partial(self._turn, name))

    def _turn(self, name: str, number: int, frame: FrameType | None) -> None:
        setattr(self, name, not getattr(self, name))

    def speaks(self, tick: int) -> bool:
        return not self.silent and not (self.halved and tick % 2)

    def fail(self) -> None:
        """In a callback: block it, or start to leak, if a signal has asked for that."""
        if self.leaking:
            self.leaking = False
            threading.Thread(target=_leak, args=(_speed(),), name="leak", daemon=True).start()
        if self.blocked:
            self.blocked = False
            time.sleep(BLOCK_S)
        if self.deadlocked:
            lock = threading.Lock()
            with lock, lock:  # the second one never comes
                pass


def _speed(file: Path = LEAK) -> float:
    with contextlib.suppress(OSError, ValueError):
        return float(file.read_text("ascii"))
    return LEAK_BYTES_S


def _leak(bytes_s: float) -> None:
    """Take memory that is really written."""
    taken: list[bytes] = []
    size = max(1, int(bytes_s * LEAK_STEP_S))
    while len(taken) * size < MOST_BYTES:
        taken.append(b"x" * size)
        time.sleep(LEAK_STEP_S)
    threading.Event().wait()
