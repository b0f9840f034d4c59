"""The wall clock of a single process, shifted while the process runs."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from sitl.faults import _wall_clock

READER = """
import sys, threading, time
def read():
    while True:
        time.time()
        time.sleep(0.001)
for _ in range(2):
    threading.Thread(target=read, daemon=True).start()
for line in sys.stdin:
    print(time.time(), time.monotonic(), flush=True)
"""
CLOSE_S = 60.0
"""This test waits for nothing; on a busy machine an answer takes a while."""


class Reader:
    """A process that reads the clock a thousand times a second, in two threads, and prints it on request."""

    def __init__(self) -> None:
        argv = [sys.executable, "-c", READER]
        self.process = subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.ahead_s()  # its threads have begun: a program that starts does not sleep

    def ahead_s(self) -> tuple[float, float]:
        """The wall clock and the monotonic clock of the process, ahead of those of this one."""
        assert self.process.stdin and self.process.stdout
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        wall_s, mono_s = map(float, self.process.stdout.readline().split())
        return wall_s - time.time(), mono_s - time.monotonic()


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch) -> Iterator[Reader]:
    monkeypatch.setattr(_wall_clock, "LIMIT_S", CLOSE_S)  # threads that wait for a CPU are not asleep
    made = Reader()
    yield made
    made.process.kill()
    made.process.communicate()


def test_one_process_has_another_wall_clock(reader: Reader) -> None:
    """Ahead or behind, and back again; its monotonic clock and the clocks of other processes do not change."""
    for offset_s in (3600, -7200, 0):
        _wall_clock.shift(reader.process.pid, offset_s)
        wall_s, mono_s = reader.ahead_s()
        assert wall_s == pytest.approx(offset_s, abs=CLOSE_S)
        assert mono_s == pytest.approx(0, abs=CLOSE_S)
        done = subprocess.run(
            [sys.executable, "-c", "import time; print(time.time())"], capture_output=True, check=True
        )
        assert float(done.stdout) == pytest.approx(time.time(), abs=CLOSE_S)


def test_a_process_that_reads_the_clock_meanwhile_goes_on(reader: Reader) -> None:
    """The code is replaced while no thread runs: a hundred times, with two threads that read the clock."""
    for number in range(100):
        _wall_clock.shift(reader.process.pid, 3600 * (number % 2))
    assert reader.ahead_s()[0] == pytest.approx(3600, abs=CLOSE_S)
    assert reader.process.poll() is None


def test_only_the_beginnings_of_functions_change() -> None:
    """A thread that was interrupted in the middle of one goes on with the code that it began. 0 undoes the change."""
    own = _wall_clock._own_code()
    begins = [own.functions[name] for name in (_wall_clock.GETTIME, _wall_clock.GETTIMEOFDAY)]
    changed, size = bytearray(own.image), len(own.image.rstrip(b"\0"))

    def change(offset_s: int) -> set[int]:
        """Which bytes of the old code are now different."""
        for at, code in _wall_clock._changes(own, offset_s):
            changed[at : at + len(code)] = code
        return {at for at in range(size) if changed[at] != own.image[at]}

    for offset_s in (3600, -7200):
        assert change(offset_s) <= {at + number for at in begins for number in range(5)} and change(offset_s) >= set(
            begins
        )
    assert not change(0)


def test_a_process_that_never_sleeps_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of its threads may be inside of the code at any moment."""
    monkeypatch.setattr(_wall_clock, "LIMIT_S", 0.1)
    argv = [sys.executable, "-uc", "print()\nwhile True: pass"]
    process = subprocess.Popen(argv, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        process.stdout.readline()
        with pytest.raises(TimeoutError, match="running at each look"):
            _wall_clock.shift(process.pid, 3600)
    finally:
        process.kill()
        process.communicate()


def test_other_architectures_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The code is that of one processor."""
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    with pytest.raises(LookupError, match="x86-64 alone"):
        _wall_clock.shift(os.getpid(), 1)
