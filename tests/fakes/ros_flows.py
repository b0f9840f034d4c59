"""A real publisher of several topics, each at its own rate; runs where the application runs.

    python tests/fakes/ros_flows.py NODE FILE TOPIC:HZ[:OPTION...]...

Publishes std_msgs/String until it is terminated. HZ 0 publishes once. Options: a number is the size of a message in bytes,
`latched` is transient local, `sim` has the node use the (absent) simulated time, `partition` sets a separate DDS partition,
`lazy` has all of them publish only while there is a subscription.
Each line of FILE is `COUNT SECONDS SUBSCRIPTIONS` of one publication of the first topic.
"""

from __future__ import annotations

import heapq
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

Flow = tuple[float, int, float, Any, Any]


def main(name: str, path: Path, flows: list[str]) -> None:
    rclpy.init(args=[])
    sim = any("sim" in flow.split(":") for flow in flows)
    node: Any = rclpy.create_node(
        name, namespace="/agent_1", parameter_overrides=[Parameter("use_sim_time", value=sim)]
    )
    lazy = any("lazy" in flow.split(":") for flow in flows)
    due: list[Flow] = []
    for number, flow in enumerate(flows):
        topic, hz, *options = flow.split(":")
        size = next((int(option) for option in options if option.isdecimal()), 1)
        durability = DurabilityPolicy.TRANSIENT_LOCAL if "latched" in options else DurabilityPolicy.VOLATILE
        publisher = node.create_publisher(String, topic, QoSProfile(depth=10, durability=durability))
        due.append((time.monotonic(), number, float(hz), publisher, String(data="x" * size)))
    count = 0
    with path.open("w", encoding="ascii", buffering=1) as file:
        while due:
            at_s, number, hz, publisher, message = heapq.heappop(due)
            time.sleep(max(0.0, at_s - time.monotonic()))
            needed = not lazy or publisher.get_subscription_count()
            if needed:
                publisher.publish(message)
            if needed and number == 0:
                count += 1
                file.write(f"{count} {time.time()} {publisher.get_subscription_count()}\n")
            if hz:
                heapq.heappush(due, (at_s + 1 / hz, number, hz, publisher, message))
    while True:
        time.sleep(1)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:])
