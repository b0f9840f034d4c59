"""Sends invalid beacons, forged beacons of NAME, and announcements of unknown nodes on the beacons' topic, ten a second.

python tests/fakes/ros_forger.py NAME
"""

from __future__ import annotations

import json
import sys
import time

import rclpy
from rcl_interfaces.msg import Log

from phm.beacon import BEACON, BEACON_FORMAT, HELLO, HELLO_FORMAT


def main(name: str) -> int:
    rclpy.init(args=[])
    node = rclpy.create_node("forger", namespace="/elsewhere")
    publisher = node.create_publisher(Log, BEACON, 10)
    forged = {"birth": "forged", "beats": 1, "turns": 1, "late_s": 99.0}
    texts = [
        json.dumps({"witness": "forged", "period_s": 10.0, "nodes": {name: forged}}),
        json.dumps({"witness": "forged", "period_s": 0.2, "nodes": {"no full name": forged}}),
        "",
        "{",
        "[]",
        "null",
        "{}",
        "[" * 5000,
        "x" * 300_000,
        '{"witness":1e999}',
    ]
    hello = node.create_publisher(Log, HELLO, 10)
    unknown = {"witness": "unknown", "period_s": 1.0, "nodes": {"/nan": float("nan"), "/no name": 0, "/late": 1e300}}
    while rclpy.ok():
        for text in (*texts, json.dumps(unknown)):
            hello.publish(Log(name=HELLO_FORMAT, msg=text))
        for text in texts:
            publisher.publish(Log(name=BEACON_FORMAT, msg=text))
        publisher.publish(Log(name="phm.beacon/2", msg=texts[0]))
        time.sleep(0.1)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
