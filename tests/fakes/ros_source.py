"""A real publisher that records its publications, so that a measured rate is compared with the truth.

    python tests/fakes/ros_source.py HZ FILE

Publishes std_msgs/String on /agent_1/topic_1 as node /agent_1/source until it is terminated; each line of FILE is
`COUNT SECONDS` of one publication.
"""

from __future__ import annotations

import sys
import time
from itertools import count
from pathlib import Path

import rclpy
from std_msgs.msg import String


def main(hz: float, path: Path) -> None:
    rclpy.init(args=[])
    node = rclpy.create_node("source", namespace="/agent_1")
    publisher = node.create_publisher(String, "topic_1", 10)
    began_s = time.monotonic()
    with path.open("w", encoding="ascii", buffering=1) as file:
        for number in count(1):
            time.sleep(max(0.0, began_s + number / hz - time.monotonic()))
            publisher.publish(String(data="x"))
            file.write(f"{number} {time.time()}\n")


if __name__ == "__main__":
    main(float(sys.argv[1]), Path(sys.argv[2]))
