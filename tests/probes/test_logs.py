"""A line of a log is searched once, also if the machine was too busy for reading or searching it in time."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.facts import CannotTell
from phm.probes import logs
from phm.probes.log_file import READ_BYTES
from phm.probes.logs import Logs
from phm.probes.pattern_matcher import PatternMatcher
from phm.transport.docker import DockerEngine
from tests.fakes.until import until


class Matcher:
    """Finds words; `late` times it takes too long."""

    late = 0

    def __init__(self) -> None:
        self.began, self.go = threading.Event(), threading.Event()
        self.go.set()

    def search(self, patterns: Sequence[str], lines: Sequence[str]) -> list[tuple[int, int]]:
        if lines:
            self.began.set()
            self.go.wait(60)
        if self.late and lines:
            self.late -= 1
            raise CannotTell("searching the patterns took longer than 2 s: simplify them")
        return [(sum(one in line for line in lines), -1) for one in patterns]


class Place:
    def __init__(self, path: Path) -> None:
        self.path, self.matcher = path, Matcher()
        self.logs = self.new()

    def new(self) -> Logs:
        matcher: PatternMatcher = self.matcher  # type: ignore[assignment]
        return Logs(DockerEngine("unix:///nothing"), lambda key: None, testing.FakeClock(), matcher)

    def follow(self, timeout_s: float = 60.0) -> tuple[int, int]:
        """How many lines match, and how many bytes were left out."""
        fact = self.logs.follow("app", patterns=["FATAL"], timeout_s=timeout_s, path=str(self.path))
        return fact.counts[0], fact.skipped

    def write(self, text: str) -> None:
        with self.path.open("a") as log:
            log.write(text)


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    (tmp_path / "app.log").write_text("")
    made = Place(tmp_path / "app.log")
    assert made.follow() == (0, 0)
    yield made
    made.logs.close()


def test_lines_whose_search_took_too_long_are_searched_again(place: Place) -> None:
    """With the newer ones, and once."""
    place.matcher.late = 1
    place.write("FATAL 1\n")
    with pytest.raises(CannotTell, match="took longer"):
        place.follow()
    place.write("FATAL 2\n")
    assert place.follow() == (2, 0)
    assert place.follow() == (0, 0)


def test_lines_that_are_always_too_slow_are_left_out(place: Place) -> None:
    """After two attempts: newer lines are searched, and the bytes are counted."""
    place.matcher.late = 2
    place.write("FATAL 1\n")
    for _ in range(2):
        with pytest.raises(CannotTell, match="took longer"):
            place.follow()
    place.write("FATAL 2\n")
    assert place.follow() == (1, len("FATAL 1\n"))


def test_lines_of_a_read_that_was_given_up_are_searched_later(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """The read goes on after its deadline, and its position moves."""
    reader: Any = place.logs._readers["app"]
    read, go = reader.file.read, threading.Event()

    def slow() -> tuple[bytes, int]:
        go.wait(60)
        return read()

    place.write("FATAL 1\n")
    with monkeypatch.context() as patched:
        patched.setattr(reader.file, "read", slow)
        with pytest.raises(CannotTell, match="did not answer"):
            place.follow(0.1)
        go.set()
        until(reader.worker._hanging.done.is_set, "the end of the read")
    assert place.follow() == (1, 0)


def test_reads_that_are_always_late_keep_a_bounded_amount(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a failing disk each read may take too long; what it finds is kept for the next one."""
    reader: Any = place.logs._readers["app"]
    monkeypatch.setattr(reader.file, "read", lambda: (b"x" * READ_BYTES, 1))
    for _ in range(5):
        reader.read_on()
    assert len(reader.unsearched) == logs.UNSEARCHED_BYTES
    assert reader.skipped == 5 + 3 * READ_BYTES


def test_a_reload_waits_for_a_search_in_progress(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """The position in the log is handed over: lines that are written after it are found."""
    monkeypatch.setattr(logs, "HAND_OVER_S", 60.0)
    place.matcher.go.clear()
    place.write("FATAL 1\n")
    busy = threading.Thread(target=place.follow)
    busy.start()
    assert place.matcher.began.wait(60)
    threading.Timer(0.5, place.matcher.go.set).start()
    before, after = place.logs.hand_over(), place.new()
    busy.join()
    after.resume(before)
    place.logs = after
    place.write("FATAL 2\n")
    assert place.follow() == (1, 0)


FRAME_BYTES = 8
"""What the engine puts before each part."""


class LongLine:
    """The part of an engine that a log needs: parts of 16 KiB of one line have one time, and ``since`` includes its time."""

    def __init__(self) -> None:
        self.entries: list[tuple[int, bytes]] = []

    def logs(self, ref: str, since: str, *, tail: int, limit: int, deadline_s: float) -> bytes:
        first = int(since.replace(".", ""))
        newer = [entry for entry in self.entries if entry[0] >= first][-tail:]
        read = b""
        parts, left = [stamped(time_ns) + text for time_ns, text in newer], limit
        while parts and (left := left - len(parts[0]) - FRAME_BYTES) >= 0:  # one that is cut is left out
            read += parts.pop(0)
        return read


def stamped(time_ns: int) -> bytes:
    seconds, nanoseconds = divmod(time_ns, 10**9)
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z ".encode()


def test_a_line_of_a_container_that_is_longer_than_one_read_does_not_hide_what_follows() -> None:
    """A progress bar never ends its line. Its beginning is searched, and the rest counts as left out."""
    engine, clock, matcher = LongLine(), testing.FakeClock(), Matcher()
    container = testing.container("app")
    found = Logs(engine, lambda key: container, clock, matcher)  # type: ignore[arg-type]

    def follow() -> tuple[int, int, int]:
        fact = found.follow("app", patterns=["FATAL"], timeout_s=60.0, container="app")
        return fact.lines, fact.counts[0], fact.skipped

    assert follow() == (0, 0, 0)
    now_ns = int(clock.utc() * 1e9) + 10**9
    engine.entries = [(now_ns, b"FATAL" + b"x" * 16384)] * 20
    clock.advance(2)
    lines, matches, skipped = follow()
    assert (lines, matches) == (1, 1) and skipped > READ_BYTES // 2
    engine.entries.append((now_ns + 1000, b"\n"))
    engine.entries.append((now_ns + 2000, b"FATAL again\n"))
    assert follow()[1] == 1
    assert follow() == (0, 0, 0)
