"""Searches regular expressions in text from outside, in a child process that can be killed.

Python's `re` can take exponential time, and stops all threads of its process meanwhile. The child starts with the first
search (about 10 MB) and is replaced after one that was too slow.
"""

from __future__ import annotations

import contextlib
import json
import select
import subprocess
import sys
import threading
from collections.abc import Sequence

from phm.core.clock import Clock
from phm.facts import CannotTell

LIMIT_S = 2.0
"""Longest time of one search."""
_CHILD = """
import json, re, sys
for request in sys.stdin.buffer:
    patterns, lines = json.loads(request)
    answer = []
    for pattern in patterns:
        search = re.compile(pattern).search
        found = [number for number, line in enumerate(lines) if search(line)]
        answer.append([len(found), found[-1] if found else -1])
    sys.stdout.write(json.dumps(answer) + "\\n")
    sys.stdout.flush()
"""


class PatternMatcher:
    """Searches patterns in another process. Thread-safe: one search at a time."""

    def __init__(self, clock: Clock, limit_s: float = LIMIT_S) -> None:
        self._clock, self._limit_s = clock, limit_s
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._closed = False

    def search(self, patterns: Sequence[str], lines: Sequence[str]) -> list[tuple[int, int]]:
        """For each pattern: how many lines match, and the index of the last one, or -1. Raises CannotTell if it takes too long."""
        if not lines:
            return [(0, -1)] * len(patterns)
        request = json.dumps([list(patterns), list(lines)]).encode() + b"\n"
        with self._lock:
            try:
                answer = self._exchange(request)
                return [(int(count), int(last)) for count, last in json.loads(answer)]
            except (OSError, ValueError, TypeError) as error:
                self._end()
                raise CannotTell(f"the patterns cannot be searched: {error}") from error
            except CannotTell:
                self._end()
                raise

    def close(self) -> None:
        """End the child; later searches raise CannotTell."""
        self._closed = True
        child = self._child
        if child is not None:
            with contextlib.suppress(OSError):
                child.kill()  # wakes a search in progress
        with self._lock:
            self._end()

    def _exchange(self, request: bytes) -> bytes:
        if self._closed:
            raise CannotTell("PHM is stopping")
        if self._child is None:
            words = [sys.executable, "-I", "-S", "-c", _CHILD]
            self._child = subprocess.Popen(
                words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, bufsize=0
            )
        stdin, stdout = self._child.stdin, self._child.stdout
        assert stdin is not None and stdout is not None
        stdin.write(request)  # the child reads a whole line before it searches
        answer, until = b"", self._clock.mono() + self._limit_s
        while not answer.endswith(b"\n"):
            if not select.select([stdout], [], [], max(0.0, until - self._clock.mono()))[0]:
                raise CannotTell(f"searching the patterns took longer than {self._limit_s:g} s: simplify them")
            more = stdout.read(65536)
            if not more:
                raise CannotTell("the process that searches the patterns has ended")
            answer += more
        return answer

    def _end(self) -> None:
        child, self._child = self._child, None
        if child is None:
            return
        with contextlib.suppress(OSError):
            child.kill()
        for stream in (child.stdin, child.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(1.0)
