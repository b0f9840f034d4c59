"""A topic with a header, a counter and a measured value, for faults of data: `reading`, geometry_msgs/PointStamped.

It exists while the file `/tmp/reading` does, which holds two names: the node that publishes it and the one that subscribes to it. The
file stays over restarts of the container. ``point.x`` is the counter, ``point.y`` the value, a sine between -1 and 1.
"""

from __future__ import annotations

import importlib
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sitl.application.behaviour import Behaviour
from sitl.application.received import Record, Sample

if TYPE_CHECKING:  # the names in this file are used where there is no ROS
    from rclpy.node import Node

MARKER = Path("/tmp/reading")
TOPIC = "reading"
RATE_HZ = 10.0
DEPTH = 10
SHIFT_S = 3600.0
"""How far a wrong stamp is ahead of the clock."""


def ends(marker: Path = MARKER) -> tuple[str, str]:
    """The nodes that publish and subscribe; empty without the file."""
    publisher, _, subscriber = (marker.read_text("ascii") if marker.exists() else "").strip().partition(" ")
    return publisher, subscriber


class Reading:
    """The node's end of the topic, if it has one."""

    def __init__(self, node: Node, behaviour: Behaviour, record: Record) -> None:
        self._node, self._behaviour, self._record = node, behaviour, record
        self._publisher: Any = None
        self._timer: Any = None
        self._subscription: Any = None
        self._last: Any = None
        self._count = 0

    def follow(self) -> None:
        """Open or close the end as the file says."""
        publisher, subscriber = ends()
        self._publish(wanted=self._node.get_name() == publisher)
        self._subscribe(wanted=self._node.get_name() == subscriber)

    def _publish(self, *, wanted: bool) -> None:
        if wanted and self._publisher is None:
            self._publisher = self._node.create_publisher(_type(), TOPIC, DEPTH)
            self._timer = self._node.create_timer(1.0 / RATE_HZ, self._send)
        elif not wanted and self._publisher is not None:
            self._node.destroy_timer(self._timer)
            self._node.destroy_publisher(self._publisher)
            self._publisher = None

    def _subscribe(self, *, wanted: bool) -> None:
        if wanted and self._subscription is None:
            self._subscription = self._node.create_subscription(_type(), TOPIC, self._take, DEPTH)
        elif not wanted and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
            self._record.forget(TOPIC)

    def _send(self) -> None:
        self._count += 2 if self._behaviour.lossy else 1
        if self._last is None or not self._behaviour.frozen:
            self._last = _type()()
            self._last.header.frame_id = "sensor"
            self._last.point.y = math.sin(self._count / 10)
        self._last.point.x = float(self._count)
        shift_s = SHIFT_S if self._behaviour.shifted else 0.0
        at_s = time.time() + shift_s
        self._last.header.stamp.sec, self._last.header.stamp.nanosec = int(at_s), int(at_s % 1 * 1e9)
        self._publisher.publish(self._last)

    def _take(self, message: Any) -> None:
        stamp, point = message.header.stamp, message.point
        off_s = stamp.sec + stamp.nanosec / 1e9 - time.time()
        content = (message.header.frame_id, point.y, point.z)
        self._record.of(TOPIC).add(Sample(time.monotonic(), content, int(point.x), off_s))


def _type() -> Any:
    """Imported only where the topic is used: not every image has the package."""
    return importlib.import_module("geometry_msgs.msg").PointStamped
