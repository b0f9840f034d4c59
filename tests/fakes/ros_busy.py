"""A real node with a beacon whose timer callback computes for some seconds on SIGUSR1, like a busy planner, or, with
`--asleep`, waits that long, as for a response that never comes.

    python -m tests.fakes.ros_busy --name node_1 --namespace /agent_1 --seconds 5

Publishes std_msgs/String on topic_1 at 10 Hz from the same executor, so that the topic is silent in that time.
"""

from __future__ import annotations

import argparse
import signal
import time

import rclpy
from std_msgs.msg import String

from phm.beacon import Beacon


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--name", required=True)
    parser.add_argument("--namespace", default="/")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--asleep", action="store_true")
    parser.add_argument("--no-beacon", action="store_false", dest="beacon")
    options = parser.parse_args()
    wanted = [False]
    signal.signal(signal.SIGUSR1, lambda *_: wanted.__setitem__(0, True))
    rclpy.init(args=[])
    node = rclpy.create_node(options.name, namespace=options.namespace)
    if options.beacon:
        Beacon(node)
    publisher = node.create_publisher(String, "topic_1", 10)

    def tick() -> None:
        publisher.publish(String(data="x"))
        if wanted[0]:
            wanted[0] = False
            if options.asleep:
                time.sleep(options.seconds)
            end_s = time.process_time() + (0.0 if options.asleep else options.seconds)
            while time.process_time() < end_s:
                pass

    node.create_timer(0.1, tick)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
