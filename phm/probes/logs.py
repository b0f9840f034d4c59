"""Searches patterns in what was written to logs since the last search: files, and Docker's logs of containers."""

from __future__ import annotations

import re
import threading
import time
from calendar import timegm
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from phm.core.clock import Clock
from phm.facts import CannotTell, ContainerFact, LogFact, LogMemory
from phm.probes.blocking_call import BlockingCallWorker
from phm.probes.log_file import READ_BYTES, LogFile
from phm.probes.pattern_matcher import PatternMatcher
from phm.transport.docker import DockerEngine

TAIL = 4000
"""Of a container's log, at most this many of the newest lines are read."""
LONG_BYTES = READ_BYTES // 2
"""A line without an end that has as much may be as long as READ_BYTES: what is read ends with the last whole part of the engine's."""
LINE_CHARS = 2000
"""The rest of a longer line is not searched."""
CLOCK_S = 2.0
"""PHM's clock may be so far behind that of the engine, which is the same unless the engine is on another computer."""
RESUME_S = 30.0
"""A reader that has not followed for so long after a reload is of a check that is no longer configured."""
HAND_OVER_S = 3.0
"""A reload waits so long for readers that read or search: longer than one search, `pattern_matcher.LIMIT_S`."""
UNSEARCHED_BYTES = 2 * READ_BYTES
"""Of what was read and not searched yet, at most the newest bytes are kept: reads may be late for hours."""
MOST_PARTS = 40
"""This many parts of READ_BYTES are as much as TAIL lines of LINE_CHARS."""
_STAMPED = re.compile(rb"(\d{4})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)(?:\.(\d{1,9}))?Z ?(.*)", re.DOTALL)


@dataclass
class _Reader:
    """Where one reader is. since: seconds and nanoseconds of the engine's clock; lines up to then are known.

    unsearched: what was read and not searched yet. skipped: bytes that were left out. failed: its last search failed.
    """

    worker: BlockingCallWorker
    file: LogFile
    container: str = ""
    since: tuple[int, int] | None = None
    unsearched: bytes = b""
    skipped: int = 0
    failed: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)

    def close(self) -> None:
        self.worker.close()
        self.file.close()

    def read_on(self) -> None:
        """Read the file. What a read that was given up finds later is there for the next one."""
        data, skipped = self.file.read()
        kept = self.unsearched + data
        self.unsearched = kept[-UNSEARCHED_BYTES:]
        self.skipped += skipped + len(kept) - len(self.unsearched)

    def searched(self) -> None:
        self.unsearched, self.skipped, self.failed = b"", 0, False

    def not_searched(self) -> None:
        """Keep the lines for another attempt, and no more than one: a pattern may always be too slow for them."""
        if self.failed:
            self.unsearched, self.skipped = b"", self.skipped + len(self.unsearched)
        self.failed = not self.failed


@dataclass(frozen=True)
class _Newer:
    """Lines that are newer, without their timestamps, and the time up to which all are known. skipped: bytes left out."""

    lines: Sequence[bytes]
    known: tuple[int, int]
    skipped: int = 0


