"""The wall clock of a single process, shifted while the process runs."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from sitl.faults import _wall_clock
from sitl.faults._stopped import stopped

READER = """
import sys, threading, time
def read():
    while True:
        time.time()
for _ in range(2):
    threading.Thread(target=read, daemon=True).start()
for line in sys.stdin:
    print(time.time(), time.monotonic(), flush=True)
"""
CLOSE_S = 60.0
"""This test waits for nothing; on a busy machine an answer takes a while."""


class Reader:
    """A process that reads the clock all the time, in two threads, and prints it on request."""

    def __init__(self) -> None:
        argv = [sys.executable, "-c", READER]
        self.process = subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ahead_s(self) -> tuple[float, float]:
        """The wall clock and the monotonic clock of the process, ahead of those of this one."""
        assert self.process.stdin and self.process.stdout
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        wall_s, mono_s = map(float, self.process.stdout.readline().split())
        return wall_s - time.time(), mono_s - time.monotonic()


@pytest.fixture
def reader() -> Iterator[Reader]:
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
    """The code is replaced while no thread is in it: a hundred times, with two threads that do nothing else."""
    for number in range(100):
        _wall_clock.shift(reader.process.pid, 3600 * (number % 2))
    assert reader.ahead_s()[0] == pytest.approx(3600, abs=CLOSE_S)
    assert reader.process.poll() is None


def test_all_threads_stop_and_go_on(reader: Reader) -> None:
    """While they are stopped, the process uses no processor time; nothing of it can be seen after."""
    reader.ahead_s()

    def used() -> int:
        with open(f"/proc/{reader.process.pid}/stat", encoding="ascii") as file:
            return sum(map(int, file.read().split()[13:15]))

    with stopped(reader.process.pid) as places:
        assert len(places) == 3
        before = used()
        time.sleep(0.1)
        assert used() == before
    assert reader.ahead_s()
    assert os.waitpid(reader.process.pid, os.WNOHANG) == (0, 0)


def test_other_architectures_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The code is that of one processor."""
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    with pytest.raises(LookupError, match="x86-64 alone"):
        _wall_clock.shift(os.getpid(), 1)
