"""Stops all threads of a process for a moment, as a debugger does. x86-64 only; needs root."""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Iterator
from pathlib import Path

_SEIZE, _INTERRUPT, _DETACH, _PEEKUSER = 0x4206, 0x4207, 17, 3
_EVENT_STOP = 128
_INSTRUCTION_POINTER = 16 * 8
"""Where it is in the kernel's `struct user`."""
_WALL = 0x40000000


@contextlib.contextmanager
def stopped(pid: int) -> Iterator[list[int]]:
    """The threads' instruction pointers; the threads go on after the block. All calls must come from one thread.

    Unlike after SIGSTOP, nothing of this reaches the program or its parent. Raises OSError, e.g. where a debugger is attached.
    """
    held: dict[int, int] = {}
    """Signals to be delivered at the end, by thread."""
    try:
        while new := [tid for tid in _threads(pid) if tid not in held]:
            for tid in new:
                with contextlib.suppress(ProcessLookupError):  # it has just ended
                    held[tid] = _stop(tid)
        yield [_ptrace(_PEEKUSER, tid, _INSTRUCTION_POINTER) for tid in held]
    finally:
        for tid, number in held.items():
            with contextlib.suppress(OSError):
                _ptrace(_DETACH, tid, 0, number)


def _threads(pid: int) -> list[int]:
    return [int(entry.name) for entry in Path(f"/proc/{pid}/task").iterdir()]


def _stop(tid: int) -> int:
    """Returns the signal that was about to be delivered, 0: none."""
    _ptrace(_SEIZE, tid)
    _ptrace(_INTERRUPT, tid)
    _, status = os.waitpid(tid, _WALL)
    return 0 if status >> 16 == _EVENT_STOP else os.WSTOPSIG(status)


def _ptrace(request: int, tid: int, address: int = 0, data: int = 0) -> int:
    call = ctypes.CDLL(None, use_errno=True).ptrace
    call.restype, call.argtypes = ctypes.c_long, [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    ctypes.set_errno(0)
    answer = int(call(request, tid, address, data))
    if answer == -1 and (number := ctypes.get_errno()):
        raise OSError(number, f"ptrace request {request:#x} of thread {tid}: {os.strerror(number)}")
    return answer