class Logs:
    """Implements `phm.facts.LogProbe`. Thread-safe; readers are named by the configuration, so there are few."""

    def __init__(
        self,
        engine: DockerEngine,
        container: Callable[[str], ContainerFact | None],
        clock: Clock,
        matcher: PatternMatcher,
    ) -> None:
        self._engine, self._container, self._clock, self._matcher = engine, container, clock, matcher
        self._readers: dict[str, _Reader] = {}
        self._earlier: dict[str, _Reader] = {}
        """Those of the probe before, until they follow again."""
        self._resumed = clock.mono()
        self._memories: dict[str, LogMemory] = {}
        self._lock = threading.Lock()

    def hand_over(self) -> Logs:
        """Give up the positions, for `resume` of the probe that replaces this one. A reader that is busy for longer than
        HAND_OVER_S, as in a dead mount, stays here."""
        given = Logs(self._engine, self._container, self._clock, self._matcher)
        until = time.monotonic() + HAND_OVER_S  # of all readers together
        with self._lock:
            given._memories = self._memories
            for name, place in list(self._readers.items()):
                if place.lock.acquire(timeout=max(0.1, until - time.monotonic())):
                    given._readers[name] = self._readers.pop(name)
                    place.lock.release()
            self._forget_absent()
            given._readers.update(self._earlier)  # reloaded again before they followed
            self._earlier = {}
        return given

    def resume(self, before: Logs) -> None:
        """Continue where readers of these names were; one that follows another log now begins at its end. To be called before `follow`."""
        self._earlier, self._memories, self._resumed = before._readers, before._memories, self._clock.mono()

    def _forget_absent(self) -> None:
        """A check that is configured again after it was absent begins at the end of its log, like a new one."""
        if self._clock.mono() - self._resumed < RESUME_S:
            return
        for name, place in self._earlier.items():
            place.close()
            self._memories.pop(name, None)
        self._earlier = {}

    def memory(self, reader: str) -> LogMemory:
        with self._lock:
            return self._memories.setdefault(reader, LogMemory())

    def close(self) -> None:
        """Close all files; no reader follows any more."""
        with self._lock:
            readers = [*self._readers.values(), *self._earlier.values()]
        for place in readers:
            # A reader that hangs in a dead mount keeps its file; its thread ends when the mount answers.
            place.worker.close()
            if place.lock.acquire(timeout=0.1):
                place.file.close()
                place.lock.release()

    def follow(
        self, reader: str, *, patterns: Sequence[str], timeout_s: float, path: str = "", container: str = ""
    ) -> LogFact:
        with self._lock:
            place = self._readers.get(reader) or self._reader(reader, path, container)
        with place.lock:
            if container:
                place.unsearched += self._docker_log(place, container, timeout_s)
            else:
                place.worker.call(place.read_on, timeout_s)
            lines = [line[:LINE_CHARS] for line in place.unsearched.decode("utf-8", "replace").splitlines()]
            try:
                found = self._matcher.search(patterns, lines)
            except CannotTell:
                place.not_searched()
                raise
            skipped = place.skipped
            place.searched()
        last = tuple(lines[index] if index >= 0 else "" for _, index in found)
        return LogFact(len(lines), tuple(count for count, _ in found), last, skipped)

    def _reader(self, name: str, path: str, container: str) -> _Reader:
        place = self._earlier.pop(name, None)
        if place is not None and (place.file.path, place.container) != (path, container):
            place.close()
            place = None
            self._memories.setdefault(name, LogMemory()).found.clear()
        if place is None:
            place = _Reader(BlockingCallWorker(f"log-{name}"), LogFile(path), container)
        self._readers[name] = place
        return place

    def _docker_log(self, place: _Reader, container: str, timeout_s: float) -> bytes:
        """New lines without their timestamps."""
        fact = self._container(container)
        if fact is None:
            raise CannotTell(f"{container} does not exist, so it has no log")
        now = self._clock.utc()
        if place.since is None:
            since = (int(now), int(now % 1 * 1e9))
            # Older lines have a later time if the clock was set back, as at a start without a battery-backed clock.
            until = self._clock.mono() + timeout_s
            for _ in range(MOST_PARTS):
                newer = self._newer(fact.id, since, max(0.1, until - self._clock.mono()))
                if newer.known == since:
                    break
                since = newer.known
            place.since = since
            return b""
        if (ahead_s := place.since[0] - now) > CLOCK_S:
            raise CannotTell(
                f"the newest line of its log is from {ahead_s:.0f} s after the present time: the clock was set back"
            )
        newer = self._newer(fact.id, place.since, timeout_s)
        place.since, place.skipped = newer.known, place.skipped + newer.skipped
        return b"".join(line + b"\n" for line in newer.lines)

    def _newer(self, container: str, known: tuple[int, int], timeout_s: float) -> _Newer:
        since, newest = f"{known[0]}.{known[1]:09d}", known
        data = self._engine.logs(container, since, tail=TAIL, limit=READ_BYTES, deadline_s=timeout_s)
        whole = data.rfind(b"\n") + 1
        found = []
        for line in data[:whole].split(b"\n"):
            match = _STAMPED.fullmatch(line)
            if match is not None and (stamp := _stamp(match)) > known:
                found.append(match[8])
                newest = max(newest, stamp)
        if not found and len(data) >= LONG_BYTES:
            match = _STAMPED.fullmatch(data[whole:])
            if match is not None and _stamp(match) > known:
                return _endless(match)
        return _Newer(found, newest)


def _endless(match: re.Match[bytes]) -> _Newer:
    """The beginning of a line that is longer than one read, such as a progress bar. All of its parts have one time, so the
    next read begins after it."""
    seconds, nanoseconds = _stamp(match)
    after = (seconds, nanoseconds + 1) if nanoseconds < 999_999_999 else (seconds + 1, 0)
    return _Newer([match[8][:LINE_CHARS]], after, len(match[8]) - LINE_CHARS)


def _stamp(match: re.Match[bytes]) -> tuple[int, int]:
    """Seconds and nanoseconds since the epoch."""
    parts = [int(match[number]) for number in range(1, 7)]
    return timegm((*parts[:6], 0, 0, 0)), int((match[7] or b"0").ljust(9, b"0"))
