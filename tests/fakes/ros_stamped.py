"""A real publisher of stamped messages whose data can be made wrong; runs where the application runs.

    python tests/fakes/ros_stamped.py NAME HZ

Node /agent_1/NAME publishes geometry_msgs PointStamped on /agent_1/odom: x is random, y within -1 and 1, z a counter. Each line of
standard input is the new behaviour, `healthy` or some of: `ahead` (an hour), `back` (up to 3 s late, each by another time), `frozen`,
`lossy` (every second number is not published), `outside` (y is NaN).
"""

from __future__ import annotations

import random
import sys
import threading
import time
from itertools import count

import rclpy
from geometry_msgs.msg import PointStamped

HOUR_NS, LATE_NS = 3600 * 1_000_000_000, 3 * 1_000_000_000


class Source:
    def __init__(self) -> None:
        self.wrong: frozenset[str] = frozenset()
        self._x, self._counter = 0.0, 0

    def execute(self) -> None:
        for line in sys.stdin:
            self.wrong = frozenset(line.split()) - {"healthy"}

    def message(self) -> PointStamped:
        wrong = self.wrong
        self._counter += 2 if "lossy" in wrong else 1
        self._x = self._x if "frozen" in wrong else random.random()
        now_ns = time.time_ns()
        stamp_ns = now_ns + HOUR_NS * ("ahead" in wrong)
        stamp_ns -= random.randrange(LATE_NS) if "back" in wrong else 0
        message = PointStamped()
        message.header.frame_id = "odom"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        message.point.x, message.point.z = self._x, float(self._counter)
        message.point.y = float("nan") if "outside" in wrong else 0.5
        return message


def main(name: str, hz: float) -> None:
    rclpy.init(args=[])
    node = rclpy.create_node(name, namespace="/agent_1")
    publisher = node.create_publisher(PointStamped, "odom", 10)
    source = Source()
    threading.Thread(target=source.execute, daemon=True).start()
    began_s = time.monotonic()
    for number in count(1):
        publisher.publish(source.message())
        time.sleep(max(0.0, began_s + number / hz - time.monotonic()))


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
