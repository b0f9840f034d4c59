"""Shifts the wall clock that single processes of this machine see, while they run. x86-64 only; needs root.

The kernel has no wall clock for each container: a time namespace has its own monotonic clock and shares this one. Programs read it
through the vDSO, code that the kernel maps into each process. Here the functions of that code are replaced in the memory of the given
processes by ones that ask the kernel and add an offset; other processes, the kernel, its file stamps and all other clocks are
unchanged. A program that such a process starts has the clock of the machine again.

The new functions are written behind the code, where the kernel left room, and the old ones begin with a jump to them. So a thread in
the middle of an old function finds its end unchanged: a machine may take a CPU away from a thread there, for longer than the look at
all threads and the change take together.
"""

from __future__ import annotations

import contextlib
import os
import platform
import re
import struct
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")
LIMIT_S = 5.0
GETTIME, GETTIMEOFDAY = "__vdso_clock_gettime", "__vdso_gettimeofday"
_VDSO = re.compile(r"^([0-9a-f]+)-([0-9a-f]+) .*\[vdso\]$", re.MULTILINE)
_ROOM = 64  # bytes for a new function
_LOAD, _DYNAMIC, _STRTAB, _SYMTAB = 1, 2, 5, 6


def shift(pid: int, offset_s: int, proc: Path = PROC) -> None:
    """Have the process see the wall clock `offset_s` ahead; 0: unchanged.

    LookupError on a machine where that cannot be done, TimeoutError when it runs without a pause.
    """
    if platform.machine() != "x86_64":
        raise LookupError(f"the wall clock of a process can be shifted on x86-64 alone, this is {platform.machine()}")
    found = _VDSO.search((proc / str(pid) / "maps").read_text("utf-8"))
    if found is None:
        raise LookupError(f"process {pid} has no vDSO")
    start, end = (int(word, 16) for word in found.groups())
    own = _own_code()
    if end - start != len(own.image):
        raise LookupError(f"process {pid} has another vDSO than this one: is it a 32-bit program?")
    changes = _changes(own, offset_s)
    with (proc / str(pid) / "mem").open("r+b", buffering=0) as memory:
        for at, code in changes:
            # First what is there already: the kernel then gives the process a separate page, which takes longer than the change.
            memory.seek(start + at)
            present = memory.read(len(code))
            memory.seek(start + at)
            memory.write(present)
        with _first():
            _wait_asleep(pid, proc)
            for at, code in changes:
                memory.seek(start + at)
                memory.write(code)


def _changes(own: _Code, offset_s: int) -> list[tuple[int, bytes]]:
    """What is written where in the vDSO, in this order: the new functions before the jumps to them. 0: the old beginnings, no jumps."""
    added, jumps = [], []
    room = -(-len(own.image.rstrip(b"\0")) // _ROOM) * _ROOM
    for number, (name, code) in enumerate({GETTIME: _gettime(offset_s), GETTIMEOFDAY: _gettimeofday(offset_s)}.items()):
        at, to = own.functions[name], room + number * _ROOM
        if to + _ROOM > len(own.image):
            raise LookupError("the vDSO of this kernel has no room behind its code")
        present = own.image[at : at + 8]
        added.append((to, code))
        # Eight aligned bytes together, of which five change: no thread sees a part of them.
        jumps.append((at, b"\xe9" + struct.pack("<i", to - at - 5) + present[5:] if offset_s else present))
    return added + jumps if offset_s else jumps


@contextlib.contextmanager
def _first() -> Iterator[None]:
    """Before all ordinary threads of this machine: between the look and the change, none must wait for its turn on a CPU."""
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    try:
        yield
    finally:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, policy, priority)


def _wait_asleep(pid: int, proc: Path) -> None:
    until_s = time.monotonic() + LIMIT_S
    while not _asleep(pid, proc):
        if time.monotonic() > until_s:
            raise TimeoutError(f"process {pid} was running at each look for {LIMIT_S:g} s")
        time.sleep(0.001)


def _asleep(pid: int, proc: Path) -> bool:
    """Whether all threads of the process wait in the kernel, so that none is at the beginning of a function. Stopping it as a debugger does
    would be safer, and is what PHM reports as a hung node."""
    states = set()
    for task in (proc / str(pid) / "task").iterdir():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # this thread has just ended
            states.add((task / "stat").read_text("ascii").rpartition(") ")[2][:1])
    return states == {"S"}


@dataclass(frozen=True)
class _Code:
    """image: the vDSO, the same in all 64-bit processes. functions: where they are in it."""

    image: bytes
    functions: Mapping[str, int]


def _own_code() -> _Code:
    """That of this process, which nothing has changed."""
    start, end = (int(word, 16) for word in _VDSO.search(Path("/proc/self/maps").read_text("utf-8")).groups())  # type: ignore[union-attr]
    with Path("/proc/self/mem").open("rb", buffering=0) as memory:
        memory.seek(start)
        image = memory.read(end - start)
    return _Code(image, functions(image))


def functions(image: bytes) -> dict[str, int]:
    """The offsets of the functions of a 64-bit ELF library, by its table of dynamic symbols."""
    headers_at, _, _, _, size, count = struct.unpack_from("<QQIHHH", image, 32)
    headers = [struct.unpack_from("<IIQQQQQQ", image, headers_at + number * size) for number in range(count)]
    base = next(header[3] for header in headers if header[0] == _LOAD)
    table_at, table_size = next((header[2], header[5]) for header in headers if header[0] == _DYNAMIC)
    entries = dict(struct.iter_unpack("<QQ", image[table_at : table_at + table_size]))
    strings, symbols = entries[_STRTAB] - base, entries[_SYMTAB] - base
    found = {}
    for at in range(symbols, strings, 24):  # linkers put the strings after the symbols
        name_at, _, _, section, value, _ = struct.unpack_from("<IBBHQQ", image, at)
        name_at += strings
        if section:
            found[image[name_at : image.index(b"\0", name_at)].decode("ascii")] = value - base
    return found


def _gettime(offset_s: int) -> bytes:
    """clock_gettime(clock, time): the system call; for CLOCK_REALTIME, 0, it adds to the seconds."""
    # test edi, edi; jne ret; mov rcx, offset_s; add [rsi], rcx; ret
    return _call(228) + b"\x85\xff\x75\x0d" + _offset(offset_s) + b"\x48\x01\x0e\xc3"


def _gettimeofday(offset_s: int) -> bytes:
    """gettimeofday(time, zone): the system call; it adds to the seconds if a time is asked for."""
    # test rdi, rdi; je ret; mov rcx, offset_s; add [rdi], rcx; ret
    return _call(96) + b"\x48\x85\xff\x74\x0d" + _offset(offset_s) + b"\x48\x01\x0f\xc3"


def _call(number: int) -> bytes:
    return b"\xb8" + struct.pack("<I", number) + b"\x0f\x05"  # mov eax, number; syscall


def _offset(offset_s: int) -> bytes:
    return b"\x48\xb9" + struct.pack("<q", offset_s)  # mov rcx, offset_s
