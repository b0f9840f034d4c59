"""A real publisher of types whose package PHM does not have; runs where the application runs.

    python tests/fakes/ros_typed_source.py HZ FILE [garbage]

Node /agent_1/source publishes sensor_msgs Range on /agent_1/plain, Imu on /agent_1/nested and Image, with 20 kB of
data, on /agent_1/unbounded until it is terminated; each line of FILE is `COUNT SECONDS` of one publication of all three. With
`garbage` its data are invalid for these types. FILE.readers gets the type hashes of the subscribers of the second topic.
"""

from __future__ import annotations

import random
import sys
import time
from itertools import count
from pathlib import Path
from typing import Any

import rclpy
from sensor_msgs.msg import Image, Imu, Range


def messages(garbage: bool) -> list[Any]:
    if garbage:
        return [random.randbytes(size) for size in (3, 40, 20_000)]
    return [Range(range=1.0), Imu(), Image(data=bytes(20_000))]


def main(hz: float, path: Path, garbage: bool) -> None:
    rclpy.init(args=[])
    node = rclpy.create_node("source", namespace="/agent_1")
    types = {"plain": Range, "nested": Imu, "unbounded": Image}
    publishers = [node.create_publisher(kind, name, 10) for name, kind in types.items()]
    began_s = time.monotonic()
    with path.open("w", encoding="ascii", buffering=1) as file:
        for number in count(1):
            time.sleep(max(0.0, began_s + number / hz - time.monotonic()))
            for publisher, message in zip(publishers, messages(garbage), strict=True):
                publisher.publish(message)
            file.write(f"{number} {time.time()}\n")
            if number % round(hz) == 0:
                ends = node.get_subscriptions_info_by_topic("/agent_1/nested")
                ends += node.get_publishers_info_by_topic("/agent_1/nested")
                Path(f"{path}.readers").write_text("\n".join(str(end.topic_type_hash) for end in ends))


if __name__ == "__main__":
    main(float(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:] == ["garbage"])
