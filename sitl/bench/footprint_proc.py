"""Memory, CPU time and wake-ups of processes and their threads, from /proc. Linux alone."""

from __future__ import annotations

import os
import re
import struct
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

PAGE = os.sysconf("SC_PAGE_SIZE")
_VMA = re.compile(rb"^([0-9a-f]+)-([0-9a-f]+) ")
_DDS = re.compile(r"dds\.(udp|shm)\.(\d+)")
_PRESENT, _FRAME = 1 << 63, (1 << 55) - 1
_GONE = (FileNotFoundError, ProcessLookupError)


@dataclass(frozen=True, slots=True)
class Memory:
    """In bytes. pss: shared pages divided among the processes that share them. anonymous: heap, stacks, changed data."""

    rss: int
    pss: int
    anonymous: int


@dataclass(frozen=True, slots=True)
class ThreadCost:
    """wakeups: how often it went to sleep, a second (voluntary context switches). cpu: percent of a core."""

    name: str
    wakeups: float
    cpu: float


def memory(pid: int, proc: Path = Path("/proc")) -> Memory:
    """Of one process. Raises OSError if it is gone or belongs to another user."""
    found = {}
    for line in (proc / str(pid) / "smaps_rollup").read_text().splitlines()[1:]:
        key, _, rest = line.partition(":")
        found[key] = int(rest.split()[0]) * 1024
    return Memory(found["Rss"], found["Pss"], found["Anonymous"])


def together(pids: Iterable[int], proc: Path = Path("/proc")) -> int | None:
    """Bytes that these processes take if nothing else on the machine shares their pages: each page once. None: needs root."""
    frames: set[int] = set()
    for pid in pids:
        folder = proc / str(pid)
        with open(folder / "pagemap", "rb", buffering=0) as stream:
            for begin, end in _resident(folder / "smaps"):
                stream.seek(begin // PAGE * 8)
                data = stream.read((end - begin) // PAGE * 8)
                entries = struct.unpack(f"{len(data) // 8}Q", data[: len(data) // 8 * 8])
                frames.update(entry & _FRAME for entry in entries if entry & _PRESENT)
    return None if frames == {0} else len(frames - {0}) * PAGE


def _resident(smaps: Path) -> Iterator[tuple[int, int]]:
    """The address ranges with pages in memory."""
    begin = end = 0
    for line in smaps.read_bytes().splitlines():
        if match := _VMA.match(line):
            begin, end = int(match[1], 16), int(match[2], 16)
        elif line.startswith(b"Rss:") and int(line.split()[1]):
            yield begin, end


def threads(pids: Iterable[int], wait: Callable[[], None], proc: Path = Path("/proc")) -> dict[int, list[ThreadCost]]:
    """What each thread of these processes cost during `wait`. Threads that began or ended meanwhile are left out."""
    pids = list(pids)
    before, began = {pid: _counters(pid, proc) for pid in pids}, time.monotonic()
    wait()
    after, passed_s = {pid: _counters(pid, proc) for pid in pids}, time.monotonic() - began
    return {
        pid: [
            ThreadCost(name, (slept - before[pid][tid][1]) / passed_s, (ran - before[pid][tid][2]) / passed_s / 1e7)
            for tid, (name, slept, ran) in after[pid].items()
            if tid in before[pid]
        ]
        for pid in pids
    }


def _counters(pid: int, proc: Path) -> dict[int, tuple[str, int, int]]:
    """By thread: its name, how often it went to sleep, and its CPU time in ns."""
    found = {}
    try:
        tasks = list((proc / str(pid) / "task").iterdir())
    except _GONE:
        return {}
    for task in tasks:
        try:
            status, ran = (task / "status").read_text(), int((task / "schedstat").read_text().split()[0])
        except _GONE:
            continue
        values = dict(line.partition(":")[::2] for line in status.splitlines())
        found[int(task.name)] = (_named(values["Name"].strip()), int(values["voluntary_ctxt_switches"]), ran)
    return found


def _named(name: str) -> str:
    """Threads of Fast DDS are named by their port, which depends on the domain: by what comes there instead."""
    if not (match := _DDS.fullmatch(name)):
        return name
    offset = (int(match[2]) - 7400) % 250
    return f"dds.{match[1]} {'multicast' if offset < 10 else 'data' if offset % 2 else 'discovery'}"
