"""Signals to processes of this machine that cannot reach another one: the kernel gives a process id away again after its end."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterable, Iterator


@contextlib.contextmanager
def held(pids: Iterable[int]) -> Iterator[list[int]]:
    """Descriptors of the processes, in the same order, without those that have ended; closed at the end of the block."""
    with contextlib.ExitStack() as stack:
        found = []
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                found.append(os.pidfd_open(pid))
                stack.callback(os.close, found[-1])
        yield found


def kill(descriptor: int) -> None:
    """SIGKILL to the process of a descriptor; one that has ended is left alone."""
    with contextlib.suppress(ProcessLookupError):
        signal.pidfd_send_signal(descriptor, signal.SIGKILL)
