"""The child process that looks at ROS, so that the middleware can crash or hang without harm to PHM.

Started by `phm.probes.ros.process`; alone imports rclpy, and nothing else that is heavy. It has one hidden
node, no executor and no thread of its own. It ends when its parent does.
"""

from __future__ import annotations

import os
import re
import select
import signal
import sys
import time
from typing import Any

from phm.facts import RateFact, TopicFact
from phm.probes.ros.protocol import (
    EXIT_MISSING,
    Message,
    Missing,
    Picture,
    ProtocolError,
    Tick,
    Wanted,
    WantedTopic,
    decode_wanted,
    encode,
)

_PR_SET_PDEATHSIG = 1

_PROFILE = b"""<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles>
<participant profile_name="phm" is_default_profile="true"><rtps><builtin><discovery_config>
<leaseDuration><sec>5</sec></leaseDuration>
<leaseAnnouncement><sec>0</sec><nanosec>250000000</nanosec></leaseAnnouncement>
</discovery_config></builtin></rtps></participant>
</profiles></dds>
"""
_PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")


class Watch:
    """One participant, the graph that it sees and a meter for each topic with a rate."""

    def __init__(self, wanted: Wanted) -> None:
        """Raises ImportError when there is no rclpy."""
        from rclpy.context import Context
        from rclpy.node import Node
        from rclpy.parameter import Parameter

        from phm.probes.ros.graph import Graph

        self._context: Any = Context()
        # Without logging set up rcl creates no log directory: the sidecar's file system is read-only.
        self._context.init(args=[], initialize_logging=False, domain_id=wanted.domain)
        self._node: Any = Node(
            "_phm_" + re.sub(r"\W", "_", wanted.agent, flags=re.ASCII),
            context=self._context,
            start_parameter_services=False,
            enable_rosout=False,
            use_global_arguments=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._began_s = time.monotonic()
        self._graph = Graph(self._node, [topic.name for topic in wanted.topics], wanted.full_s)
        self._gauges = {topic.name: Gauge(self._node, topic) for topic in wanted.topics if topic.rate_hz}
        self._full_s = wanted.full_s
        self._next_full_s = 0.0
        self._states: dict[str, tuple[bool, str]] = {}

    def look(self) -> Picture | Tick:
        """The whole picture when something changed or it is time, else only that nothing did."""
        now_s = time.monotonic()
        changed = self._graph.look(now_s)
        rates: dict[str, RateFact] = {}
        for name, gauge in self._gauges.items():
            rates[name] = gauge.look(now_s, self._graph.publishers[name])
        states = {name: (rate.hz == 0.0, rate.problem) for name, rate in rates.items()}
        up_s = round(now_s - self._began_s, 3)
        if not changed and states == self._states and now_s < self._next_full_s:
            return Tick(up_s, {name: rate.silent_s for name, rate in rates.items()})
        self._states = states
        self._next_full_s = now_s + self._full_s
        graph = self._graph
        topics = {
            name: TopicFact(publishers, graph.subscribers[name], rates.get(name))
            for name, publishers in graph.publishers.items()
        }
        return Picture(up_s, graph.nodes, topics)

    def close(self) -> None:
        """Leave the graph politely, so that others forget this participant now and not after its lease."""
        self._node.destroy_node()
        self._context.try_shutdown()


class Gauge:
    """Follows the publishers of one topic with a reader of their type."""

    def __init__(self, node: Any, topic: WantedTopic) -> None:
        from phm.probes.ros.rates import Meter

        assert topic.rate_hz
        self._node = node
        self._name = topic.name
        self._meter = Meter(topic.rate_hz, topic.silence_s)
        self._reader: Any = None
        self._type = ""
        self._problem = ""

    def look(self, now_s: float, publishers: tuple[Any, ...]) -> RateFact:
        types = sorted({publisher.type for publisher in publishers})
        if types and self._type not in types:
            self._open(types[0], deep=False)
        if self._reader is not None:
            self._take(now_s)
        problem = self._problem
        if len(types) > 1:
            problem = f"ambiguous: published as {' and as '.join(types)}"
        return self._meter.fact(now_s, len({publisher.node for publisher in publishers}), problem)

    def _take(self, now_s: float) -> None:
        samples = self._reader.take(now_s)
        if samples and samples[0].sequence is None and self._reader.needs_depth:
            # This middleware does not number its samples: count them all instead.
            self._open(self._type, deep=True)
            return
        for sample in samples:
            self._meter.add(sample)

    def _open(self, type_name: str, *, deep: bool) -> None:
        from phm.probes.ros.rates import Reader, UnknownType

        if self._reader is not None:
            self._reader.close()
        self._reader, self._type, self._problem = None, type_name, ""
        try:
            self._reader = Reader(self._node, self._name, type_name, deep=deep)
        except UnknownType as error:
            self._problem = str(error)


def main() -> int:
    """Read what is wanted from standard input, then report until it is closed. Returns the exit code."""
    out = _claim_stdout()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the daemon, which then closes the pipe
    _die_with_parent()
    _announce_often()
    try:
        wanted = decode_wanted(_first_line())
    except ProtocolError as error:
        sys.stderr.write(f"phm ros child: {error}\n")
        return 2
    try:
        watch = Watch(wanted)
    except ImportError as error:
        _send(out, Missing(error.name or "", str(error)))
        return EXIT_MISSING
    try:
        _report(watch, out, wanted.tick_s)
    except BrokenPipeError:
        return 0
    watch.close()
    return 0


def _report(watch: Watch, out: int, tick_s: float) -> None:
    leak = _Leak(os.environ.get("PHM_DEBUG_ROS_LEAK_MB", ""))
    next_s = time.monotonic()
    while True:
        _send(out, watch.look())
        leak.grow()
        next_s = max(next_s + tick_s, time.monotonic())
        if not _wait(next_s):
            return


def _wait(until_s: float) -> bool:
    """Sleep; False as soon as the daemon has closed the pipe. What it writes is read and ignored."""
    while True:
        left_s = until_s - time.monotonic()
        if left_s <= 0:
            return True
        readable, _, _ = select.select([0], [], [], left_s)
        if readable and not os.read(0, 4096):
            return False


def _first_line() -> bytes:
    """One line from descriptor 0, unbuffered, so that `select` tells the truth afterwards."""
    line = b""
    while not line.endswith(b"\n"):
        piece = os.read(0, 65536)
        if not piece:
            break
        line += piece
    return line


def _claim_stdout() -> int:
    """A private copy of standard output for messages; whatever libraries print goes to standard error."""
    out = os.dup(1)
    os.dup2(2, 1)
    return out


def _die_with_parent() -> None:
    """Have the kernel end this process with its parent, should it then hang and not see the closed pipe."""
    import ctypes

    parent = os.getppid()
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    except (OSError, AttributeError):
        return
    if os.getppid() != parent:
        os._exit(0)


def _announce_often() -> None:
    """Have Fast DDS announce this participant four times a second instead of once in three seconds.

    A node that starts (or was restarted) is seen once it has heard of us too: measured 0.5 s instead of up to
    4 s. The profile is a file in memory, as the sidecar's file system is read-only; a user's own one wins.
    """
    if any(os.environ.get(name) for name in _PROFILE_VARIABLES):
        return
    file = os.memfd_create("phm-fastdds.xml")
    os.write(file, _PROFILE)
    for name in _PROFILE_VARIABLES:
        os.environ[name] = f"/proc/self/fd/{file}"


def _send(out: int, message: Message) -> None:
    data = encode(message)
    while data:
        data = data[os.write(out, data) :]


class _Leak:
    """For tests of the memory limit: keeps so many megabytes more each tick. Off unless asked for."""

    def __init__(self, megabytes: str) -> None:
        self._size = int(megabytes or 0) * 1_000_000
        self._kept: list[bytes] = []

    def grow(self) -> None:
        if self._size:
            self._kept.append(b"\1" * self._size)


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    # The middleware's threads may hang in their destructors at exit; nothing here needs them.
    os._exit(code)
