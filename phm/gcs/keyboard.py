"""Single keys from the terminal, without waiting for Enter. Without a terminal there are none."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import threading
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phm.core.clock import Clock

POLL_S = 0.05
_KEY = re.compile(r"\x1b\[[0-9;]*[A-Za-z~]|\x1bO.|.", re.DOTALL)
_NAMES = {
    "\x1b[A": "up",
    "\x1bOA": "up",
    "\x1b[B": "down",
    "\x1bOB": "down",
    "\r": "enter",
    "\n": "enter",
    "\x1b": "escape",
}
_WINDOWS = {"H": "up", "P": "down"}
"""The second character of a key that Windows sends as two."""


def parse(typed: str) -> list[str]:
    """Names of the keys: `up`, `down`, `enter`, `escape`, or the character; unknown sequences are left out."""
    names = (_NAMES.get(key, key if len(key) == 1 and key.isprintable() else "") for key in _KEY.findall(typed))
    return [name for name in names if name]


if sys.platform == "win32":
    import msvcrt

    class Keyboard:
        """Reads keys from the terminal. `read` is called by one thread."""

        def __init__(self, clock: Clock, stop: threading.Event) -> None:
            self._clock, self._stop, self.active = clock, stop, sys.stdin.isatty()

        def __enter__(self) -> Keyboard:
            return self

        def __exit__(
            self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
        ) -> None: ...

        def read(self, timeout_s: float) -> list[str]:
            """The keys that were pressed, after waiting for one for at most `timeout_s`."""
            end = self._clock.mono() + timeout_s
            while not (self.active and msvcrt.kbhit()):
                if self._clock.wait(self._stop, POLL_S) or self._clock.mono() >= end:
                    return []
            keys: list[str] = []
            while msvcrt.kbhit():
                typed = msvcrt.getwch()
                if typed in "\x00\xe0":
                    keys += [name] if (name := _WINDOWS.get(msvcrt.getwch())) else []
                else:
                    keys += parse(typed)
            return keys

else:
    import select
    import termios
    import tty

    class Keyboard:
        """`read` is called by one thread. Ctrl-C remains a signal."""

        def __init__(self, clock: Clock, stop: threading.Event) -> None:
            self._clock, self._stop = clock, stop
            self._before: list[object] | None = None
            try:
                self._fd = sys.stdin.fileno()
                self.active = os.isatty(self._fd) and self._foreground()
            except (OSError, ValueError):  # no standard input
                self.active = False

        def __enter__(self) -> Keyboard:
            if self.active:
                self._before = termios.tcgetattr(self._fd)
                tty.setcbreak(self._fd)
            return self

        def __exit__(
            self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
        ) -> None:
            if self._before is not None and self._foreground():
                with contextlib.suppress(termios.error):  # the terminal is gone
                    termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)  # type: ignore[arg-type]

        def read(self, timeout_s: float) -> list[str]:
            """The keys that were pressed, after waiting for one for at most `timeout_s`."""
            # A program in the background that reads from its terminal is stopped.
            if not self.active or not self._foreground():
                self._clock.wait(self._stop, timeout_s)
                return []
            if not select.select([self._fd], [], [], timeout_s)[0]:
                return []
            try:
                typed = os.read(self._fd, 256)
            except OSError:
                typed = b""
            if not typed:  # the terminal is gone
                self.active = False
            return parse(typed.decode("utf-8", "replace"))

        def _foreground(self) -> bool:
            try:
                return os.tcgetpgrp(self._fd) == os.getpgrp()
            except OSError:  # not our controlling terminal, so it has no background
                return True
