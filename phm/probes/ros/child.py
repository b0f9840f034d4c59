"""The child process that observes ROS, so that the middleware can crash or hang without harm to PHM.

Started by `phm.probes.ros.supervisor`. Only the modules that it observes with (`observer`) import rclpy. It has one
hidden node, no executor, and one thread that only waits for the graph to change. It exits when its parent does.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from typing import TYPE_CHECKING

from phm.core import memory
from phm.core.parent_death import die_with_parent
from phm.probes.ros import fastdds_profile, sandbox
from phm.probes.ros.graph_comparison import GraphComparison
from phm.probes.ros.line_splitter import LineSplitter
from phm.probes.ros.protocol import (
    EXIT_MISSING,
    INSTALLS,
    LogText,
    Message,
    Missing,
    ProtocolError,
    Sandbox,
    Wanted,
    decode_order,
    decode_wanted,
    encode,
)
from phm.probes.ros.static_peers import StaticPeers

if TYPE_CHECKING:
    from phm.probes.ros.observer import Observer

MISSED = "the ROS child discovers again with a new participant: the previous one missed {}"
STALE = "the ROS child discovers again with a new participant: the previous one still listed {}, which has ended"
UNRESOLVED = "ROS_STATIC_PEERS: the ROS child discovers without {}, which cannot be resolved yet"
MAX_NAMES = 300
OOM_MORE, OOM_MOST = 500, 1000
"""Value for /proc/PID/oom_score_adj, higher than the daemon's. Raising it needs no privilege."""


def main() -> int:
    """Read the configuration from standard input, then report until it is closed. Returns the exit code."""
    out = _claim_stdout()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the daemon, which then closes the pipe
    die_with_parent(os.getppid())  # in case it hangs and does not notice the closed pipe
    _go_first()
    try:
        wanted = decode_wanted(_first_line())
    except ProtocolError as error:
        sys.stderr.write(f"phm ros child: {error}\n")
        return 2
    try:
        fastdds_profile.adapt(os.environ)
    except OSError as error:
        sys.stderr.write(f"phm ros child: ROS_STATIC_PEERS={os.environ.get('ROS_STATIC_PEERS')}: {error}\n")
        return 2
    try:
        return _observe(wanted, out)
    finally:
        fastdds_profile.remove(os.environ)


def _observe(wanted: Wanted, out: int) -> int:
    """Report until standard input is closed. Returns the exit code."""
    _send(out, _restrict())
    peers = StaticPeers()
    if peers.missing:
        _send(out, LogText(UNRESOLVED.format(", ".join(peers.missing)[:MAX_NAMES])))
    try:
        from phm.probes.ros.observer import Observer

        watch = Observer(wanted)
    except ImportError as error:
        _send(out, Missing(error.name or "", str(error)))
        return EXIT_MISSING
    memory.give_back()
    try:
        watch = _report(watch, peers, out, wanted.tick_s)
    except BrokenPipeError:
        return 0
    watch.close()
    return 0


def _restrict() -> Sandbox:
    """Restrict the process before any foreign module is imported."""
    # `python -m` puts the working directory first: others may write to it, so nothing is imported from there.
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    sys.path[:] = [folder for folder in sys.path if folder in named or folder not in ("", os.getcwd())]
    return Sandbox(sandbox.enter(os.environ.get(INSTALLS, "").split(os.pathsep)))


def _report(watch: Observer, peers: StaticPeers, out: int, tick_s: float) -> Observer:
    """Observe until the pipe is closed. Returns the last observer, which may differ from the first."""
    leak = _Leak(os.environ.get("PHM_DEBUG_ROS_LEAK_MB", ""))
    next_s = time.monotonic()
    second = GraphComparison(watch.second, next_s)
    orders = LineSplitter()
    notified, late_s = False, 0.0
    while True:
        _send(out, *watch.poll(notified=notified, late_s=late_s))
        if peers.more():
            watch = watch.renewed()
            second.renewed(time.monotonic())
        elif differences := second.update(time.monotonic(), watch.known, lacking=watch.lacking):
            for text, names in zip((MISSED, STALE), differences, strict=True):
                if names:
                    _send(out, LogText(text.format(", ".join(names)[:MAX_NAMES])))
            watch = watch.renewed()
            second.renewed(time.monotonic())
        leak.grow()
        if not notified:
            next_s = max(next_s + tick_s, time.monotonic())
        woken = _wait(next_s, orders, watch)
        if woken is None:
            second.close()
            return watch
        notified = woken
        late_s = max(0.0, time.monotonic() - next_s)


def _wait(until_s: float, orders: LineSplitter, watch: Observer) -> bool | None:
    """Sleep, and execute orders of the daemon meanwhile. True: the graph may have changed. None: the pipe is closed."""
    inputs = [0] if watch.events is None else [0, watch.events]
    while True:
        left_s = until_s - time.monotonic()
        if left_s <= 0:
            return False
        readable, _, _ = select.select(inputs, [], [], left_s)
        if not readable:
            continue
        if 0 not in readable:
            return True
        piece = os.read(0, 65536)
        if not piece:
            return None
        for line in orders.add(piece):
            try:
                watch.execute(decode_order(line))
            except ProtocolError as error:
                sys.stderr.write(f"phm ros child: {error}\n")


def _first_line() -> bytes:
    """One line from descriptor 0, unbuffered, so that `select` stays correct afterwards."""
    line = b""
    while not line.endswith(b"\n"):
        piece = os.read(0, 65536)
        if not piece:
            break
        line += piece
    return line


def _claim_stdout() -> int:
    """A private copy of standard output for messages; output of libraries goes to standard error."""
    out = os.dup(1)
    os.dup2(2, 1)
    return out


def _go_first() -> None:
    """When PHM's memory limit is reached, let the kernel kill this process, which the daemon replaces, and not the
    daemon."""
    try:
        with open("/proc/self/oom_score_adj", "r+", encoding="ascii") as file:
            wanted = min(OOM_MOST, int(file.read()) + OOM_MORE)
            file.seek(0)
            file.write(str(wanted))
    except (OSError, ValueError):
        return  # a kernel or sandbox without it: then the kernel kills the larger of the two


def _send(out: int, *messages: Message) -> None:
    """Write all messages in one piece: each write wakes the daemon."""
    data = b"".join(map(encode, messages))
    while data:
        data = data[os.write(out, data) :]


class _Leak:
    """For tests of the memory limit: allocates this many more megabytes per tick. Off by default."""

    def __init__(self, megabytes: str) -> None:
        self._size = int(megabytes or 0) * 1_000_000
        self._kept: list[bytes] = []

    def grow(self) -> None:
        if self._size:
            self._kept.append(b"\1" * self._size)


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    # The middleware's threads may hang in their destructors at exit; nothing needs them any more.
    os._exit(code)
